"""Traced contours brought onto the bilinear surface, on which they are branches of hyperbolas in every cell.

In a cell z = a + b u + c v + d u v, so that a contour of height L is d (u - u0) (v - v0) = L - s about the saddle
point (u0, v0) = (-c/d, -b/d) of height s (G. M. Nielson and B. Hamann, The asymptotic decider, IEEE Visualization
1991). A tracer that puts straight lines between the sides of the cells leaves the surface by up to |d du dv| / 4. Where
a cell is crossed twice it may also join the wrong ends: such pairs lie on two branches, and they change partners.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from geomosaic.errors import InputError
from geomosaic.numbers import multiples, nice_step
from geomosaic.relief.contour_smoothing import Heights, deviation, on_surface, smooth
from geomosaic.types import FloatArray

if TYPE_CHECKING:
    pass


MOST_LEVELS = 2000


@dataclass(frozen=True)
class Contour:
    """Contour line.

    Attributes
    ----------
    height : float
        Height of the contour, metres.
    index : bool
        Whether it is a main contour.
    xy : array (N, 2)
        Vertices in the CRS of the heights; the ground rises to the left. Closed where the first point is the last.
    deviation : float
        Largest difference in metres between the surface along the line and `height`.
    """

    height: float
    index: bool
    xy: FloatArray
    deviation: float

    @property
    def closed(self) -> bool:
        """Whether it is a ring."""
        return bool((self.xy[0] == self.xy[-1]).all())


def nice_interval(low: float, high: float, count: int = 20) -> float:
    """Round interval that gives about `count` contours between two heights."""
    return nice_step(max((high - low) / count, 1e-3))


def trace(
    heights: Heights, interval: float, *, index: int = 5, tolerance: float | None = None, shortest: float = 0.0
) -> list[Contour]:
    """Contours at all multiples of an interval, from the lowest up.

    Parameters
    ----------
    heights : Heights
    interval : float
        Metres.
    index : int
        Every so many contours, counted from height 0, one is a main one.
    tolerance : float, optional
        Metres of height that smoothing may change; a tenth of the interval by default, 0 for contours as traced.
    shortest : float
        Rings shorter than this, in map units, are left out.

    Raises
    ------
    InputError
        The interval is not positive, gives more than 2000 levels, or the tolerance is half the interval or more.
    """
    from contourpy import LineType, contour_generator

    if not (interval > 0 and np.isfinite(interval)):
        raise InputError(f"{interval} is no interval of contours", hint="give metres, such as 5")
    tolerance = 0.1 * interval if tolerance is None else tolerance
    if not 0 <= tolerance < 0.5 * interval:
        raise InputError(
            f"a tolerance of {tolerance:g} m is no less than half the interval of {interval:g} m: contours could cross",
            hint="give a smaller tolerance",
        )
    known = heights.values[np.isfinite(heights.values)]
    if not known.size or min(heights.values.shape) < 2:
        raise InputError("there are no heights to draw contours of", hint="check that the DEM covers the area")
    levels = multiples(float(known.min()), float(known.max()), interval)
    if len(levels) > MOST_LEVELS:
        raise InputError(
            f"an interval of {interval:g} m gives {len(levels)} contours between {known.min():.1f} and "
            f"{known.max():.1f} m",
            hint="give a longer interval",
        )
    generator = contour_generator(
        z=np.ma.masked_invalid(heights.values.astype(np.float64)), name="serial", line_type=LineType.Separate
    )
    lines: list[FloatArray] = []
    heights_of: list[float] = []
    cell = float(np.hypot(heights.transform.a, heights.transform.d))
    for level in levels:
        traced: Any = generator.lines(float(level))
        if tolerance > 0:
            traced = on_surface(heights.values, [line for line in traced if len(line) > 1], float(level), tolerance)
        for line in map(_distinct, traced):
            if len(line) > 1 and not (_closed(line) and cell * np.hypot(*np.diff(line, axis=0).T).sum() < shortest):
                lines.append(line)
                heights_of.append(float(level))
    if tolerance > 0:
        lines = smooth(heights.values, lines, heights_of, tolerance)
    return [
        _finish(heights, line, level, round(level / interval) % index == 0)
        for line, level in zip(lines, heights_of, strict=True)
    ]


def _finish(heights: Heights, nodes: FloatArray, level: float, main: bool) -> Contour:
    """Contour on the map from vertices (N, 2) in node coordinates, directed with higher ground to the left."""
    t = heights.transform
    col, row = nodes[:, 0] + 0.5, nodes[:, 1] + 0.5
    xy = np.column_stack([t.a * col + t.b * row + t.c, t.d * col + t.e * row + t.f])
    if not _rises_left(heights, xy):
        xy, nodes = xy[::-1], nodes[::-1]
    return Contour(level, main, np.ascontiguousarray(xy), deviation(heights.values, nodes, level))


def _closed(nodes: FloatArray) -> bool:
    return bool((nodes[0] == nodes[-1]).all())


def _distinct(nodes: FloatArray) -> FloatArray:
    """Vertices without those that coincide with the one before."""
    keep = np.concatenate([[True], np.hypot(*np.diff(nodes, axis=0).T) > 1e-9])
    if not keep[-1]:  # a ring's last point stays the first
        keep[-1], keep[np.flatnonzero(keep)[-1]] = True, False
    kept: FloatArray = nodes[keep]
    return kept


def _rises_left(heights: Heights, xy: FloatArray) -> bool:
    """Whether the ground to the left of a line is higher than to its right, by the middle of its segments."""
    a, b = xy[:-1], xy[1:]
    middle, along = (a + b) / 2, b - a
    length = np.hypot(*along.T)
    t = heights.transform
    aside = (
        0.25 * np.hypot(t.a, t.d) * np.column_stack([-along[:, 1], along[:, 0]]) / np.maximum(length, 1e-12)[:, None]
    )
    rise = heights.at(middle + aside) - heights.at(middle - aside)
    return bool(np.nansum(rise * length) >= 0)
