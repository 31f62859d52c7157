"""What part of a grid a sheet shows: across the 180th meridian, around a pole, the whole globe."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.grid import Bounds
from geomosaic.types import FloatArray

SAMPLES = 65
"""Points along each side of the neatline and each line: a graticule bends by less than 1e-3 of its sagitta between."""

Move = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class Extent:
    """Lowest and highest x and y (2,) of a grid on a sheet.

    Longitudes may go beyond 180 degrees. Where a pole lies inside the neatline, it stands in `pole`, in the map's CRS,
    with the degrees of latitude that a unit of the map has there.
    """

    low: FloatArray
    high: FloatArray
    pole: FloatArray | None = None
    degrees_per_unit: float = 0.0


def extent_of(crs: CRS, there: Move, back: Move, bounds: Bounds) -> Extent:
    """Find what a sheet shows of a grid.

    Parameters
    ----------
    crs : CRS
        Of the grid, horizontal.
    there, back : callable
        From the map to the grid, and from the grid to the map.
    bounds : Bounds
        Neatline in the map's CRS.

    Raises
    ------
    InputError
        The grid is not defined here.
    """
    edge = there(outline(bounds))
    whole = np.isfinite(edge).all()
    if not crs.is_geographic:
        if not whole:
            raise InputError(f"the grid of '{crs.name}' is not defined on this sheet", mend="choose another grid CRS")
        return Extent(edge.min(axis=0), edge.max(axis=0))
    if not whole:  # a sheet that is wider than the globe
        return Extent(np.array([-180.0, -90.0]), np.array([180.0, 90.0]))
    turns = (np.diff(edge[:, 0], append=edge[:1, 0]) + 180.0) % 360.0 - 180.0
    if abs(turns.sum()) < 180.0:
        # Steps from point to point: no jump where east becomes west.
        edge[1:, 0] = edge[0, 0] + np.cumsum(turns[:-1])
        edge[:, 0] -= 360.0 * np.floor((edge[:, 0].min() + 180.0 + 1e-9) / 360.0)
        return Extent(edge.min(axis=0), edge.max(axis=0))
    sign = 1.0 if edge[:, 1].mean() > 0 else -1.0
    pole, beside = back(np.array([[0.0, sign * 90.0], [0.0, sign * 89.0]]))
    low, high = (float(edge[:, 1].min()), 90.0) if sign > 0 else (-90.0, float(edge[:, 1].max()))
    per_unit = 1.0 / float(np.hypot(*(beside - pole)))
    return Extent(np.array([-180.0, low]), np.array([180.0, high]), pole, per_unit)


def outline(bounds: Bounds) -> FloatArray:
    """Points around the neatline, counter-clockwise from the lower left corner."""
    left, bottom, right, top = bounds
    t = np.arange(SAMPLES - 1) / (SAMPLES - 1)
    xs, ys = left + t * (right - left), bottom + t * (top - bottom)
    sides = [
        (xs, np.full_like(xs, bottom)),
        (np.full_like(ys, right), ys),
        (right + left - xs, np.full_like(xs, top)),
        (np.full_like(ys, left), top + bottom - ys),
    ]
    return np.concatenate([np.column_stack(side) for side in sides])
