"""Make six overlapping orthos once: `python -m benchmarks.orthos FOLDER [--small]`."""

from __future__ import annotations

import random
import sys
from pathlib import Path

import numpy as np
import rasterio
from rasterio.transform import from_origin
from rasterio.windows import Window

from benchmarks.data import TILED, texture
from benchmarks.scene import CENTRE, CRS, RESOLUTION

ACROSS, DOWN, STRIP, OVERLAP, TURN = 3, 2, 256, 0.2, 3.0
"""Orthos side by side, lines at once, share of a side that overlaps, degrees by which what they show is turned."""
FORMAT = "1"


def names(folder: Path) -> list[Path]:
    """Files of the orthos."""
    return [folder / f"ortho{row + 1}{col + 1}.tif" for row in range(DOWN) for col in range(ACROSS)]


def side(small: bool) -> int:
    """Pixels along each ortho: 28 megapixels."""
    return 1000 if small else 5300


def make(folder: Path, small: bool) -> None:
    """Make what is not there yet."""
    whole = folder / "made"
    folder.mkdir(parents=True, exist_ok=True)
    if whole.exists() and whole.read_text() == FORMAT:
        return
    chance = random.Random(11)
    step = round(side(small) * (1 - OVERLAP))
    for number, path in enumerate(names(folder)):
        row, col = divmod(number, ACROSS)
        look = [(chance.gauss(1.0, 0.06), chance.gauss(0.0, 6.0)) for _ in range(3)]
        write(path, side(small), col * step, row * step, look, number)
    whole.write_text(FORMAT)


def write(path: Path, size: int, col: int, row: int, look: list[tuple[float, float]], number: int) -> None:
    """An ortho as rectified photos are: a turned square within, nodata 0 around, its own gain and offset per band."""
    rng = np.random.default_rng([7, number])
    noise = rng.normal(0, 2, (STRIP, size + 4096)).astype(np.float32)
    place = from_origin(CENTRE[0] + col * RESOLUTION, CENTRE[1] - row * RESOLUTION, RESOLUTION, RESOLUTION)
    turn = np.radians(TURN * (1 if number % 2 else -1))
    reach = size / 2 / (np.cos(TURN * np.pi / 180) + np.sin(TURN * np.pi / 180))
    shape = {"width": size, "height": size, "count": 3, "dtype": "uint8", "interleave": "pixel", "photometric": "RGB"}
    c = np.arange(size) + 0.5
    with rasterio.open(path, "w", crs=CRS, transform=place, nodata=0, **shape, **TILED) as file:
        for first in range(0, size, STRIP):
            r = np.arange(first, min(first + STRIP, size)) + 0.5
            x, y = np.meshgrid(CENTRE[0] + (col + c) * RESOLUTION, CENTRE[1] - (row + r) * RESOLUTION)
            u, v = np.meshgrid(c - size / 2, r - size / 2)
            along, across = np.cos(turn) * u + np.sin(turn) * v, np.cos(turn) * v - np.sin(turn) * u
            inside = (np.abs(along) < reach) & (np.abs(across) < reach)
            ground = np.stack([x, y], axis=-1)
            bands = []
            for band, (gain, offset) in enumerate(look):
                shift = int(rng.integers(4096))
                grey = texture(ground, band) * gain + offset + noise[: len(r), shift : shift + size]
                bands.append(np.where(inside, np.clip(np.rint(grey), 1, 255), 0).astype(np.uint8))
            file.write(np.stack(bands), window=Window(0, first, size, len(r)))


if __name__ == "__main__":
    make(Path(sys.argv[1]), "--small" in sys.argv)
