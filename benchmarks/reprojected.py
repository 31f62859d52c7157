"""GDAL's warper between two CRS, as a whole process.

reprojected.py IMAGE LIKE TARGET RESAMPLING THREADS [TOLERANCE]: the grid is that of LIKE; the transformation is
approximated within so many pixels, 0.125 as gdalwarp does by default.
"""

from __future__ import annotations

import sys

import rasterio
from rasterio.warp import Resampling, reproject


def main(image: str, like: str, target: str, resampling: str, threads: str, tolerance: str = "0.125") -> None:
    """Warp."""
    with rasterio.open(like) as grid, rasterio.open(image) as source:
        profile = {
            "driver": "GTiff", "width": grid.width, "height": grid.height, "crs": grid.crs, "transform": grid.transform,
            "count": source.count, "dtype": source.dtypes[0], "tiled": True, "blockxsize": 512, "blockysize": 512,
            "interleave": "pixel",
        }  # fmt: skip
        with rasterio.Env(GDAL_CACHEMAX=256), rasterio.open(target, "w", **profile) as out:
            bands = list(source.indexes)
            reproject(
                rasterio.band(source, bands), rasterio.band(out, bands), resampling=Resampling[resampling],
                num_threads=int(threads), warp_mem_limit=256, tolerance=float(tolerance),
            )  # fmt: skip


if __name__ == "__main__":
    main(*sys.argv[1:])
