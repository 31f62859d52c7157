"""The arrows: grid north, true north by the meridian convergence, magnetic north where it is declared."""

from __future__ import annotations

import math

import numpy as np

from geomosaic.carto.draw.canvas import Canvas
from geomosaic.carto.layout import NorthPart
from geomosaic.carto.nice import angle_text
from geomosaic.types import FloatArray

LENGTH = 17.0
LEAST = 7.0
"""Degrees: smaller angles between the arrows are drawn as this, and said to be."""


def true_north(convergence: float) -> float:
    """Direction of true north on the sheet: degrees clockwise from grid north, which points up the page."""
    return -convergence


def magnetic_north(declination: float, convergence: float) -> float:
    """Direction of magnetic north on the sheet: degrees clockwise from grid north (the grid magnetic angle)."""
    return declination - convergence


def shown(angle: float) -> float:
    """Angle at which an arrow is drawn so that it stands clear of grid north."""
    return 0.0 if abs(angle) < 1e-4 else math.copysign(max(abs(angle), LEAST), angle)


def north_words(convergence: float, part: NorthPart) -> list[str]:
    """Lines below the arrows."""
    turned = f"{angle_text(abs(convergence))} {'east' if convergence > 0 else 'west'} of true north"
    near = abs(convergence) < 0.5 / 3600
    lines = ["Meridian convergence", "at the centre of the sheet:", "0°00′00″" if near else f"grid north {turned}"]
    if part.magnetic is not None:
        side = "east" if part.magnetic >= 0 else "west"
        when = f" ({part.magnetic_date})" if part.magnetic_date else ""
        lines.append(f"Declination {angle_text(abs(part.magnetic), 1 / 60)} {side}{when}")
        if part.annual_change is not None:
            side = "east" if part.annual_change >= 0 else "west"
            lines.append(f"annual change {abs(part.annual_change) * 60:.1f}′ {side}")
    return lines


def draw_north(canvas: Canvas, x: float, top: float, convergence: float, part: NorthPart) -> float:
    """Draw the arrows about x, below `top`; returns the lower end. Lengths in mm."""
    foot = np.array([x, top - 4.0 - LENGTH])
    true = shown(true_north(convergence))
    magnetic = None if part.magnetic is None else shown(magnetic_north(part.magnetic, convergence))
    if magnetic is not None and true and abs(magnetic - true) < LEAST:
        magnetic = true + math.copysign(LEAST, magnetic - true) if abs(magnetic) > abs(true) else magnetic
    arms = [("GN", 0.0, LENGTH)]
    if true:
        arms.append(("TN", true, LENGTH - 1.5))
    if magnetic is not None:
        arms.append(("MN", magnetic, LENGTH - (4.0 if magnetic * true > 0 else 1.5)))
    for name, angle, length in arms:
        up = direction(angle)
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
    y = float(foot[1])
    if any(shown(a) != a and abs(a) > 1e-4 for a in _angles(convergence, part)):
        y -= 2.4
        canvas.centred(x, y, "(angles not to scale)", 5.0, italic=True)
    return y - 1.5


def _angles(convergence: float, part: NorthPart) -> list[float]:
    more = [] if part.magnetic is None else [magnetic_north(part.magnetic, convergence)]
    return [true_north(convergence), *more]


def direction(angle: float) -> FloatArray:
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
