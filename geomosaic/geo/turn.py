"""Longitudes are the same after a whole turn: the one near a middle is meant."""

from __future__ import annotations

import math

import numpy as np
from pyproj import CRS

from geomosaic.geo.crs import in_degrees
from geomosaic.types import FloatArray


def whole_turn(crs: CRS) -> float | None:
    """A whole turn of longitude in units of a geographic CRS (360 degrees, 400 grads); None of any other CRS."""
    return 2 * math.pi / float(crs.axis_info[0].unit_conversion_factor) if in_degrees(crs) else None


def near(xy: FloatArray, middle: float, turn: float | None) -> FloatArray:
    """Places (N, 2) with longitudes within half a turn of the middle; those that are stay as they are, to the last bit.

    Where `turn` is None, x is no longitude and nothing changes.
    """
    if turn is None:
        return xy
    with np.errstate(invalid="ignore"):
        turns = np.rint((xy[:, 0] - middle) / turn)
        away = np.abs(xy[:, 0] - middle) > turn / 2
    return xy - np.column_stack([turn * turns, np.zeros(len(xy))]) if away.any() else xy
