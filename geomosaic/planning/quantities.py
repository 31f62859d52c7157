"""Quantities of planning: names, units, meanings and valid ranges."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass

from geomosaic.errors import InputError, did_you_mean


@dataclass(frozen=True)
class Quantity:
    """Named number with its unit and valid range.

    Attributes
    ----------
    unit : str
        Of the number; '1:' for the denominator of a scale, empty for a plain ratio.
    text : str
        Meaning, as in the help.
    least, most : float
        The value lies above `least` (at it, where `closed`) and below `most`.
    closed : bool
    """

    unit: str
    text: str
    least: float = 0.0
    most: float = float("inf")
    closed: bool = False


QUANTITIES: dict[str, Quantity] = {
    "photo_scale": Quantity("1:", "scale of the photo", 0.0),
    "ortho_scale": Quantity("1:", "scale of the photo map"),
    "height": Quantity("m", "flying height above the ground"),
    "camera_constant": Quantity("mm", "camera constant (focal length) c"),
    "ratio": Quantity("", "K, how many times the photo is enlarged: M_photo / M_ortho"),
    "scan_dpi": Quantity("dpi", "scanning resolution"),
    "scan_pixel": Quantity("µm", "pixel of the scan on the film"),
    "ground_pixel": Quantity("m", "pixel of the scan on the ground"),
    "ortho_pixel": Quantity("m", "pixel of the photo map on the ground"),
    "ortho_dpi": Quantity("dpi", "resolution of the photo map at its scale"),
    "radius": Quantity("mm", "distance r from the principal point in the photo"),
    "dem_error": Quantity("m", "error of heights m_DTM", 0.0, closed=True),
    "dem_limit": Quantity("m", "largest error of heights that the guidelines K-2.8 allow"),
    "shift": Quantity("m", "radial shift on the ground that an error of height causes, m_O", 0.0, closed=True),
    "shift_mm": Quantity("mm", "that shift on the map", 0.0, closed=True),
    "position_error": Quantity("m", "error of position of the photo map, on the ground", 0.0, closed=True),
    "position_mm": Quantity("mm", "error of position on the map, on paper", 0.0, closed=True),
    "object_height": Quantity("m", "height of an object above the ground", 0.0, closed=True),
    "displacement": Quantity("mm", "relief displacement of the object in the photo", 0.0, closed=True),
    "field": Quantity("°", "whole angle of view across the track", 0.0, 180.0),
    "swath": Quantity("m", "width of the strip of ground that is scanned"),
    "ifov": Quantity("mrad", "angle of view of one cell"),
    "angle": Quantity("°", "scan angle off nadir", 0.0, 90.0, closed=True),
    "cell": Quantity("m", "cell on the ground at nadir"),
    "cell_along": Quantity("m", "cell off nadir, along the track"),
    "cell_across": Quantity("m", "cell off nadir, across the track"),
    "format_along": Quantity("mm", "side of the photo along the strip"),
    "format_across": Quantity("mm", "side of the photo across the strip"),
    "overlap": Quantity("%", "overlap along the strip", 0.0, 100.0, closed=True),
    "sidelap": Quantity("%", "overlap of strips", 0.0, 100.0, closed=True),
    "base": Quantity("m", "distance between exposures"),
    "spacing": Quantity("m", "distance between strips"),
}


def checked(name: str, value: float) -> float:
    """Value of a quantity, refused outside its valid range.

    Parameters
    ----------
    name : str
        Of `QUANTITIES`.
    value : float
        In the unit of the quantity.

    Returns
    -------
    float
        The value itself.

    Raises
    ------
    InputError
        There is no such quantity, or the value is outside its range.
    """
    known = QUANTITIES.get(name)
    if known is None:
        raise InputError(f"there is no quantity '{name}'", hint=did_you_mean(name, QUANTITIES) or "see the help")
    inside = (known.least <= value if known.closed else known.least < value) and value < known.most
    if not inside:
        start = "from" if known.closed else "above"
        end = f" and below {known.most:g}" if known.most < float("inf") else ""
        raise InputError(
            f"{value:g} {known.unit} makes no sense as {known.text}",
            where=f"`{name}`",
            hint=f"give a value {start} {known.least:g}{end}",
        )
    return value


def shown(name: str, value: float) -> str:
    """Text of a value with its unit, to four digits, scales in whole numbers.

    Parameters
    ----------
    name : str
        Of `QUANTITIES`.
    value : float
        In the unit of the quantity.

    Returns
    -------
    str
        Such as '1:13 000' or '6.096 mm'; thousands are set apart by a narrow no-break space.
    """
    unit = QUANTITIES[name].unit
    if unit == "1:":
        return f"1:{value:,.0f}".replace(",", "\u202f") if value >= 1000 else f"1:{value:.4g}"
    digits = f"{value:,.0f}".replace(",", "\u202f") if abs(value) >= 10000 else f"{value:.4g}"
    return f"{digits} {unit}".strip() if unit != "°" else f"{digits}°"


def parameters(names: Iterable[str]) -> str:
    """List of quantities for messages, each name in backquotes.

    Parameters
    ----------
    names : iterable of str

    Returns
    -------
    str
    """
    return ", ".join(f"`{name}`" for name in names)


LENGTHS = {
    "m": 1.0, "km": 1000.0, "cm": 1e-2, "mm": 1e-3, "µm": 1e-6, "um": 1e-6, "ft": 0.3048, "in": 0.0254, "mi": 1609.344,
}  # fmt: skip
"""In metres; foot, inch and mile are the international ones."""
ANGLES = {"°": math.pi / 180, "deg": math.pi / 180, "gon": math.pi / 200, "rad": 1.0, "mrad": 1e-3}
"""In radians."""
RESOLUTIONS = {"dpi": 1.0, "px/mm": 25.4, "px/cm": 2.54}
"""In dots per inch."""
SHARES = {"%": 1.0}
KINDS = (LENGTHS, ANGLES, RESOLUTIONS, SHARES)
# Thousands may be set apart by blanks, as `shown` does: what was printed can be given again.
_NUMBER = re.compile(r"\s*([-+]?(?:\d[\d\u202f ]*(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\W\d_][\w/]*|[%°])?\s*")


def in_unit(text: str, unit: str) -> float:
    """Number of a text with or without a unit, converted to a quantity's unit.

    Parameters
    ----------
    text : str
        Such as '20000 ft', which is 6096 in metres; a plain number counts in `unit` itself.
    unit : str
        Unit of the quantity, as in `Quantity.unit`.

    Returns
    -------
    float

    Raises
    ------
    InputError
        It is no number, or its unit measures something else.
    """
    # The Greek letter and the micro sign look alike, and keyboards have either.
    found = _NUMBER.fullmatch(text.replace("\N{GREEK SMALL LETTER MU}", "µ"))
    if found is None:
        raise InputError(f"'{text}' is no number", hint=f"write it as 150 or with its unit, {_known(unit)}")
    number = float(re.sub(r"[ \u202f]", "", found[1]))
    given = found[2]
    if given is None or given == unit:
        return number
    kind = next((kind for kind in KINDS if unit in kind), {})
    if given not in kind:
        what = f"counts in {unit}" if unit else "has no unit"
        raise InputError(f"'{text}' has a unit that does not fit: the value {what}", hint=f"write it in {_known(unit)}")
    return number * kind[given] / kind[unit]


def _known(unit: str) -> str:
    kind = next((kind for kind in KINDS if unit in kind), None)
    return "plain digits" if kind is None else ", ".join(kind)
