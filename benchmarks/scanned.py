"""What a satellite sends, made once: `python -m benchmarks.scanned rpc|sar|tile FOLDER [--small]`.

rpc: scene.tif, one band of 16 bits with RPCs, and coordinates.tif, the same geometry over its own (col, row).
sar: scene.tif, one band of 16 bits without any geometry.
tile: 13 bands of 16 bits in files of their own, with the pixel sizes of Sentinel-2.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import rasterio
from rasterio.rpc import RPC
from rasterio.transform import from_origin
from rasterio.windows import Window

from benchmarks.data import TILED, texture
from benchmarks.scene import CENTRE, CRS, satellite

ROWS, GREY = 512, 40
PIXELS = {1: 60, 2: 10, 3: 10, 4: 10, 5: 20, 6: 20, 7: 20, 8: 10, 9: 60, 10: 60, 11: 20, 12: 20, 13: 20}
"""Metres, of each band; the last is the narrow near infrared, B8A."""


def land(size: int, pixel: float, band: int) -> Iterator[npt.NDArray[np.uint16]]:
    """Grey values of 8 bits times `GREY`, with noise, in strips (1, rows, cols)."""
    chance = np.random.default_rng([13, band])
    x = CENTRE[0] + (np.arange(size) + 0.5) * pixel
    for first in range(0, size, ROWS):
        y = CENTRE[1] - (np.arange(first, min(first + ROWS, size)) + 0.5) * pixel
        here = np.stack([*np.meshgrid(x, y), np.zeros((len(y), size))], axis=-1)
        noise = chance.normal(0, 2, (len(y), size)).astype(np.float32)
        yield np.rint(np.clip(texture(here, band) + noise, 1, 255) * GREY).astype(np.uint16)[None]


def coordinates(size: int) -> Iterator[npt.NDArray[np.float32]]:
    """(col, row) from the image's centre, to keep digits, in strips (2, rows, cols)."""
    cols = np.arange(size) + 0.5 - size / 2
    for first in range(0, size, ROWS):
        yield np.stack(np.meshgrid(cols, cols[first : first + ROWS])).astype(np.float32)


def write(path: Path, strips: Iterator[Any], size: int, **profile: Any) -> None:
    """A square raster of strips, unless it is there."""
    if path.exists():
        return
    hidden = path.with_suffix(".part")
    with rasterio.open(hidden, "w", width=size, height=size, interleave="pixel", **profile, **TILED) as file:
        for number, strip in enumerate(strips):
            file.write(strip, window=Window(0, number * ROWS, size, strip.shape[1]))
    hidden.rename(path)


def make(what: str, folder: Path, small: bool) -> None:
    """Make what is not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    if what == "rpc":
        size, tags = satellite(small).size[0], {"rpcs": RPC.from_gdal(satellite(small).tags())}
        write(folder / "scene.tif", land(size, 0.5, 0), size, count=1, dtype="uint16", **tags)
        write(folder / "coordinates.tif", coordinates(size), size, count=2, dtype="float32", **tags)
        return
    if what == "sar":
        size = 3000 if small else 12_000
        write(folder / "scene.tif", land(size, 0.5, 0), size, count=1, dtype="uint16")
        return
    side = 60_000 if not small else 12_000
    for band, pixel in PIXELS.items():
        place = from_origin(*CENTRE[:2], pixel, pixel)
        size = side // pixel
        path = folder / f"B{band:02}.tif"
        write(path, land(size, pixel / 10, band), size, count=1, dtype="uint16", crs=CRS, transform=place)


if __name__ == "__main__":
    make(sys.argv[1], Path(sys.argv[2]), "--small" in sys.argv)
