"""A flight corrected by control points, each of its parameters within an a-priori sigma.

Over level ground the place of a scanner and the tilt of its view are nearly one thing: a shift ahead and a pitch move
the whole image alike, and so, near the nadir, do a shift aside and a roll. So nothing is free by default. The sigmas
share a correction between the two, and relief tells them apart where there is enough of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from pyproj import CRS

from geomosaic.errors import SensorInputError, SolveError
from geomosaic.geo.transform import Transform
from geomosaic.sensor.inputs import known_keys, number, point_rows
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.solve import resect
from geomosaic.types import FloatArray
from geomosaic_panoramic.flight import word
from geomosaic_panoramic.model import PanoramicModel

POINT = ("x", "y", "z", "col", "row")
GROUPS = {
    "position": ("east", "north", "up"),
    "speed": ("speed_east", "speed_north"),
    "angles": ("heading", "pitch", "roll"),
    "rates": ("heading_rate", "pitch_rate", "roll_rate"),
}
NOMINAL = {"position": 0.05, "speed": 0.05, "angles": math.degrees(0.05), "rates": 0.0}
"""Of a flight told by nominal numbers: shares of the height above ground and of the advance; degrees."""
MEASURED = {"position": 1.0, "speed": 0.0, "angles": 0.5, "rates": 0.0}
"""Of a track: metres, and degrees of a boresight before it is calibrated."""


def adjusted(model: PanoramicModel, request: SensorRequest, crs: CRS, above: float) -> PanoramicModel:
    """Model corrected by the control points of a request, where it has any.

    Parameters
    ----------
    model : PanoramicModel
    request : SensorRequest
    crs : CRS
        3-D, of the points.
    above : float
        Height of the position above the ground, metres.

    Returns
    -------
    PanoramicModel

    Raises
    ------
    InputError
        The inputs are no control points or no sigmas.
    SolveError
        The scanner sees none of the points.
    """
    where, options = request.image, request.options
    sigmas = _sigmas(model, request, above)
    refine = word(options, "refine", ("points", "none"), where, "points")
    if options.get("points") is None:
        return model
    names, rows = point_rows(options["points"], POINT, where)
    if refine == "none" or not rows:
        return model
    table = np.array(rows)
    try:
        ground = Transform(crs, model.crs)(table[:, :3])
        solved = resect(model, ground, table[:, 3:5], table[:, 5], priors=sigmas)
    except SolveError as error:
        error.where = where
        raise
    return replace(solved.model, notes=(*solved.model.notes, _words(names, solved.residuals)))


def _sigmas(model: PanoramicModel, request: SensorRequest, above: float) -> FloatArray:
    """A-priori sigmas: those of what is known of the flight, then of groups, then of single parameters."""
    where, table = request.image, request.options.get("sigmas", {})
    if not isinstance(table, Mapping):
        raise SensorInputError(
            f"sigmas = {table!r} is not a table", name="sigmas", where=where, hint=f"give {', '.join(GROUPS)}"
        )
    names = model.parameters.names
    known_keys(table, (*GROUPS, *names), f"{where}, sigmas")
    units = {"position": above, "speed": model.track.pace, "angles": 1.0, "rates": 1.0}
    usual = MEASURED if "track" in request.options else {name: NOMINAL[name] * units[name] for name in GROUPS}
    values = dict.fromkeys(names, 0.0)
    for group, members in GROUPS.items():
        sigma = number(table[group], f"sigmas, {group}", where) if group in table else usual[group]
        values.update(dict.fromkeys(members, sigma))
    values.update({name: number(table[name], f"sigmas, {name}", where) for name in names if name in table})
    negative = [name for name, value in values.items() if value < 0.0]
    if negative:
        raise SensorInputError(
            f"the sigma of {negative[0]} is negative", name="sigmas", where=where, hint="0 holds it fixed"
        )
    return np.array(list(values.values()))


def _words(names: list[str], residuals: FloatArray) -> str:
    length = np.hypot(residuals[:, 0], residuals[:, 1])
    worst, rms = int(np.nanargmax(length)), float(np.sqrt(np.nanmean(length**2)))
    unseen = [name for name, one in zip(names, length, strict=True) if not np.isfinite(one)]
    more = f"; not seen: {', '.join(unseen)}" if unseen else ""
    return f"{len(names)} control points: RMS {rms:.2f} px, worst {length[worst]:.2f} px at {names[worst]}{more}"
