"""Plausibility of a photo's position and orientation: vertical datum, views of the sky, angles in the wrong unit."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable

import numpy as np
from pyproj import CRS

from geomosaic.errors import GeomosaicError, HeightDatumError, InputError
from geomosaic.geo.crs import geographic, has_heights, horizontal, with_heights
from geomosaic.geo.local_frames import enu_axes
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import axis_unit
from geomosaic.sensor.plugin import HasRays, SensorModel
from geomosaic.sensor.solve.inverse import image_to_height
from geomosaic.surface.model import undulation
from geomosaic.types import FloatArray

# What a vertical datum may be.
DATUMS = "ellipsoidal, egm96, an EPSG code of a vertical CRS, or the path of a geoid grid"


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


class SkyError(InputError):
    """A photo of the ground that looks above the horizon."""


# Degrees within which an image axis follows the line of flight.
ALIGNED = 10.0


def centre_dip(model: SensorModel) -> float | None:
    """Depression angle of the ray through the image's centre: positive below the horizon, negative towards the sky.

    The horizon is the plane across the ellipsoid's normal at the ray's origin, or across the z axis of a map CRS.

    Parameters
    ----------
    model : SensorModel

    Returns
    -------
    float or None
        Degrees, −90 to 90; None for a model without rays.
    """
    if not isinstance(model, HasRays):
        return None
    width, height = model.size
    origins, directions = model.rays(np.array([[width / 2, height / 2]]))
    up = np.array([0.0, 0.0, 1.0])
    if model.crs.is_geocentric:
        longitude, latitude, _ = Transform(model.crs, geographic(model.crs))(origins)[0]
        up = enu_axes(longitude, latitude)[2]
    return float(-np.degrees(np.arcsin(np.clip(directions[0] @ up, -1.0, 1.0))))


def unit_suspicion(angles_deg: FloatArray, positions: FloatArray, crs: CRS | None = None) -> str | None:
    """Unit that the angles of a block probably have, when degrees do not fit the flight and another unit does.

    Parameters
    ----------
    angles_deg : array (N, 3)
        Omega, phi, kappa as given, taken for degrees.
    positions : array (N, 3) or (N, 2)
        Projection centres in map units.
    crs : CRS, optional
        Of the positions. Where it counts in degrees, a unit of longitude is shorter than one of latitude.

    Returns
    -------
    str or None
        A sentence for the user, or None where nothing is suspicious, or nothing can be concluded.
    """
    # A frame camera is mounted along or across the aircraft, so kappa, counter-clockwise from the map's x axis, is the
    # direction of flight up to multiples of 90°. That direction is taken from each photo to its nearest neighbour.
    angles, places = np.asarray(angles_deg, dtype=np.float64), np.asarray(positions, dtype=np.float64)
    good = np.isfinite(angles).all(axis=1) & np.isfinite(places).all(axis=1)
    angles, places = angles[good], places[good, :2]
    # A degree of longitude is shorter than one of latitude by the cosine of the latitude.
    shrink = np.ones(len(places))
    if crs is not None and crs.is_geographic:
        shrink = np.cos(places[:, 1] * axis_unit(crs))
    flight = _flight_directions(places, shrink)
    known = np.isfinite(flight)
    if np.count_nonzero(known) < 2:
        return None
    kappa, flight = angles[known, 2], flight[known]
    # Degrees fit the flight: no suspicion, whatever else would fit as well.
    if _aligned(kappa, flight):
        return None
    # Radians never exceed half a turn, gons never a whole one of 400.
    if np.abs(angles).max() <= np.pi + 1e-6 and _aligned(np.degrees(kappa), flight):
        return _sentence("radians", "rad")
    # Where the nearest photo is one of another strip, gons follow that direction by chance. Kappas themselves tell: of
    # strips flown to and fro they agree up to quarter turns in their own unit, and 200 gon are no half turn of degrees.
    agree = _spread(kappa) <= 1.5 * _spread(0.9 * kappa)
    if np.abs(angles).max() <= 400.0 and _aligned(0.9 * kappa, flight) and not agree:
        return _sentence("gons", "gon")
    return None


def _sentence(unit: str, name: str) -> str:
    return (
        f"the angles look like {unit}: read as degrees, kappa does not follow the direction of flight; read as {unit} "
        f"it does in every photo. If so, set angle_unit = '{name}'"
    )


def _flight_directions(xy: FloatArray, shrink: FloatArray) -> FloatArray:
    """Direction in degrees, counter-clockwise from x, from each point to its nearest other point; NaN without one."""
    # `shrink` is the length of a unit of x at each point, in units of y: the cosine of the latitude in a map in
    # degrees.
    directions = np.full(len(xy), np.nan)
    for i, place in enumerate(xy):
        step = (xy - place) * (shrink[i], 1.0)
        distance = np.hypot(step[:, 0], step[:, 1])
        # The point itself, and stations that are there twice, give no direction.
        distance[distance == 0.0] = np.inf
        if len(xy) > 1 and np.isfinite(distance.min()):
            dx, dy = step[np.argmin(distance)]
            directions[i] = np.degrees(np.arctan2(dy, dx))
    return directions


def _spread(kappa: FloatArray) -> float:
    """Smallest range of degrees that holds every kappa, up to multiples of 90°."""
    quarter = np.sort(np.mod(kappa, 90.0))
    return float(90.0 - np.diff(quarter, append=quarter[0] + 90.0).max())


def _aligned(kappa: FloatArray, flight: FloatArray) -> bool:
    """Whether every kappa follows the flight within 10°, up to multiples of 90° (all in degrees)."""
    off = np.mod(kappa - flight + 45.0, 90.0) - 45.0
    return bool((np.abs(off) <= ALIGNED).all())
