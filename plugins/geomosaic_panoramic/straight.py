"""A straight flight from its numbers: direction, speed, attitude."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping
from typing import Any

import numpy as np

from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic_panoramic.read import number, numbers

PER_STEP = {"scanner": "line", "sweeps": "sweep", "panoramic": "sweep"}
ODD = 20.0
"""How many times longer than wide, or wider than long, cells of a scanner may be without a word."""


def straight(options: Mapping[str, Any], kind: str, above: float, turn: float, where: str) -> np.ndarray:
    """East, north, up, speeds, attitude and rates of a straight flight (12,); metres and degrees."""
    heading = number(options, "heading", where) + turn
    course = math.radians(number(options, "course", where, heading - turn) + turn)
    advance = _advance(options, kind, above, where)
    return np.array(
        [
            0.0, 0.0, 0.0,
            advance * math.sin(course), advance * math.cos(course), number(options, "climb", where, 0.0),
            heading, number(options, "pitch", where, 0.0), number(options, "roll", where, 0.0),
            *numbers(options, "rates", 3, where, (0.0, 0.0, 0.0)),
        ]
    )  # fmt: skip


def _advance(options: Mapping[str, Any], kind: str, above: float, where: str) -> float:
    if "advance" in options and "v_over_h" in options:
        raise InputError("advance and v_over_h are given together", where=where, mend="give one of them")
    if "v_over_h" in options:
        if "ground_height" not in options:
            raise InputError("v_over_h needs the height above ground", where=where, mend="give ground_height")
        advance = number(options, "v_over_h", where) * above
    else:
        if "advance" not in options and kind != "panoramic":
            raise InputError("nothing says how fast the scanner advances", where=where, mend="give advance or v_over_h")
        advance = number(options, "advance", where, 0.0)
    if kind != "panoramic" and advance <= 0.0:
        raise InputError(
            f"the scanner advances by {advance:g} m per {PER_STEP[kind]}", where=where, mend="give a positive advance"
        )
    return advance


def cells(along: float, across: float, where: str) -> None:
    """Warn of ground cells, metres below the scanner, so far from square that an angle must be in another unit."""
    if not 1.0 / ODD <= along / across <= ODD:
        warnings.warn(
            f"{where}: below the scanner a pixel is {across:.3g} m across and {along:.3g} m along the flight; is "
            "field_of_view in degrees, and advance (or v_over_h) that of one line?",
            GeomosaicWarning,
            stacklevel=2,
        )
