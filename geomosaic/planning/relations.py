"""Quantities of planning and the formulas between them as data: each with its source, solved for any quantity.

Sources are named by what they are: 'K-2.8' are the Polish technical guidelines on orthophoto maps of 2001 (Wytyczne
Techniczne K-2.8) as lectures on orthophotos give them, 'Jensen' is J. R. Jensen, Introductory Digital Image Processing,
on geometric correction, 'Wolf' is Wolf, Dewitt and Wilkinson, Elements of Photogrammetry, on planimetric mapping.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol

from geomosaic.errors import InputError, did_you_mean


@dataclass(frozen=True)
class Quantity:
    """Named number with its unit and valid range.

    Attributes
    ----------
    unit : str, of the number; '1:' for the denominator of a scale, empty for a plain ratio
    text : str, meaning, as in the help
    least, most : float, the value lies above `least` (at it, where `closed`) and below `most`
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
    name : str, of `QUANTITIES`
    value : float, in the unit of the quantity

    Returns
    -------
    float, the value itself

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
        end = f" and below {known.most:.10g}" if known.most < float("inf") else ""
        raise InputError(
            f"{value:.10g} {known.unit} makes no sense as {known.text}",
            where=f"`{name}`",
            hint=f"give a value {start} {known.least:.10g}{end}",
        )
    return value


def shown(name: str, value: float) -> str:
    """Text of a value with its unit, to four digits, scales in whole numbers.

    Parameters
    ----------
    name : str, of `QUANTITIES`
    value : float, in the unit of the quantity

    Returns
    -------
    str, such as '1:13 000' or '6.096 mm'; thousands are set apart by a narrow no-break space
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
    """
    return ", ".join(f"`{name}`" for name in names)


# In metres; foot, inch and mile are the international ones.
LENGTHS = {
    "m": 1.0, "km": 1000.0, "cm": 1e-2, "mm": 1e-3, "µm": 1e-6, "um": 1e-6, "ft": 0.3048, "in": 0.0254, "mi": 1609.344,
}  # fmt: skip
# In radians.
ANGLES = {"°": math.pi / 180, "deg": math.pi / 180, "gon": math.pi / 200, "rad": 1.0, "mrad": 1e-3}
# In dots per inch.
RESOLUTIONS = {"dpi": 1.0, "px/mm": 25.4, "px/cm": 2.54}
SHARES = {"%": 1.0}
KINDS = (LENGTHS, ANGLES, RESOLUTIONS, SHARES)
# Thousands may be set apart by blanks, as `shown` does: what was printed can be given again.
_NUMBER = re.compile(r"\s*([-+]?(?:\d[\d\u202f ]*(?:\.\d*)?|\.\d+)(?:[eE][-+]?\d+)?)\s*([^\W\d_][\w/]*|[%°])?\s*")


def in_unit(text: str, unit: str) -> float:
    """Number of a text with or without a unit, converted to a quantity's unit.

    Parameters
    ----------
    text : str, such as '20000 ft', which is 6096 in metres; a plain number counts in `unit` itself
    unit : str, unit of the quantity, as in `Quantity.unit`

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


Values = Mapping[str, float]


class Relation(Protocol):
    """Equation between named quantities."""

    @property
    def formula(self) -> str:
        """Equation as text."""

    @property
    def source(self) -> str:
        """Source of the equation."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its quantities."""

    def solve(self, name: str, values: Values) -> float | None:
        """Value of one quantity from all others; None where these leave it open."""


@dataclass(frozen=True)
class Power:
    """Relation that is a product of powers: Π values[name]^exponent = constant.

    Attributes
    ----------
    formula, source : str, as in the help
    powers : mapping of str to float, exponent by the name of the quantity
    constant : float, units of the quantities included
    """

    formula: str
    source: str
    powers: Values
    constant: float

    @property
    def names(self) -> tuple[str, ...]:
        """Quantities."""
        return tuple(self.powers)

    def solve(self, name: str, values: Values) -> float | None:
        """One from the others; None where a divisor is 0."""
        rest = self.constant
        for other, exponent in self.powers.items():
            if other != name:
                if values[other] == 0 and exponent > 0:
                    return None
                # 0 to a negative power is infinite, where Python raises an error.
                rest /= values[other] ** exponent if values[other] else math.inf
        return float(rest ** (1.0 / self.powers[name]))


@dataclass(frozen=True)
class Curve:
    """Relation with a solution written out for each of its quantities.

    Attributes
    ----------
    formula, source : str, as in the help
    solutions : mapping of str to function
        By the name of the quantity: all other values → its value, None where these leave it open.
    """

    formula: str
    source: str
    solutions: Mapping[str, Callable[[Values], float | None]]

    @property
    def names(self) -> tuple[str, ...]:
        """Quantities."""
        return tuple(self.solutions)

    def solve(self, name: str, values: Values) -> float | None:
        """One from the others."""
        return self.solutions[name](values)


def _arc(ratio: float) -> float | None:
    """Angle in degrees whose cosine this is; None where there is none."""
    return math.degrees(math.acos(ratio)) if 0 < ratio <= 1 else None


def _sec(degrees: float) -> float:
    return 1.0 / math.cos(math.radians(degrees))


def _share(part: float, whole: float) -> float | None:
    """Overlap in per cent that steps of `part` leave of `whole`."""
    return 100.0 * (1.0 - part / whole) if part <= whole else None


