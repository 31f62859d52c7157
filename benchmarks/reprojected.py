"""GDAL's warper between two CRS, as a whole process.

reprojected.py IMAGE LIKE TARGET RESAMPLING THREADS: the grid is that of LIKE; the transformation is approximated
as gdalwarp does by default, within 0.125 pixels.
"""

from __future__ import annotations

import sys

import rasterio
from rasterio.warp import Resampling, reproject


def main(image: str, like: str, target: str, resampling: str, threads: str) -> None:
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
                num_threads=int(threads), warp_mem_limit=256,
            )  # fmt: skip


if __name__ == "__main__":
    main(*sys.argv[1:])
