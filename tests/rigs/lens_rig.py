"""Lenses between ideal perspective images and distorted ones, in focal lengths."""

from __future__ import annotations

import numpy as np

from geomosaic.types import FloatArray
from geomosaic_frame.distortion import Lens


def distorted(lens: Lens, xy: FloatArray) -> FloatArray:
    """Ideal (N, 2) to distorted (N, 2)."""
    x, y = np.array(xy, dtype=np.float64).T.copy()
    return np.column_stack(lens.project(x, y, np.ones_like(x)))


def undistorted(lens: Lens, xy: FloatArray) -> FloatArray:
    """Distorted (N, 2) to ideal (N, 2); NaN from 90 degrees on."""
    x, y, z = lens.unproject(*np.array(xy, dtype=np.float64).T.copy())
    z = np.where(z > 0.0, z, np.nan)
    return np.column_stack([x / z, y / z])