def _lap(step: str, lap: str, side: str) -> Curve:
    """Step of exposures or strips: what of a photo's side on the ground the next one does not cover."""
    return Curve(
        f"{step} = (1 - {lap}/100) · {side} · M_photo",
        "geometry of the vertical photo",
        {
            step: lambda v: (1 - v[lap] / 100) * v[side] / 1000 * v["photo_scale"],
            lap: lambda v: _share(v[step], v[side] / 1000 * v["photo_scale"]),
            side: lambda v: 1000 * v[step] / ((1 - v[lap] / 100) * v["photo_scale"]),
            "photo_scale": lambda v: 1000 * v[step] / ((1 - v[lap] / 100) * v[side]),
        },
    )


SCALE = Power(
    "M_photo = H / c",
    "Jensen: attitude changes (12 inches at 20 000 feet give 1:20 000)",
    {"photo_scale": 1, "camera_constant": 1, "height": -1}, 1000.0,
)  # fmt: skip
RATIO = Power("K = M_photo / M_ortho", "K-2.8", {"photo_scale": 1, "ortho_scale": -1, "ratio": -1}, 1.0)
SCAN = Power(
    "scan dpi >= 320 dpi · M_photo / M_ortho",
    "K-2.8: requirements of scanning", {"scan_dpi": 1, "ratio": -1}, 320.0,
)  # fmt: skip
SCAN_PIXEL = Power(
    "scan pixel = 25 400 µm / scan dpi", "25.4 mm to the inch", {"scan_pixel": 1, "scan_dpi": 1}, 25400.0
)
GROUND_PIXEL = Power(
    "ground pixel = scan pixel · M_photo",
    "Müller and Sauleda 1988, table 1 (25 µm, c 85.52 mm, H 11.6 km give 3.4 m)",
    {"ground_pixel": 1, "scan_pixel": -1, "photo_scale": -1}, 1e-6,
)  # fmt: skip
ORTHO_PIXEL = Power(
    "ortho pixel = M_ortho · 25.4 mm / ortho dpi", "K-2.8: pixel of the orthophoto (317 dpi grey, 254 dpi colour)",
    {"ortho_pixel": 1, "ortho_dpi": 1, "ortho_scale": -1}, 0.0254,
)  # fmt: skip
RELIEF = Power(
    "m_O = m_DTM · r / c", "K-2.8: requirements of accuracy",
    {"shift": 1, "camera_constant": 1, "dem_error": -1, "radius": -1}, 1.0,
)  # fmt: skip
DEM_LIMIT = Power(
    "m_DTM <= 0.3 mm · M_ortho · (140 mm / r) · (c / 150 mm)", "K-2.8: table of height errors",
    {"dem_limit": 1, "radius": 1, "ortho_scale": -1, "camera_constant": -1}, 0.3e-3 * 140 / 150,
)  # fmt: skip
SHIFT = Power(
    "m_O on the map = m_O / M_ortho", "K-2.8: radial shifts in mm", {"shift_mm": 1, "ortho_scale": 1, "shift": -1}, 1e3
)
POSITION = Power(
    "error on the map = error on the ground / M_ortho", "K-2.8: 0.3 mm on the map",
    {"position_mm": 1, "ortho_scale": 1, "position_error": -1}, 1e3,
)  # fmt: skip
DISPLACEMENT = Power(
    "d = r · h / H", "Wolf: relief displacement", {"displacement": 1, "height": 1, "radius": -1, "object_height": -1}, 1
)
SWATH = Curve(
    "swath = 2 · H · tan(field / 2)",
    "Jensen: ground swath width (90° at 6000 m give 12 000 m)",
    {
        "swath": lambda v: 2 * v["height"] * math.tan(math.radians(v["field"]) / 2),
        "height": lambda v: v["swath"] / (2 * math.tan(math.radians(v["field"]) / 2)),
        "field": lambda v: 2 * math.degrees(math.atan(v["swath"] / (2 * v["height"]))),
    },
)
CELL = Power("D = beta · H", "Jensen: ground resolution cell", {"cell": 1, "ifov": -1, "height": -1}, 1e-3)
CELL_ALONG = Curve(
    "D along = beta · H · sec(phi)",
    "Jensen: cell size off nadir",
    {
        "cell_along": lambda v: v["cell"] * _sec(v["angle"]),
        "cell": lambda v: v["cell_along"] / _sec(v["angle"]),
        "angle": lambda v: _arc(v["cell"] / v["cell_along"]),
    },
)
CELL_ACROSS = Curve(
    "D across = beta · H · sec²(phi)",
    "Jensen: cell size off nadir",
    {
        "cell_across": lambda v: v["cell"] * _sec(v["angle"]) ** 2,
        "cell": lambda v: v["cell_across"] / _sec(v["angle"]) ** 2,
        "angle": lambda v: _arc(math.sqrt(v["cell"] / v["cell_across"])),
    },
)
BASE = _lap("base", "overlap", "format_along")
SPACING = _lap("spacing", "sidelap", "format_across")

# Formulas that belong together, by the name of their command.
TOPICS: dict[str, tuple[Relation, ...]] = {
    "photo": (SCALE, RATIO, SCAN, SCAN_PIXEL, GROUND_PIXEL, ORTHO_PIXEL),
    "relief": (SCALE, RELIEF, SHIFT, DEM_LIMIT, DISPLACEMENT),
    "accuracy": (POSITION,),
    "swath": (SWATH, CELL, CELL_ALONG, CELL_ACROSS),
    "overlap": (SCALE, BASE, SPACING),
}
