"""The formulas as data: each with its source, and solved for any of its quantities.

Sources are named by what they are: 'K-2.8' are the Polish technical guidelines on orthophoto maps of 2001 (Wytyczne
Techniczne K-2.8) as lectures on orthophotos give them, 'Jensen' is J. R. Jensen, Introductory Digital Image Processing,
on geometric correction, 'Wolf' is Wolf, Dewitt and Wilkinson, Elements of Photogrammetry, on planimetric mapping.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

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
    formula, source : str
        As in the help.
    powers : mapping of str to float
        Exponent by the name of the quantity.
    constant : float
        Units of the quantities included.
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
    formula, source : str
        As in the help.
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

TOPICS: dict[str, tuple[Relation, ...]] = {
    "photo": (SCALE, RATIO, SCAN, SCAN_PIXEL, GROUND_PIXEL, ORTHO_PIXEL),
    "relief": (SCALE, RELIEF, SHIFT, DEM_LIMIT, DISPLACEMENT),
    "accuracy": (POSITION,),
    "swath": (SWATH, CELL, CELL_ALONG, CELL_ACROSS),
    "overlap": (SCALE, BASE, SPACING),
}
"""Formulas that belong together, by the name of their command."""
