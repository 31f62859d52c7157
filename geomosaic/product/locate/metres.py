"""Lengths on a map in metres."""

from __future__ import annotations

import numpy as np
from pyproj import CRS

from geomosaic.geo.crs import geographic
from geomosaic.geo.transform import Transform
from geomosaic.types import FloatArray


def metres_per_unit(crs: CRS, xyz: FloatArray) -> FloatArray:
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
