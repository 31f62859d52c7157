"""Units of map coordinates: their names, and their length in metres."""

from __future__ import annotations

import math

import numpy as np
from pyproj import CRS

from geomosaic.geo.crs import geographic, horizontal
from geomosaic.geo.transform import Transform
from geomosaic.types import FloatArray


def metres_per_unit(crs: CRS, place: FloatArray) -> FloatArray:
    """Return how many metres a unit of x and of y is (2,), at a place (2,) where the unit is an angle.

    For longitude and latitude φ: N cos φ and M, the radii of curvature of the ellipsoid across and along the meridian.
    Scale distortions of a projection are not taken off: metres are those of the map.
    """
    flat = horizontal(crs)
    factors = [axis.unit_conversion_factor for axis in flat.axis_info[:2]] or [1.0, 1.0]
    if not flat.is_geographic or flat.ellipsoid is None:
        return np.array([factors[0], factors[0]])
    ellipsoid = flat.ellipsoid
    a, b = ellipsoid.semi_major_metre, ellipsoid.semi_minor_metre
    e2 = 1.0 - (b / a) ** 2
    sine = math.sin(place[1] * factors[0])
    across = a / math.sqrt(1.0 - e2 * sine**2)
    along = a * (1.0 - e2) / math.sqrt(1.0 - e2 * sine**2) ** 3
    return np.array([across * math.cos(place[1] * factors[0]), along]) * factors[0]


def short_unit(crs: CRS) -> str:
    """Return the unit as it stands behind numbers: 'm', 'degrees' ..."""
    name = unit_name(crs)
    return {"metre": "m", "degree": "degrees"}.get(name, name)


def unit_name(crs: CRS) -> str:
    """Return the unit of x and y, such as 'metre'."""
    axes = horizontal(crs).axis_info
    return str(axes[0].unit_name) if axes else "unit"


def linear_unit(crs: CRS) -> float:
    """Metres in one unit of a projected CRS."""
    return float(crs.axis_info[0].unit_conversion_factor) if crs.axis_info else 1.0


def metres_per_axis(crs: CRS, xyz: FloatArray) -> FloatArray:
    """Metres that one unit of x, y and z is worth at places of a map.

    Parameters
    ----------
    crs : CRS
        Projected or geographic.
    xyz : array (N, 3)

    Returns
    -------
    array (N, 3)
        For a projected CRS its units in metres of the map (its scale distortion is left in); for a geographic one the
        arcs of the parallel and of the meridian, N·cos φ and M of the ellipsoid.
    """
    out = np.ones((len(xyz), 3))
    if len(crs.axis_info) == 3:
        out[:, 2] = crs.axis_info[2].unit_conversion_factor
    if not crs.is_geographic:
        out[:, :2] = crs.axis_info[0].unit_conversion_factor
        return out
    ellipsoid = crs.ellipsoid
    assert ellipsoid is not None  # a geographic CRS has one
    a, b = ellipsoid.semi_major_metre, ellipsoid.semi_minor_metre
    e2 = 1.0 - (b / a) ** 2
    phi = np.radians(Transform(crs, geographic(crs))(xyz)[:, 1])
    w = np.sqrt(1.0 - e2 * np.sin(phi) ** 2)
    unit = crs.axis_info[0].unit_conversion_factor  # radians
    out[:, 0] = a / w * np.cos(phi) * unit
    out[:, 1] = a * (1.0 - e2) / w**3 * unit
    return out
