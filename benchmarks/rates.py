"""Rates of processing, measured on this machine: what `geomosaic plan run` reckons with.

python -m benchmarks.rates FOLDER [--small] [--out geomosaic/planning/rates.json]

Two blocks of synthetic photos, 60 and 20 % overlap along the strips, each matched, adjusted and drawn at two
resolutions. Every stage is a process of its own; of its processor seconds and peak memory rates are solved. Seams by
graph cuts are those of `benchmarks.seam_layout`: blocks of more than some 50 photos are laid in parts, these are not.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.machine import description
from benchmarks.process import ROOT, helper, run

RIGS = ROOT / "tests" / "rigs"
ENTRY = f"import sys; sys.path[:0] = [{str(ROOT)!r}, {str(RIGS)!r}]; from benchmarks.rates import stage; stage()"
GSD = 0.3
# Width and height of a photo; strips and photos in each.
FULL, SMALL = ((4000, 3000), (3, 8)), ((640, 480), (2, 4))
# Every photo, and every other one of a strip: pairs and photos are told apart.
BLOCKS = {"dense": 1, "sparse": 2}

# Growth of matching's memory by each photo, which blocks of this size do not show: 60 and 1000 photos of 480 x 360
# pixels hold 388 and 2970 MB at most (24 November 2026).
MATCH_MB = 2.75


def scene(small: bool) -> tuple[dict[str, Any], Any, list[Any], int]:
    """Camera, scenery, flight and number of photos in a strip."""
    from scenery import Scenery
    from scenery_rig import GROUND, camera_of

    from geomosaic.testing.synthetic import FlightPlan, synthetic_block

    size, (strips, each) = SMALL if small else FULL
    camera = camera_of(size)
    photos = synthetic_block(GROUND, camera, FlightPlan(strips, each, 0.6, 0.3, gsd=GSD))
    return camera, Scenery(finest=1.5 * GSD, water=0.0), photos, each


def block(folder: Path, small: bool, name: str) -> Any:
    """Block with its orientations known."""
    from scenery_rig import GROUND

    import geomosaic as gm

    camera, _, photos, each = scene(small)
    chosen = [photo for k, photo in enumerate(photos) if k % each % BLOCKS[name] == 0]
    table = folder / f"{name}.csv"
    rows = [",".join(map(str, (f"{p.name}.jpg", *p.position, *p.angles))) for p in chosen]
    table.write_text("\n".join(["image,x,y,z,omega,phi,kappa", *rows]) + "\n")
    lens = gm.Camera(**camera)
    paths = [folder / f"{p.name}.jpg" for p in chosen]
    height = {"height": GROUND.base, "dem_heights": "egm96"}
    return gm.Block(paths, "frame", camera=lens, exterior=table, crs="EPSG:32633", heights="egm96", **height)


def stage() -> None:
    """One stage as a process of its own: `FOLDER SMALL BLOCK WHAT OUT`."""
    import geomosaic as gm

    folder, small, name, what, out = Path(sys.argv[1]), sys.argv[2] == "1", sys.argv[3], sys.argv[4], Path(sys.argv[5])
    given = block(folder, small, name)
    ties = folder / f"{name}-ties.csv"
    if what == "match":
        found = gm.match(given)
        found.ties.write(ties)
        out.write_text(json.dumps({"pairs": len(found.pairs), "positions": len(found.ties)}))
    elif what == "adjust":
        gm.adjust(given, ties=ties, position_sigma=0.1)
        out.write_text("{}")
    else:
        made = gm.mosaic(given, folder / "mosaic.tif", resolution=float(what), overwrite=True)
        written = made.path.stat().st_size
        out.write_text(json.dumps({"pixels": made.grid.width * made.grid.height, "bytes": written}))


def measured(folder: Path, small: bool, name: str, what: str) -> dict[str, float]:
    """Processor seconds, peak memory and facts of a stage."""
    out = folder / "facts.json"
    command = (sys.executable, "-c", ENTRY, str(folder), str(int(small)), name, what, str(out))
    cost, _ = run((command,), folder / "log.txt")
    return {"cpu": cost.cpu, "peak_mb": cost.memory, **json.loads(out.read_text())}


def rates(folder: Path, small: bool) -> dict[str, Any]:
    """Rates of all stages."""
    from scenery_rig import write_photos

    camera, scenery, photos, _ = scene(small)
    write_photos(folder, photos, camera, scenery)
    print("photos are made", flush=True)
    pixels = camera["size"][0] * camera["size"][1] / 1e6
    numbers = {name: len(block(folder, small, name).images) for name in BLOCKS}
    found = {
        (name, what): measured(folder, small, name, what)
        for name in BLOCKS
        for what in ("match", "adjust", repr(GSD), repr(2 * GSD))
    }
    for key, one in found.items():
        print(*key, one, flush=True)
    seams = json.loads(helper("seam_layout", str(folder / "seams"), "4" if small else "10", "1"))
    dense = found["dense", "match"]
    photo, pair = solved(
        [[numbers[n] * pixels, found[n, "match"]["pairs"]] for n in BLOCKS], [found[n, "match"]["cpu"] for n in BLOCKS]
    )
    drawn = [key for key in found if key[1] not in ("match", "adjust")]
    read, write = solved(
        [[numbers[name] * pixels, found[name, what]["pixels"] / 1e6] for name, what in drawn],
        [found[key]["cpu"] for key in drawn],
    )
    finest = found["dense", repr(GSD)]
    positions = [found[name, "match"]["positions"] for name in BLOCKS]
    adjust_mb, per_position = line(positions, [found[name, "adjust"]["peak_mb"] for name in BLOCKS])
    return {
        "date": date.today().isoformat(),
        "machine": description(),
        "photos": {"number": numbers["dense"], "megapixels": pixels},
        "features_s_per_megapixel": photo,
        "match_s_per_pair": pair,
        "positions_per_photo": dense["positions"] / numbers["dense"],
        "adjust_s_per_position": found["dense", "adjust"]["cpu"] / dense["positions"],
        "seams_s_per_photo": seams["seconds"] / seams["images"],
        "input_s_per_megapixel": read,
        "output_s_per_megapixel": write,
        "output_bytes_per_pixel": finest["bytes"] / finest["pixels"],
        "match_mb": dense["peak_mb"] - MATCH_MB * numbers["dense"],
        "match_mb_per_photo": MATCH_MB,
        "adjust_mb": adjust_mb,
        "adjust_mb_per_position": per_position,
        "mosaic_mb": max(found[key]["peak_mb"] for key in drawn),
    }


def line(counts: Sequence[float], memory: Sequence[float]) -> tuple[float, float]:
    """Memory without anything, and by each; it never falls."""
    slope = max(0.0, (memory[0] - memory[1]) / (counts[0] - counts[1]))
    return memory[0] - slope * counts[0], slope


def solved(coefficients: Sequence[Sequence[float]], seconds: Sequence[float]) -> list[float]:
    """Rates, none below zero, that explain seconds best."""
    from scipy.optimize import nnls

    solution: list[float] = nnls(np.array(coefficients), np.array(seconds))[0].tolist()
    return solution


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.rates", description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--small", action="store_true", help="small photos: tries the machinery")
    parser.add_argument("--out", type=Path, help="file of the rates; printed unless given")
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    sys.path[:0] = [str(RIGS)]
    text = json.dumps(rates(given.folder, given.small), indent=1) + "\n"
    if given.out is None:
        print(text)
    else:
        given.out.write_text(text)


if __name__ == "__main__":
    main()
