"""Stakes of an undeclared vertical datum: what a mistake would cost in metres, before anything is computed."""

from __future__ import annotations

import math

import numpy as np
from pyproj import CRS

from geomosaic.errors import HeightDatumError, InputError
from geomosaic.geo.crs import horizontal, with_heights
from geomosaic.geo.transform import Transform


def undulation(crs: CRS, x: float, y: float) -> float:
    """Height of the EGM96 geoid above the WGS 84 ellipsoid at a place of a map.

    Parameters
    ----------
    crs : CRS
        Of the map.
    x, y : float
        In `crs`.

    Returns
    -------
    float
        Metres; NaN where it cannot be known (a CRS that is not tied to the Earth, a place outside it).
    """
    wgs84 = CRS.from_epsg(4326)
    try:
        place = Transform(horizontal(crs), wgs84)(np.array([[x, y]]))
        geoid = Transform(with_heights(wgs84, "egm96"), CRS.from_epsg(4979))
        return float(geoid(np.column_stack([place, [0.0]]))[0, 2])
    except InputError:
        return math.nan


def undeclared_heights(crs: CRS, x: float, y: float, where: str) -> HeightDatumError:
    """Error for heights without a vertical datum, with what a wrong guess would cost at this place.

    Parameters
    ----------
    crs : CRS
        Horizontal, of the heights.
    x, y : float
        Place of the heights, in `crs`.
    where : str
        File or parameter at fault.

    Returns
    -------
    HeightDatumError
        Made, not raised.
    """
    shift = undulation(crs, x, y)
    size = ""
    if math.isfinite(shift):
        size = (
            f": whether they count from the geoid or from the ellipsoid makes {abs(shift):.1f} m here (EGM96), which "
            f"moves a place seen 30 degrees off nadir by {abs(shift) * math.tan(math.radians(30)):.1f} m"
        )
    return HeightDatumError(
        f"the heights have no vertical datum{size}",
        where=where,
        hint="say what they count from: `dem_heights`: ellipsoidal, egm96, EPSG:<vertical CRS>, or the path of a geoid "
        "grid",
    )
