"""Rasters that the tests of sheets draw."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from affine import Affine

LEFT, TOP = 399_000.0, 5_500_600.0


def write(
    path: Path, values: np.ndarray, crs: Any, pixel: float = 1.0, place: tuple[float, float] = (LEFT, TOP)
) -> Path:
    """Write a raster of one band (rows, cols) or of several (bands, rows, cols)."""
    bands = values if values.ndim == 3 else values[None]
    with rasterio.open(
        path, "w", driver="GTiff", width=bands.shape[2], height=bands.shape[1], count=len(bands), dtype=bands.dtype,
        crs=crs, transform=Affine(pixel, 0, place[0], 0, -pixel, place[1]),
    ) as out:  # fmt: skip
        out.write(bands)
    return path
