"""Geometry of an ortho of the coordinates photo or scene, against the exact camera or RPCs at every pixel.

python -m benchmarks.accuracy RASTER DEM planar|rigorous|rational [--small]     prints JSON: errors in image pixels
python -m benchmarks.accuracy size RASTER...                                    prints JSON: width, height of each
"""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np
import rasterio

from benchmarks.projection import Floats, planar, rational, rigorous
from benchmarks.scene import satellite, scenes

MARGIN = 4
"""Image pixels along the photo's edge and output pixels along the seen area's edge that are left out."""


def heights(path: str, x: Floats, y: Floats) -> Floats:
    """Bilinear in the DEM; NaN outside its nodes."""
    with rasterio.open(path) as file:
        z, place = file.read(1).astype(np.float64), ~file.transform
    c, r = place.a * x + place.c - 0.5, place.e * y + place.f - 0.5
    inside = (c >= 0) & (r >= 0) & (c <= z.shape[1] - 1) & (r <= z.shape[0] - 1)
    i, j = np.clip(c.astype(int), 0, z.shape[1] - 2), np.clip(r.astype(int), 0, z.shape[0] - 2)
    u, v = c - i, r - j
    top, low = z[j, i] * (1 - u) + z[j, i + 1] * u, z[j + 1, i] * (1 - u) + z[j + 1, i + 1] * u
    return np.where(inside, top * (1 - v) + low * v, np.nan)


def errors(path: str, dem: str, treatment: str, small: bool) -> dict[str, Any]:
    """Distance of what the ortho shows from what it should show, over its valid pixels."""
    single, scene = scenes(small)["single"], satellite(small)
    camera, shot = single.camera, single.shots[0]
    with rasterio.open(path) as file:
        shown = file.read().astype(np.float64)
        valid = (file.dataset_mask() > 0) & np.isfinite(shown).all(axis=0)
        place = file.transform
    size = np.array(scene.size if treatment == "rational" else camera.size)
    shown += size[:, None, None] / 2
    r, c = np.nonzero(valid)
    x, y = place.a * (c + 0.5) + place.c, place.e * (r + 0.5) + place.f
    xyz = np.column_stack([x, y, heights(dem, x, y)])
    if treatment == "rational":
        true = rational(scene, xyz)
    else:
        true = (planar if treatment == "planar" else rigorous)(camera, shot, xyz)
    away = np.hypot(*(shown[:, r, c] - true.T))
    with np.errstate(invalid="ignore"):
        well = np.isfinite(away) & (true > MARGIN).all(axis=1) & (true < size - MARGIN).all(axis=1)
    inner = valid.copy()
    for axis in (0, 1):
        for step in range(1, MARGIN + 1):
            for way in (-step, step):
                inner &= np.roll(valid, way, axis)
    inner[:MARGIN], inner[-MARGIN:], inner[:, :MARGIN], inner[:, -MARGIN:] = False, False, False, False
    away = away[well & inner[r, c]]
    return {
        "treatment": treatment,
        "pixels": len(away),
        "rms_px": float(np.sqrt(np.mean(away**2))),
        "max_px": float(away.max()),
    }


def size_of(path: str) -> list[int]:
    """Width and height."""
    with rasterio.open(path) as file:
        return [file.width, file.height]


if __name__ == "__main__":
    words = [word for word in sys.argv[1:] if word != "--small"]
    if words[0] == "size":
        print(json.dumps([size_of(path) for path in words[1:]]))
    else:
        print(json.dumps(errors(words[0], words[1], words[2], "--small" in sys.argv)))
