"""Angles that were probably meant in another unit: an error where the unit was not declared, a note where it was."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence

import numpy as np
from pyproj import CRS

from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.project.orientation.exterior import Exterior, ExteriorTable
from geomosaic.types import FloatArray

TO_DEGREES = {"deg": 1.0, "gon": 0.9, "rad": 180.0 / math.pi}

HEADINGS: Mapping[str, tuple[tuple[str, float], ...]] = {
    "opk": (("omega", 1.0), ("phi", 1.0), ("kappa", 1.0)),
    "pok": (("omega", 1.0), ("phi", 1.0), ("kappa", 1.0)),
    "rpy": (("roll", 1.0), ("pitch", 1.0), ("yaw", -1.0)),
    "dji": (("gimbal_roll", 1.0), ("gimbal_pitch", 1.0), ("gimbal_yaw", -1.0)),
}
"""Two tilts and the turn of each system, the turn counted counter-clockwise as kappa is, up to multiples of 90°."""


def check_units(table: ExteriorTable, unit: str | None, rows: Sequence[Exterior], crs: CRS | None = None) -> None:
    """Stop where angles without a declared unit look as if they were not in degrees; note it where one is declared.

    Parameters
    ----------
    table : ExteriorTable
    unit : str or None
        As declared; None is degrees.
    rows : sequence of Exterior
        Those that tell of the unit: all of the table.
    crs : CRS, optional
        Of the positions.
    """
    if unit is not None and unit not in TO_DEGREES:
        raise InputError(f"no angle unit named '{unit}'", mend=f"use one of {', '.join(TO_DEGREES)}")
    turns = HEADINGS.get(table.system)
    if turns is None or not rows:
        return
    from geomosaic.sensor.sanity import unit_suspicion

    given = np.array([[sign * row.angles[name] for name, sign in turns] for row in rows])
    angles = given * TO_DEGREES[unit or "deg"]
    text = unit_suspicion(angles, np.array([row.position for row in rows]), crs)
    if text is None and half_turns_in_radians(angles):
        text = "the angles look like radians: read as degrees, no tilt reaches 0.15° and every heading is near 0 or π"
    if text is None:
        return
    if unit is not None:
        warnings.warn(f"{table.path}: declared as '{unit}', but {text}", GeomosaicWarning, stacklevel=2)
        return
    raise InputError(
        text, where=table.path, mend="declare the unit, whichever it is: --angle-unit, or angle_unit under [exterior]"
    )


def half_turns_in_radians(angles: FloatArray) -> bool:
    """Whether angles (N, 3), taken for degrees, are those of strips flown to and fro in radians.

    Strips along the map's x axis have headings near 0 and π radians. Read as degrees both are small turns that follow
    the flight, so the direction of flight gives nothing away; but such small tilts, with headings at 0 and at 3.14 and
    nowhere between, do not happen.
    """
    tilts, turns = np.abs(angles[:, :2]), np.abs(angles[:, 2])
    to, fro = turns < 0.25, np.abs(turns - math.pi) < 0.25
    return bool(tilts.max() < 0.15 and (to | fro).all() and to.any() and fro.any() and tilts.max() > 0.0)
