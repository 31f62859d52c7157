"""The least that any tool can do, as whole processes, through the same GDAL as ours.

python floor.py copy SOURCE TARGET                read a finished raster, write it again
python floor.py pass SIZE_OF TARGET INPUT...      read every input once, write a raster of the size of another once
"""

from __future__ import annotations

import sys

import rasterio
import rasterio.shutil
from rasterio.windows import Window

TILED = {"driver": "GTiff", "TILED": "YES", "BLOCKXSIZE": "512", "BLOCKYSIZE": "512", "INTERLEAVE": "PIXEL"}
ROWS = 512


def copy(source: str, target: str) -> None:
    """Read + write, nothing else."""
    rasterio.shutil.copy(source, target, **TILED)


def once(like: str, target: str, inputs: list[str]) -> None:
    """Read the inputs in rows of blocks, then write the output so: what happens to lie in memory, real bytes."""
    for name in inputs:
        with rasterio.open(name) as file:
            for row in range(0, file.height, ROWS):
                band = file.read(window=Window(0, row, file.width, min(ROWS, file.height - row)))
    with rasterio.open(like) as file:
        profile = file.profile
    profile.update(tiled=True, blockxsize=512, blockysize=512, interleave="pixel", compress=None)
    band = band[:1].repeat(profile["count"], axis=0)
    with rasterio.open(target, "w", **profile) as file:
        for row in range(0, file.height, ROWS):
            for col in range(0, file.width, 2048):
                window = Window(col, row, min(2048, file.width - col), min(ROWS, file.height - row))
                values = band[:, : window.height, : window.width]
                if values.shape[1:] != (window.height, window.width):
                    import numpy as np

                    values = np.resize(band, (profile["count"], window.height, window.width))
                file.write(values.astype(profile["dtype"], copy=False), window=window)


if __name__ == "__main__":
    if sys.argv[1] == "copy":
        # GDAL's own settings, as gdal_translate has them.
        with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
            copy(*sys.argv[2:4])
    else:
        # A small cache makes this the faster one.
        with rasterio.Env(GDAL_CACHEMAX=256, GDAL_TIFF_INTERNAL_MASK=True):
            once(sys.argv[2], sys.argv[3], sys.argv[4:])
