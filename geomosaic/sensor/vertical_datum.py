"""Vertical datum of positions: required of every sensor, with the cost of a wrong guess."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable

import numpy as np
from pyproj import CRS

from geomosaic.errors import GeomosaicError, HeightDatumError
from geomosaic.geo.crs import geographic, has_heights, horizontal, with_heights
from geomosaic.geo.transform import Transform
from geomosaic.sensor.model import SensorModel
from geomosaic.sensor.solve.inverse import image_to_height
from geomosaic.surface.model import undulation

DATUMS = "ellipsoidal, egm96, an EPSG code of a vertical CRS, or the path of a geoid grid"
"""What a vertical datum may be."""


def require_vertical_datum(crs: CRS, what: str, where: str, build: Callable[[CRS], SensorModel]) -> None:
    """Check that the heights of positions have a declared vertical datum.

    Parameters
    ----------
    crs : CRS
        Of positions or control points.
    what : str
        Whose heights, such as 'the control points'.
    where : str
        Image.
    build : callable
        Makes the model with a CRS whose heights are declared, to see what a wrong guess would cost.

    Raises
    ------
    HeightDatumError
        With the shift in metres and pixels that a wrong guess could cause there, and the option that settles it.
    """
    if has_heights(crs):
        return
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            risk = _risk_of_model(build(with_heights(crs, "ellipsoidal")))
    except GeomosaicError:
        risk = ""
    raise HeightDatumError(
        f"the heights of {what} have no vertical datum{risk}",
        where=where,
        hint=f"declare it with `heights`: {DATUMS}",
    )


def _risk_of_model(model: SensorModel) -> str:
    """Cost of confusing ellipsoidal with geoid heights, with the undulation at the model's seed."""
    level = geographic(model.crs)
    x, y, _ = Transform(model.crs, level)(np.array([model.seed]))[0]
    shift = undulation(horizontal(level), float(x), float(y))
    return datum_risk(shift, pixels_per_metre(model) if math.isfinite(shift) else math.nan)


def datum_risk(shift: float, per_metre: float) -> str:
    """Cost of confusing ellipsoidal with geoid heights, as the end of a message.

    Parameters
    ----------
    shift : float
        Geoid undulation, metres; NaN where unknown.
    per_metre : float
        Pixels that one metre of height moves the image; NaN where unknown.

    Returns
    -------
    str
        Metres on the ground and pixels in the image; '' where the undulation is unknown.
    """
    if not math.isfinite(shift):
        return ""
    seen = f" (up to {abs(shift) * per_metre:.3g} px in the image)" if math.isfinite(per_metre) else ""
    return f"; ellipsoidal and geoid heights differ by {abs(shift):.1f} m here{seen}"


def pixels_per_metre(model: SensorModel) -> float:
    """Sensitivity of an image to height: largest movement of a ground point raised by one metre.

    The ground is taken level, at the height of the model's seed.

    Parameters
    ----------
    model : SensorModel

    Returns
    -------
    float
        Pixels per metre, over the corners and the centre of the image; NaN if unknown.
    """
    level = geographic(model.crs)
    width, height = model.size
    # An oblique image moves most at one of its corners, a vertical one at all of them.
    corners = np.array([[0.0, 0.0], [width, 0.0], [0.0, height], [width, height], [width / 2, height / 2]])
    to_model = Transform(level, model.crs)
    try:
        z = float(Transform(model.crs, level)(np.array([model.seed]))[0, 2])
        ground = image_to_height(model, corners, z, level)
        raised = ground + np.array([0.0, 0.0, 1.0])
        moved = model.ground_to_image(to_model(raised)) - model.ground_to_image(to_model(ground))
    except GeomosaicError:
        return math.nan
    length = np.hypot(moved[:, 0], moved[:, 1])
    return float(np.nanmax(length)) if np.isfinite(length).any() else math.nan
