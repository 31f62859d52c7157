"""Make overlapping orthos once: `python -m benchmarks.orthos FOLDER colour|satellite [--small]`."""

from __future__ import annotations

import random
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from rasterio.transform import from_origin
from rasterio.windows import Window

from benchmarks.data import TILED, texture
from benchmarks.scene import CENTRE, CRS, RESOLUTION

STRIP, OVERLAP = 256, 0.2
"""Lines at once, share of a side that overlaps."""
FORMAT = "1"


@dataclass(frozen=True)
class Kind:
    """Orthos side by side and below each other, their bands, values for each grey value of 8 bits, and the degrees by
    which what they show is turned: nodata is around it."""

    across: int
    down: int
    bands: int
    scale: int
    turn: float

    def names(self, folder: Path) -> list[Path]:
        """Files of the orthos."""
        return [folder / f"ortho{row + 1}{col + 1}.tif" for row in range(self.down) for col in range(self.across)]


KINDS = {"colour": Kind(3, 2, 3, 1, 3.0), "satellite": Kind(2, 2, 4, 40, 12.0)}


def side(small: bool) -> int:
    """Pixels along each ortho: 28 megapixels."""
    return 1000 if small else 5300


def make(folder: Path, kind: Kind, small: bool) -> None:
    """Make what is not there yet."""
    whole = folder / "made"
    folder.mkdir(parents=True, exist_ok=True)
    if whole.exists() and whole.read_text() == FORMAT:
        return
    chance = random.Random(11)
    step = round(side(small) * (1 - OVERLAP))
    for number, path in enumerate(kind.names(folder)):
        row, col = divmod(number, kind.across)
        look = [(chance.gauss(1.0, 0.06), chance.gauss(0.0, 6.0)) for _ in range(kind.bands)]
        write(path, kind, side(small), (col * step, row * step), look, number)
    whole.write_text(FORMAT)


def write(
    path: Path, kind: Kind, size: int, corner: tuple[int, int], look: list[tuple[float, float]], number: int
) -> None:
    """An ortho as rectified photos are: a turned square within, nodata 0 around, its own gain and offset per band."""
    (col, row), rng = corner, np.random.default_rng([7, number])
    noise = rng.normal(0, 2, (STRIP, size + 4096)).astype(np.float32)
    place = from_origin(CENTRE[0] + col * RESOLUTION, CENTRE[1] - row * RESOLUTION, RESOLUTION, RESOLUTION)
    turn = np.radians(kind.turn * (1 if number % 2 else -1))
    reach = size / 2 / (np.cos(turn) + np.sin(abs(turn)))
    shape = {"width": size, "height": size, "count": kind.bands, "interleave": "pixel"}
    shape |= {"dtype": "uint8", "photometric": "RGB"} if kind.scale == 1 else {"dtype": "uint16"}
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
                value = np.rint(np.clip(grey, 1, 255) * kind.scale)
                bands.append(np.where(inside, value, 0).astype(shape["dtype"]))
            file.write(np.stack(bands), window=Window(0, first, size, len(r)))


if __name__ == "__main__":
    make(Path(sys.argv[1]), KINDS[sys.argv[2]], "--small" in sys.argv)
