"""Global parts of a mosaic, of synthetic footprints: output grid, shares, pairs that overlap, gains and offsets.

python -m benchmarks.global_parts IMAGES      prints JSON

Everything else of a mosaic is done image by image, pair by pair or block by block. Relations of pairs (means and
spreads of what both show) are such: here they are made of gains that are known, which the solution has to give back.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from typing import Any

from benchmarks.machine import effective_cores
from benchmarks.process import ROOT, Cost, helper
from benchmarks.result import Result
from benchmarks.rounds import Times, tell
from benchmarks.setting import Setting

RIGS = ROOT / "tests" / "rigs"
COUNTS, SMALL = (1_000, 10_000, 100_000), (100, 400)
BANDS = 3


def measured(images: int) -> dict[str, Any]:
    """Processor seconds of each part, memory, and how well the gains come back."""
    import footprint_rig
    import numpy as np

    from geomosaic.geo.crs import parse_crs
    from geomosaic.mosaicking.seams.voronoi import voronoi_regions
    from geomosaic.radiometry.gain_offset import MajorAxis, solve_relations
    from geomosaic.radiometry.overlaps import partners_of
    from geomosaic.render.extent import output_grid

    outlines, seconds, wall = footprint_rig.footprints(images), dict[str, float](), time.perf_counter()
    last = time.process_time()

    def done(part: str) -> None:
        nonlocal last
        now = time.process_time()
        seconds[part], last = now - last, now

    grid = output_grid(parse_crs("EPSG:32633"), outlines, 1.0)
    done("grid")
    shapes = [outline.polygon for outline in outlines]
    shares = voronoi_regions(shapes, [outline.centre for outline in outlines])
    done("shares")
    cells = grid.coarser(10)
    windows = [cells.window_of(outline.bounds) for outline in outlines]
    low = np.array([(each.col, each.row) for each in windows])
    near = partners_of(low, np.array([(each.stop_col, each.stop_row) for each in windows]))
    first = np.repeat(np.arange(images), [len(each) for each in near])
    second = np.concatenate(near)
    first, second = first[first < second], second[first < second]
    done("pairs")
    chance = np.random.default_rng(2)
    gain = chance.normal(0.0, 0.1, (images, BANDS))
    ratio = np.exp(gain[first] - gain[second] + chance.normal(0.0, 0.01, (len(first), BANDS)))
    level, correlation, count = np.full(BANDS, 100.0), np.full(BANDS, 0.95), np.full(BANDS, 400.0)
    relations = [MajorAxis(level, level * each, level / 5.0, level / 5.0 * each, correlation, count) for each in ratio]
    last = time.process_time()
    found, _ = solve_relations(images, first, second, relations)
    done("colour")
    left = np.log(found) - gain
    return {
        "images": images, "pairs": len(first), "seconds": {part: round(value, 2) for part, value in seconds.items()},
        "cpu": sum(seconds.values()), "wall": time.perf_counter() - wall, "peak_MB": peak(),
        "km2": sum(each.area for each in shares) / 1e6, "gain_rms": float(np.std(left)),
    }  # fmt: skip


def peak() -> float:
    """Largest resident memory of this process, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024 * (1024 if sys.platform == "darwin" else 1))


def global_parts(s: Setting) -> Result:
    """Growth from the fewest to the most footprints."""
    times, grown = Times(), dict[int, dict[str, Any]]()
    for images in SMALL if s.small else COUNTS:
        before = effective_cores()
        told = grown[images] = json.loads(helper("global_parts", str(images)))
        times.costs[f"{images} footprints"] = [Cost(told["wall"], told["cpu"], told["peak_MB"])]
        times.cores.append(min(before, effective_cores()))
        tell(f"  {images} footprints: {told['cpu']:.1f} s CPU, {told['peak_MB']:.0f} MB, {told['seconds']}")
    few, many = grown[min(grown)], grown[max(grown)]
    result = Result("footprints", f"global parts of a mosaic: {', '.join(map(str, grown))} footprints", times)
    result.quality = {f"{images} footprints": told for images, told in grown.items()}
    result.at_most("all parts, s", many["wall"], 300.0)
    result.at_most("colour, s of processor", many["seconds"]["colour"], 60.0)
    result.at_most("peak memory, MB", many["peak_MB"], 4096.0)
    share = many["cpu"] / many["images"] / (few["cpu"] / few["images"])
    result.at_most(f"processor time per footprint, {max(grown)} / {min(grown)}", share, 2.0)
    result.at_most("RMS of the gains' logarithms", many["gain_rms"], 0.02)
    return result


if __name__ == "__main__":
    sys.path.insert(0, str(RIGS))
    print(json.dumps(measured(int(sys.argv[1]))))
