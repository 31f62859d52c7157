"""Scale bar and north arrows: grid north, true north, magnetic north."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from geomosaic.errors import InputError
from geomosaic.geo.magnetic_declination import NAME
from geomosaic.numbers import angle_text, grouped, round_below
from geomosaic.sheets.drawing.canvas import CAP, POINT, Canvas, text_size
from geomosaic.sheets.layout import Declination, Layout
from geomosaic.sheets.page import Box, Page
from geomosaic.types import FloatArray

_FOOT_M = 0.3048
# Height in mm of one row of the bar.
ROW = 1.1


def bar_divisions(length: float) -> int:
    """Number of parts of a bar: 5 for 5 and 10, 4 for 2 and 4, 3 otherwise; each part is then a round length.

    Parameters
    ----------
    length : float
    """
    lead = length / 10.0 ** math.floor(math.log10(length) + 1e-9)
    return {1: 5, 2: 4, 4: 4, 5: 5}.get(round(lead), 3)


def bar_length(longest: float) -> float:
    """Length of a bar: the largest of 1 to 5 times a power of ten that is not longer.

    Parameters
    ----------
    longest : float
    """
    return round_below(longest, (1, 2, 3, 4, 5))


# Length of a bar in mm that its figures need; beyond 11 cm a bar is no easier to read.
_SHORTEST, _LONGEST = 10.0, 110.0
# Room in mm beside a bar for its figures.
_BESIDE = 12.0


def _scale_text(scale: float) -> str:
    """Write the scale as a fraction: '1 : 25 000'."""
    return f"1 : {grouped(scale, 0 if abs(scale - round(scale)) < 1e-6 else 1)}"


def draw_scale(
    canvas: Canvas, page: Page, layout: Layout, place: float | tuple[float, float], top: float, room: float
) -> Box:
    """Number and bars below each other, centred; returns their box.

    Parameters
    ----------
    canvas : Canvas
    page : Page
    layout : Layout
    place : float or (float, float)
        The left end, or the two between which they are centred, mm.
    top : float, mm
    room : float, width in mm that there is

    Raises
    ------
    InputError
        A bar of the length that the layout wants does not fit.
    """
    number, per_metre = _scale_text(page.scale), 1000.0 / page.scale
    length = _bar_length(layout, per_metre, room) if layout.scalebar.show else 0.0
    half = max(text_size(number, 10.0, True)[0], length * per_metre + _BESIDE if length else 0.0) / 2
    middle = place + half if isinstance(place, float) else (place[0] + place[1]) / 2
    canvas.centred(middle, top - 1.8, number, 10.0, bold=True)
    y = top - 6.8
    if not length:
        return middle - half, top - 4.0, middle + half, top
    kilometres = length >= 2000.0
    _bar(canvas, middle - length * per_metre / 2, y, length * per_metre, length / (1000.0 if kilometres else 1.0),
         "km" if kilometres else "m", above=True)  # fmt: skip
    y -= 2 * ROW
    if layout.scalebar.feet:
        feet = bar_length(max(length, _SHORTEST / per_metre) / _FOOT_M)
        y -= 0.7
        _bar(canvas, middle - length * per_metre / 2, y, feet * _FOOT_M * per_metre, feet, "ft", above=False)
        y -= 2 * ROW + 3.0
    return middle - half, y, middle + half, top


def _bar_length(layout: Layout, per_metre: float, room: float) -> float:
    """Length of the bar in metres: that of the layout, or a round one for the room."""
    longest = min(room - _BESIDE, _LONGEST)
    wanted = layout.scalebar.length
    if wanted is not None and wanted * per_metre > room - 8.0:
        raise InputError(
            f"a scale bar of {wanted:.10g} m measures {wanted * per_metre:.0f} mm, there is room for "
            f"{room - 8.0:.0f} mm",
            where="[scalebar] length",
            hint="give a shorter one",
        )
    if wanted is not None and wanted * per_metre < _SHORTEST:
        raise InputError(
            f"a scale bar of {wanted:.10g} m measures {wanted * per_metre:.2g} mm, too little for its figures",
            where="[scalebar] length",
            hint=f"give at least {bar_length(2.0 * _SHORTEST / per_metre):.10g} m",
        )
    return wanted or bar_length(longest / per_metre)


def _bar(canvas: Canvas, left: float, top: float, length: float, value: float, unit: str, *, above: bool) -> None:
    """Two rows of boxes, black where the other is white; figures above or below."""
    size = 6.0
    widest = text_size(_figure(value), size)[0] + 1.0
    parts = next((n for n in (bar_divisions(value), 2) if length / n >= widest), 1)
    step = length / parts
    canvas.rectangle((left, top - 2 * ROW, left + length, top), fill="#ffffff")
    for k in range(parts):
        y = top - ROW if k % 2 == 0 else top - 2 * ROW
        canvas.rectangle((left + k * step, y, left + (k + 1) * step, y + ROW), fill="#000000")
    canvas.rectangle((left, top - 2 * ROW, left + length, top), edge="#000000", width=0.15)
    y = top + 0.8 if above else top - 2 * ROW - 0.8 - size * CAP * POINT
    for k in range(parts + 1):
        text = _figure(value * k / parts)
        canvas.text(left + k * step, y, text, size, align="center")
    last = text_size(_figure(value), size)[0] / 2
    canvas.text(left + length + last + 0.8, y, unit, size)


def _figure(value: float) -> str:
    return grouped(value) if value >= 1000 and value == int(value) else f"{value:.10g}"


LENGTH = 17.0
# Room in mm at each side of the foot.
ASIDE = 12.0
# Degrees: smaller angles between arrows are drawn as this, and said not to be to scale.
LEAST = 13.0
# Height in mm of arrows and words.
BLOCK = 31.0


def north_angles(convergence: float, magnetic: Declination | None = None) -> list[float]:
    """Directions of true north and, where it is known, of magnetic north: degrees clockwise from grid north.

    Grid north points up the page; the second is called the grid magnetic angle.

    Parameters
    ----------
    convergence : float, meridian convergence, degrees
    magnetic : Declination, optional
    """
    return [-convergence] + ([] if magnetic is None else [magnetic.degrees - convergence])


def shown(angles: Sequence[float]) -> list[float]:
    """Angles at which arrows are drawn so that all stand clear of grid north (0) and of each other.

    Parameters
    ----------
    angles : sequence of float, degrees clockwise from grid north
    """
    # The one nearest to grid north on each side comes first, and the others make room: their order is kept.
    drawn = [0.0] * len(angles)
    for side in (1.0, -1.0):
        last = 0.0
        for i in sorted(range(len(angles)), key=lambda k: abs(angles[k])):
            if angles[i] * side > 1e-4:
                drawn[i] = side * max(abs(angles[i]), last + LEAST)
                last = abs(drawn[i])
    return drawn


def north_lines(convergence: float, magnetic: Declination | None = None) -> list[str]:
    """Lines beside the arrows.

    Parameters
    ----------
    convergence : float, meridian convergence, degrees
    magnetic : Declination, optional
    """
    if abs(convergence) < 0.5 / 3600:
        lines = ["At the centre of the sheet grid north is true north (meridian convergence 0)."]
    else:
        amount, side = angle_text(abs(convergence)), "east" if convergence > 0 else "west"
        lines = [f"At the centre of the sheet grid north is {amount} {side} of true north (meridian convergence)."]
    return lines if magnetic is None else [*lines, magnetic_text(magnetic)]


def magnetic_text(magnetic: Declination) -> str:
    """Line on the declination: to the minute where it was declared, with its standard deviation where computed.

    Parameters
    ----------
    magnetic : Declination
    """
    side = "east" if magnetic.degrees >= 0 else "west"
    if magnetic.sigma is None:
        text = f"Magnetic declination {angle_text(abs(magnetic.degrees), 1 / 60)} {side}"
        text += f" ({magnetic.date})" if magnetic.date else ""
    else:
        amount = f"{abs(magnetic.degrees):.1f}°\u00a0±\u00a0{magnetic.sigma:.1f}°"
        text = f"Magnetic declination {amount} {side} ({NAME}, {magnetic.date})"
    if magnetic.annual_change is not None:
        side = "east" if magnetic.annual_change >= 0 else "west"
        text += f", annual change {abs(magnetic.annual_change) * 60:.1f}′ {side}"
    return f"{text}."


def draw_north(canvas: Canvas, x: float, top: float, convergence: float, magnetic: Declination | None) -> float:
    """Draw the arrows about x, below `top`; returns the lower end. Lengths in mm.

    Parameters
    ----------
    canvas : Canvas
    x, top : float, mm
    convergence : float, meridian convergence, degrees
    magnetic : Declination or None
    """
    foot = np.array([x, top - 4.0 - LENGTH])
    angles = north_angles(convergence, magnetic)
    drawn = shown(angles)
    arms = [("GN", 0.0, LENGTH)]
    arms += [
        (name, angle, _within(angle, LENGTH - 1.5))
        for name, angle in zip(("TN", "MN"), drawn, strict=False)
        if angle or name == "MN"
    ]
    for name, angle, length in arms:
        up = _direction(angle)
        tip = foot + length * up
        canvas.lines([np.array([foot, tip])], "#000000", 0.25 if name != "GN" else 0.35)
        if name == "GN":
            _head(canvas, tip, up)
        elif name == "TN":
            _star(canvas, tip)
        else:
            _half(canvas, tip, up, 1.0 if angle > 0 else -1.0)
        at = tip + up * 2.6
        label = "N" if name == "GN" and len(arms) == 1 else name
        canvas.centred(float(at[0]), float(at[1]), label, 6.5, bold=name == "GN")
    # Near the poles grid north may point south: what reaches below the foot has its room there.
    y = float(foot[1]) + min(0.0, *((length + 4.2) * math.cos(math.radians(angle)) for _, angle, length in arms))
    if any(abs(a - b) > 1e-9 for a, b in zip(angles, drawn, strict=True) if b):
        y -= 2.4
        canvas.centred(x, y, "(angles not to scale)", 5.0, italic=True)
    return y - 1.5


def _within(angle: float, length: float) -> float:
    """Length of an arm of which tip and name reach no further aside than `ASIDE`."""
    across = abs(math.sin(math.radians(angle)))
    return min(length, (ASIDE - 1.6) / across - 2.6) if across > 1e-9 else length


def _direction(angle: float) -> FloatArray:
    """Unit vector on the page, degrees clockwise from up."""
    a = math.radians(angle)
    return np.array([math.sin(a), math.cos(a)])


def _head(canvas: Canvas, tip: FloatArray, up: FloatArray) -> None:
    side = np.array([up[1], -up[0]])
    ring = [tip + 0.6 * up, tip - 2.8 * up + 1.1 * side, tip - 2.0 * up, tip - 2.8 * up - 1.1 * side]
    canvas.area([np.array([*ring, ring[0]])], "#000000")


def _half(canvas: Canvas, tip: FloatArray, up: FloatArray, sign: float) -> None:
    side = sign * np.array([up[1], -up[0]])
    ring = [tip + 0.4 * up, tip - 2.4 * up + 1.1 * side, tip - 1.8 * up]
    canvas.area([np.array([*ring, ring[0]])], "#000000")


def _star(canvas: Canvas, tip: FloatArray) -> None:
    turns = np.radians(90.0 + 36.0 * np.arange(11))
    radius = np.where(np.arange(11) % 2 == 0, 1.2, 0.5)
    canvas.area([tip + np.column_stack([radius * np.cos(turns), radius * np.sin(turns)])], "#000000")
