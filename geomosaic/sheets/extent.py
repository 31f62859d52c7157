"""Extent of a grid on a sheet, also across the 180th meridian, around a pole, and of the whole globe."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.grid import Bounds
from geomosaic.geo.projection_domain import Rim, domain
from geomosaic.geo.transform import Transform
from geomosaic.types import FloatArray

SAMPLES = 65
"""Points along each side of the neatline and each line: a graticule bends by less than 1e-3 of its sagitta between."""

COINCIDENT = 1e-6
"""Share of a sheet's size within which two points coincide: above rounding, below any line width."""


@dataclass(frozen=True)
class Extent:
    """Lowest and highest x and y (2,) of a grid on a sheet.

    Longitudes may go beyond 180 degrees. Where a pole lies inside the neatline, it stands in `pole`, in the map's CRS,
    with the degrees of latitude that a unit of the map has there. `turns`: x are longitudes.
    """

    low: FloatArray
    high: FloatArray
    pole: FloatArray | None = None
    degrees_per_unit: float = 0.0
    turns: bool = False


def extent_of(crs: CRS, there: Transform, back: Transform, bounds: Bounds) -> Extent:
    """Extent of a grid within the neatline of a sheet.

    Parameters
    ----------
    crs : CRS
        Of the grid, horizontal.
    there, back : Transform
        From the map to the grid, and from the grid to the map.
    bounds : Bounds
        Neatline in the map's CRS.

    Raises
    ------
    InputError
        A projected grid is not defined here. Of longitude and latitude the whole globe is taken where the sheet
        reaches beyond it.
    """
    ring = neatline_points(bounds)
    edge = there(ring)
    if not crs.is_geographic:
        if not np.isfinite(edge).all():
            raise InputError(f"the grid of '{crs.name}' is not defined on this sheet", hint="choose another grid CRS")
        return Extent(edge.min(axis=0), edge.max(axis=0))
    hair = COINCIDENT * max(bounds[2] - bounds[0], bounds[3] - bounds[1])
    own = horizontal(there.source)
    folded = own.is_projected and domain(own).folds and bool(Rim.of(own).beyond(ring).any())
    whole = bool(np.isfinite(edge).all()) and not folded
    poles = {sign: place for sign in (1.0, -1.0) if (place := _pole(back, sign, bounds, hair)) is not None}
    if not whole or len(poles) == 2:  # a sheet that is wider than the globe
        return Extent(np.array([-180.0, -90.0]), np.array([180.0, 90.0]), turns=True)
    if not poles:
        # Steps from point to point: no jump where east becomes west.
        turns = (np.diff(edge[:, 0]) + 180.0) % 360.0 - 180.0
        edge[1:, 0] = edge[0, 0] + np.cumsum(turns)
        edge[:, 0] -= 360.0 * np.floor((edge[:, 0].min() + 180.0 + 1e-9) / 360.0)
        return Extent(edge.min(axis=0), edge.max(axis=0), turns=True)
    ((sign, pole),) = poles.items()
    low, high = (float(edge[:, 1].min()), 90.0) if sign > 0 else (-90.0, float(edge[:, 1].max()))
    per_unit = 1.0 / float(np.hypot(*(back(np.array([[0.0, sign * 89.0]]))[0] - pole)))
    return Extent(np.array([-180.0, low]), np.array([180.0, high]), pole, per_unit, turns=True)


def _pole(back: Transform, sign: float, bounds: Bounds, hair: float) -> FloatArray | None:
    """Position of a pole that is a point inside a neatline or on it, else None."""
    places = back(np.array([[0.0, sign * 90.0], [90.0, sign * 90.0]]))
    x, y = places[0]
    inside = bounds[0] - hair <= x <= bounds[2] + hair and bounds[1] - hair <= y <= bounds[3] + hair
    return places[0] if inside and np.abs(places[1] - places[0]).max() < hair else None


def neatline_points(bounds: Bounds) -> FloatArray:
    """Points around the neatline, counter-clockwise from the lower left corner."""
    left, bottom, right, top = bounds
    return densified_ring(np.array([(left, bottom), (right, bottom), (right, top), (left, top)]), SAMPLES - 1)


def densified_ring(ring: FloatArray, parts: int) -> FloatArray:
    """Ring with every side divided into parts, not closed."""
    ahead = np.roll(ring, -1, axis=0)
    share = np.arange(parts)[None, :, None] / parts
    dense: FloatArray = (ring[:, None] * (1 - share) + ahead[:, None] * share).reshape(-1, 2)
    return dense
