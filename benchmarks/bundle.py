"""Block adjustment: least squares beside Ceres with COLMAP's cost functions, and whole adjustments of growing blocks.

python -m benchmarks.bundle race FILE      our time for the block of the race, which is written to FILE for Ceres
python -m benchmarks.bundle whole STRIPS PHOTOS PER_PHOTO      a whole adjustment, with all its statistics

Both print JSON. Blocks are those of the tests, free or with nine control points.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from benchmarks.machine import effective_cores
from benchmarks.process import ROOT, Cost, helper
from benchmarks.result import Result
from benchmarks.rounds import Times, tell
from benchmarks.setting import Setting

RIGS = ROOT / "tests" / "rigs"
# Strips, photos in each and points of a photo: 120 photos, 12,000 points, 96,000 image positions.
RACE = (8, 15, 840)
GROWTH = {250: (10, 25, 1050), 500: (20, 25, 1050), 1000: (25, 40, 1050)}
SMALL_RACE, SMALL_GROWTH = (2, 4, 60), {4: (2, 2, 60), 8: (2, 4, 60)}


def race(path: Path, strips: int, photos: int, per_photo: int) -> dict[str, Any]:
    """Our solver on a free block, which is written for the other."""
    import bundle_rig
    import numpy as np

    how: dict[str, Any] = {"seed": 3, "shift": 5.0, "turn": 0.3, "overlap": (0.8, 0.6)}
    problem = bundle_rig.synthetic(strips, photos, per_photo, **how)
    given = bundle_rig.arrays(problem)
    np.savez(path, **given)
    wall, cpu = time.perf_counter(), time.process_time()
    cost, found = bundle_rig.solved(problem)
    return {
        "cost": cost, "steps": found.rounds, "wall": time.perf_counter() - wall, "cpu": time.process_time() - cpu,
        "peak_MB": peak(), "counts": [len(given[name]) for name in ("centre", "xyz", "colrow")],
    }  # fmt: skip


def whole(strips: int, photos: int, per_photo: int) -> dict[str, Any]:
    """A whole adjustment with control, and everything that a report is made of."""
    import block_rig
    import numpy as np

    from geomosaic.orientation.block.facts import block_facts
    from geomosaic.orientation.block.solution import BlockSolution

    block = block_rig.grid_block(strips, photos, per_photo, seed=3, shift=5.0, turn=0.3, control=9)
    problem, start = block_rig.problem(block)
    wall, cpu = time.perf_counter(), time.process_time()
    found = block_rig.adjust_block(problem, start)
    adjusted = time.process_time() - cpu
    points = len(block.points)
    names, none = tuple(map(str, range(points))), np.full((points, 3), np.nan)
    block_facts(BlockSolution(found, names, none, np.zeros(points, dtype=bool)))
    return {
        "images": strips * photos, "points": points, "image_positions": len(block.image), "rounds": found.rounds,
        "sigma0": found.sigma0, "adjustment_cpu": adjusted, "cpu": time.process_time() - cpu,
        "wall": time.perf_counter() - wall, "peak_MB": peak(),
    }  # fmt: skip


def peak() -> float:
    """Largest resident memory of this process, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1024 * (1024 if sys.platform == "darwin" else 1))


def bundle(s: Setting) -> Result:
    """Race with Ceres, same start, same rule to stop, two threads; then growth."""
    python, times, path = s.programs.python_with("pycolmap"), Times(), s.work / "race.npz"
    found: dict[str, dict[str, Any]] = {}
    if python is None:
        tell("  no pycolmap (`pip install geomosaic[compare]`, or --peers): the rows of Ceres are left out")
    for number in range(s.rounds):
        before = effective_cores()
        size = SMALL_RACE if s.small else RACE
        runs = {"geomosaic": helper("bundle", "race", str(path), *map(str, size))}
        if python is not None:
            command = [python, str(RIGS / "colmap_rig.py"), str(path), "--threads", "2"]
            runs["Ceres"] = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True).stdout
        for name, text in runs.items():
            told = found[name] = json.loads(text)
            times.costs.setdefault(name, []).append(Cost(told["wall"], told["cpu"], told["peak_MB"]))
        times.cores.append(min(before, effective_cores()))
        walls = ", ".join(
            f"{name} {costs[-1].wall:.2f} ({costs[-1].cpu:.2f} CPU)" for name, costs in times.costs.items()
        )
        tell(f"  round {number + 1}: {times.cores[-1]:.2f} cores; {walls}")
    images, points, positions = found["geomosaic"].pop("counts")
    title = f"bundle adjustment of {images} photos, {points} points, {positions} image positions; growth of whole ones"
    result = Result("bundle", title, times)
    result.quality = {name: {k: v for k, v in told.items() if k in ("cost", "steps")} for name, told in found.items()}
    if python is not None:
        for what in ("wall", "cpu"):
            result.at_most(f"{what} / Ceres", times.ratio("geomosaic", "Ceres", what), 2.0)
        off = abs(found["geomosaic"]["cost"] / found["Ceres"]["cost"] - 1.0)
        result.at_most("difference of the costs, relative", off, 1e-8)
    result.at_most("wall, s", min(times.of("geomosaic")), 6.0)
    grown = {}
    for images, size in (SMALL_GROWTH if s.small else GROWTH).items():
        told = grown[images] = json.loads(helper("bundle", "whole", *map(str, size)))
        told["cpu_us_per_image_position"] = 1e6 * told["cpu"] / told["image_positions"]
        result.quality[f"{images} photos"] = {name: round(value, 3) for name, value in told.items()}
        cost = f"{told['cpu']:.1f} s CPU, {told['peak_MB']:.0f} MB"
        tell(f"  {images} photos: {told['image_positions']} image positions, {cost}")
    few, many = grown[min(grown)], grown[max(grown)]
    share = many["cpu_us_per_image_position"] / few["cpu_us_per_image_position"]
    result.at_most(f"processor time per image position, {max(grown)} / {min(grown)} photos", share, 1.5)
    result.at_most("peak memory of a whole adjustment, MB", many["peak_MB"], 4096.0)
    return result


if __name__ == "__main__":
    sys.path.insert(0, str(RIGS))
    numbers = [int(word) for word in sys.argv[2:] if word.isdigit()]
    print(json.dumps(race(Path(sys.argv[2]), *numbers) if sys.argv[1] == "race" else whole(*numbers)))
