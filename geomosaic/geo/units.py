"""Units of map coordinates and of heights: their names, and their length in metres."""

from __future__ import annotations

import numpy as np
from pyproj import CRS

from geomosaic.geo.crs import horizontal
from geomosaic.types import FloatArray

# Mean radius of the Earth (2a + b) / 3 in metres, for what needs no better one.
EARTH_RADIUS = 6371008.8


def unit_name(crs: CRS) -> str:
    """Name of the unit of x and y, such as 'metre'.

    Parameters
    ----------
    crs : CRS

    Returns
    -------
    str
        'unit' where the CRS has no axes.
    """
    axes = horizontal(crs).axis_info
    return str(axes[0].unit_name) if axes else "unit"


def short_unit(crs: CRS) -> str:
    """Unit of x and y as it stands behind numbers: 'm', 'degrees' ...

    Parameters
    ----------
    crs : CRS
    """
    name = unit_name(crs)
    return {"metre": "m", "degree": "degrees"}.get(name, name)


def length_unit(crs: CRS) -> str:
    """Unit of lengths on the ground: 'm', or that of a frame whose unit has no known length, 'pixel' or 'unit'.

    Parameters
    ----------
    crs : CRS
    """
    name = unit_name(crs)
    return name if name in ("pixel", "unit") else "m"


def axis_unit(crs: CRS) -> float:
    """Length of one unit of x and y: metres, or radians of a geographic CRS.

    Parameters
    ----------
    crs : CRS
    """
    axes = horizontal(crs).axis_info
    return float(axes[0].unit_conversion_factor) if axes else 1.0


def height_unit(crs: CRS) -> float:
    """Metres in one unit of heights.

    Parameters
    ----------
    crs : CRS
        3-D, or 2-D without heights.

    Returns
    -------
    float
        1 where the CRS has no heights.
    """
    return float(crs.axis_info[2].unit_conversion_factor) if len(crs.axis_info) == 3 else 1.0


def linear_unit(crs: CRS) -> float:
    """Metres in one unit of x and y; of a geographic CRS roughly, an arc of the meridian of a sphere.

    Parameters
    ----------
    crs : CRS
    """
    return axis_unit(crs) * (EARTH_RADIUS if horizontal(crs).is_geographic else 1.0)


def metres_per_unit(crs: CRS, places: FloatArray) -> FloatArray:
    """Metres in one unit of each coordinate, at places.

    For longitude and latitude φ: N cos φ and M, with the radii of curvature of the ellipsoid across and along the
    meridian. The scale distortion of a projection is left in: metres are those of the map.

    Parameters
    ----------
    crs : CRS
        Projected or geographic.
    places : array (..., 2) or (..., 3)
        Coordinates in `crs`.

    Returns
    -------
    array of the same shape
    """
    places = np.asarray(places, dtype=np.float64)
    unit, flat = axis_unit(crs), horizontal(crs)
    out = np.full(places.shape, unit)
    out[..., 2:] = height_unit(crs)
    ellipsoid = flat.ellipsoid
    if flat.is_geographic and ellipsoid is not None:
        a, b = ellipsoid.semi_major_metre, ellipsoid.semi_minor_metre
        e2 = 1.0 - (b / a) ** 2
        phi = places[..., 1] * unit
        w = np.sqrt(1.0 - e2 * np.sin(phi) ** 2)
        out[..., 0] = a / w * np.cos(phi) * unit
        out[..., 1] = a * (1.0 - e2) / w**3 * unit
    return out
