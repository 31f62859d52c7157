"""Parts of the kit: a requirement in words, and what its tests start from."""

from __future__ import annotations

import numpy as np

from geomosaic.geo.crs import geographic, has_heights
from geomosaic.geo.transform import Transform
from geomosaic.sensor.model import SensorModel
from geomosaic.surface.plane import Plane
from geomosaic.types import BoolArray, FloatArray


def require(condition: bool | np.bool, broken: str) -> None:
    """Fail with the broken part of the contract in words."""
    if not condition:
        raise AssertionError(broken)


def level(model: SensorModel, ground: FloatArray) -> Plane | None:
    """Plane at the mean height of the ground points; None for models without heights."""
    if not has_heights(model.crs):
        return None
    crs = geographic(model.crs) if model.crs.is_geocentric else model.crs
    return Plane(crs, float(Transform(model.crs, crs)(ground)[:, 2].mean()))


def near(a: FloatArray, b: FloatArray | float, tolerance: float) -> bool:
    """Whether arrays agree within a tolerance, NaN with NaN."""
    return bool(np.allclose(a, b, rtol=0.0, atol=tolerance, equal_nan=True))


def adjustable(sigmas: FloatArray) -> BoolArray:
    """Parameters for the resection test: the free ones, or else those not fixed, or else all."""
    for chosen in (np.isinf(sigmas), sigmas > 0.0):
        if chosen.any():
            return chosen
    return np.ones(len(sigmas), dtype=np.bool_)
