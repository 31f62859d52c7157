"""GDAL's warper on control points, as a whole process.

warped.py IMAGE TABLE CRS TARGET METHOD RESOLUTION THREADS, with METHOD poly3 or tps. The output covers the points; the
transformation is approximated within 0.125 pixels, as gdalwarp does by default.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import rasterio
import rasterio.shutil
from rasterio.control import GroundControlPoint
from rasterio.transform import from_origin
from rasterio.warp import Resampling, reproject

OPTIONS = {"poly3": {"MAX_GCP_ORDER": 3}, "tps": {"SRC_METHOD": "GCP_TPS"}}


def main(image: str, table: str, crs: str, target: str, method: str, resolution: str, threads: str) -> None:
    """Warp."""
    with Path(table).open(newline="") as file:
        rows = [{name: float(value) for name, value in row.items() if name != "id"} for row in csv.DictReader(file)]
    points = [GroundControlPoint(row=p["row"], col=p["col"], x=p["x"], y=p["y"]) for p in rows]
    step = float(resolution)
    xs, ys = [p["x"] for p in rows], [p["y"] for p in rows]
    left, top = min(xs) // step * step, -(-max(ys) // step) * step
    width, height = round((max(xs) - left) / step), round((top - min(ys)) / step)
    placed = f"{target}.vrt"
    rasterio.shutil.copy(image, placed, driver="VRT")
    with rasterio.open(placed, "r+") as file:
        file.gcps = points, crs
    with rasterio.open(placed) as source:
        profile = {
            "driver": "GTiff", "width": width, "height": height, "count": source.count, "dtype": "uint8", "crs": crs,
            "transform": from_origin(left, top, step, step), "tiled": True, "blockxsize": 512, "blockysize": 512,
            "interleave": "pixel",
        }  # fmt: skip
        with rasterio.open(target, "w", **profile) as out:
            bands = list(source.indexes)
            reproject(
                rasterio.band(source, bands), rasterio.band(out, bands), resampling=Resampling.bilinear,
                num_threads=int(threads), warp_mem_limit=256, tolerance=0.125, **OPTIONS[method],
            )  # fmt: skip


if __name__ == "__main__":
    main(*sys.argv[1:])
