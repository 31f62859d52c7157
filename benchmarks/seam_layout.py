"""Layout of seams as blocks grow: graph cuts over orthos of a rough ground whose houses lean, each in its own way.

python -m benchmarks.seam_layout FOLDER SIDE THREADS      lays the seams of SIDE x SIDE orthos, prints JSON
"""

from __future__ import annotations

import json
import sys
from itertools import product
from pathlib import Path
from typing import Any

from benchmarks.global_parts import peak
from benchmarks.machine import effective_cores
from benchmarks.process import Cost, helper
from benchmarks.result import Result
from benchmarks.rounds import Times, tell
from benchmarks.setting import Setting

SIDES, SMALL = (10, 20, 30), (4, 6)
WIDTH, HEIGHT, RIGHT, DOWN = 600, 420, 300, 260
"""Pixels of an ortho, and from one to the next: about as many as the cells that seams are laid on."""
LEAN = 0.04
"""Part of its distance from the middle of an ortho by which a house leans outwards."""


def make(folder: Path, side: int) -> None:
    """Orthos of a block, as far as they are not there."""
    import numpy as np
    import rasterio
    from affine import Affine
    from scipy.ndimage import gaussian_filter

    folder.mkdir(parents=True, exist_ok=True)
    profile = {"driver": "GTiff", "width": WIDTH, "height": HEIGHT, "count": 1, "dtype": "uint8", "crs": "EPSG:32631"}
    for row, col in product(range(side), repeat=2):
        path = folder / f"r{row:02d}c{col:02d}.tif"
        if path.exists():
            continue
        # Ground and houses of a cell are the same in all orthos that show it.
        view = np.empty((3 * DOWN, 3 * RIGHT))
        middle = np.array([WIDTH / 2, HEIGHT / 2])
        for down, right in product(range(3), repeat=2):
            chance = np.random.default_rng([row + down, col + right])
            cell = 110.0 + 120.0 * gaussian_filter(chance.normal(size=(DOWN, RIGHT)), 3)
            view[down * DOWN : (down + 1) * DOWN, right * RIGHT : (right + 1) * RIGHT] = cell
        for down, right in product(range(3), repeat=2):
            chance = np.random.default_rng([row + down, col + right, 1])
            for _ in range(20):
                place = chance.uniform(0, (RIGHT, DOWN)) + np.array([right * RIGHT, down * DOWN])
                wide, tall, bright = chance.integers(8, 30), chance.integers(8, 30), chance.integers(150, 255)
                x, y = (place + LEAN * (place - middle)).astype(int)
                view[max(0, y) : max(0, y + tall), max(0, x) : max(0, x + wide)] = bright
        view += np.random.default_rng([row, col, 2]).normal(0.0, 2.0, view.shape)
        corner = Affine(1, 0, 500_000.0 + col * RIGHT, 0, -1, 5_500_000.0 - row * DOWN)
        with rasterio.open(path, "w", transform=corner, **profile) as file:
            file.write(view[:HEIGHT, :WIDTH].clip(0, 255).astype(np.uint8), 1)


def measured(folder: Path, side: int, threads: int) -> dict[str, Any]:
    """Seconds of the layout, and memory of the whole mosaic."""
    import geomosaic as gm

    make(folder, side)
    paths = [folder / f"r{row:02d}c{col:02d}.tif" for row, col in product(range(side), repeat=2)]
    out = folder / "mosaic.tif"
    made = gm.mosaic(
        paths, out, resolution=1.0, balance=False, seams="graph-cut", threads=threads, labels=False, vectors=False,
        stac=False, overwrite=True,
    )  # fmt: skip
    out.unlink()
    return {"images": side * side, "threads": threads, "seconds": made.seconds["seams"], "peak_MB": peak()}


def seam_layout(s: Setting) -> Result:
    """Growth from the smallest to the largest block."""
    times, grown, cores = Times(), dict[tuple[int, int], dict[str, Any]](), list[float]()
    for side in SMALL if s.small else SIDES:
        for threads in (1, 2):
            cores.append(effective_cores())
            told = json.loads(helper("seam_layout", str(s.work / f"seams{side}"), str(side), str(threads)))
            name = f"{side * side} orthos, {threads} thread{'s' * (threads > 1)}"
            times.costs[name] = [Cost(told["seconds"], told["seconds"], told["peak_MB"])]
            grown[side, threads] = told
            tell(f"  {name}: {told['seconds']:.1f} s, {told['peak_MB']:.0f} MB")
    times.cores.append(min(*cores, effective_cores()))
    few, many = min(side for side, _ in grown), max(side for side, _ in grown)
    result = Result("seams", f"seams by graph cuts as blocks grow to {many * many} orthos", times)
    (one, two), first = (grown[many, threads] for threads in (1, 2)), grown[few, 1]
    each = one["seconds"] / one["images"] / (first["seconds"] / first["images"])
    result.at_most(f"seconds per ortho, {many * many} / {few * few}", each, 1.5)
    result.at_most("peak memory, 1 thread, MB", one["peak_MB"], 1024.0)
    result.at_most("peak memory, 2 threads, MB", two["peak_MB"], 2048.0)
    result.at_least("T1 / (2 T2)", one["seconds"] / (2.0 * two["seconds"]), 0.8)
    return result


if __name__ == "__main__":
    print(json.dumps(measured(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))))
