"""Contours of a height grid: traced, smoothed within a tolerance of height, labelled so that figures look uphill.

Heights are bilinear between the nodes, as everywhere in geomosaic. A traced contour has vertices on the sides of the
cells, where it is exact; the straight line between two of them leaves the bilinear surface a little. Smoothing moves
vertices only as far as the surface at their new place, and on the way to their neighbours, stays within the tolerance
of the contour's height. A tolerance below half the interval so keeps contours from crossing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from geomosaic.carto.nice import multiples, nice_step
from geomosaic.errors import InputError
from geomosaic.types import AnyArray, FloatArray

if TYPE_CHECKING:
    from affine import Affine

MOST_LEVELS = 2000
PASSES = 12
"""Rounds of smoothing: about the influence of 2.5 cells to each side."""


@dataclass(frozen=True)
class Contour:
    """One contour line.

    Attributes
    ----------
    height : float
        Its level in metres.
    index : bool
        Whether it is a main contour.
    xy : array (N, 2)
        In the CRS of the heights; the ground rises to the left. Closed where the first point is the last.
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


@dataclass(frozen=True)
class Heights:
    """Nodes of a height grid: values (rows, cols) in metres, NaN where unknown, and the affine from (col, row) to map.

    (0.5, 0.5) is the first node, as in every raster.
    """

    values: AnyArray
    transform: Affine

    def at(self, xy: FloatArray) -> FloatArray:
        """Bilinear heights (N,) at map places (N, 2); NaN outside the nodes."""
        t = ~self.transform
        col = t.a * xy[:, 0] + t.b * xy[:, 1] + t.c - 0.5
        row = t.d * xy[:, 0] + t.e * xy[:, 1] + t.f - 0.5
        return bilinear_at(self.values, col, row)


def bilinear_at(values: AnyArray, col: FloatArray, row: FloatArray) -> FloatArray:
    """Bilinear values at node coordinates, (0, 0) being the first node; NaN outside."""
    rows, cols = values.shape
    hair = 1e-6
    inside = (col >= -hair) & (row >= -hair) & (col <= cols - 1 + hair) & (row <= rows - 1 + hair)
    c = np.clip(np.where(inside, col, 0.0), 0, cols - 1)
    r = np.clip(np.where(inside, row, 0.0), 0, rows - 1)
    i, j = np.minimum(c.astype(np.int64), cols - 2), np.minimum(r.astype(np.int64), rows - 2)
    u, v = c - i, r - j
    z = values.astype(np.float64, copy=False)
    # A node without weight does not count, known or not.
    corners = [((1 - u) * (1 - v), z[j, i]), (u * (1 - v), z[j, i + 1]), ((1 - u) * v, z[j + 1, i])]
    corners.append((u * v, z[j + 1, i + 1]))
    total = np.zeros(col.shape)
    for w, h in corners:
        total += np.where(w > 1e-9, w * h, 0.0)
    found: FloatArray = np.where(inside, total, np.nan)
    return found


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
        raise InputError(f"{interval} is no interval of contours", mend="give metres, such as 5")
    tolerance = 0.1 * interval if tolerance is None else tolerance
    if not 0 <= tolerance < 0.5 * interval:
        raise InputError(
            f"a tolerance of {tolerance:g} m is no less than half the interval of {interval:g} m: contours could cross",
            mend="give a smaller tolerance",
        )
    known = heights.values[np.isfinite(heights.values)]
    if not known.size or min(heights.values.shape) < 2:
        raise InputError("there are no heights to draw contours of", mend="check that the DEM covers the area")
    levels = multiples(float(known.min()), float(known.max()), interval)
    if len(levels) > MOST_LEVELS:
        raise InputError(
            f"an interval of {interval:g} m gives {len(levels)} contours between {known.min():.1f} and "
            f"{known.max():.1f} m",
            mend="give a longer interval",
        )
    generator = contour_generator(
        z=np.ma.masked_invalid(heights.values.astype(np.float64)), name="serial", line_type=LineType.Separate
    )
    found: list[Contour] = []
    for level in levels:
        main = round(level / interval) % index == 0
        lines: Any = generator.lines(float(level))
        for line in lines:
            contour = _finish(heights, np.asarray(line), float(level), main, tolerance, shortest)
            if contour is not None:
                found.append(contour)
    return found


def _finish(
    heights: Heights, nodes: FloatArray, level: float, main: bool, tolerance: float, shortest: float
) -> Contour | None:
    """From vertices in node coordinates to a contour on the map."""
    nodes = _distinct(nodes)
    if len(nodes) < 2:
        return None
    t = heights.transform
    if tolerance > 0:
        nodes = smooth(heights.values, nodes, level, tolerance)
    col, row = nodes[:, 0] + 0.5, nodes[:, 1] + 0.5
    xy = np.column_stack([t.a * col + t.b * row + t.c, t.d * col + t.e * row + t.f])
    if shortest > 0 and (nodes[0] == nodes[-1]).all() and np.hypot(*np.diff(xy, axis=0).T).sum() < shortest:
        return None
    if not _rises_left(heights, xy):
        xy, nodes = xy[::-1], nodes[::-1]
    return Contour(level, main, np.ascontiguousarray(xy), _deviation(heights.values, nodes, level))


def _distinct(nodes: FloatArray) -> FloatArray:
    """Leave out vertices that lie on the one before."""
    keep = np.concatenate([[True], np.hypot(*np.diff(nodes, axis=0).T) > 1e-9])
    if not keep[-1]:  # a ring's last point stays the first
        keep[-1], keep[np.flatnonzero(keep)[-1]] = True, False
    kept: FloatArray = nodes[keep]
    return kept


def smooth(values: AnyArray, nodes: FloatArray, level: float, tolerance: float) -> FloatArray:
    """Smooth a contour without leaving the tolerance.

    Each round moves every vertex towards the mean of its neighbours (weights 1/4, 1/2, 1/4), by all, a half or a
    quarter of the way or not at all. Ends of open lines stay.

    Parameters
    ----------
    values : array (rows, cols)
        Heights at the nodes.
    nodes : array (N, 2)
        Vertices in node coordinates (col, row).
    level, tolerance : float
        Metres.

    Returns
    -------
    array (N', 2)
        N' is up to twice N: vertices are half a cell apart.
    """
    line = _densified(nodes, 0.5)
    closed = bool((nodes[0] == nodes[-1]).all())
    if len(line) < 4:
        return nodes
    line = _onto_level(values, line, level, tolerance, closed)
    for _ in range(PASSES):
        target = _averaged(line, closed)
        weight = np.ones(len(line))
        for factor in (0.5, 0.5, 0.0):
            moved = line + weight[:, None] * (target - line)
            bad = _beyond(values, moved, level, tolerance)
            if closed:
                bad[[0, -1]] = bad[0] | bad[-1]
            if not bad.any():
                break
            weight[bad] *= factor
        # Where a neighbour was held back, the line between may have left the tolerance again.
        for _ in range(20):
            moved = line + weight[:, None] * (target - line)
            bad = _beyond(values, moved, level, tolerance) & (weight > 0)
            if closed:
                bad[[0, -1]] = bad[0] | bad[-1]
            if not bad.any():
                break
            weight[bad] = 0.0
        else:
            break  # nothing more can be moved safely
        line = line + weight[:, None] * (target - line)
    return line


def _densified(nodes: FloatArray, step: float) -> FloatArray:
    lengths = np.hypot(*np.diff(nodes, axis=0).T)
    parts = [nodes[:1]]
    for a, b, length in zip(nodes[:-1], nodes[1:], lengths, strict=True):
        n = max(1, round(length / step))
        parts.append(a + (b - a) * (np.arange(1, n + 1) / n)[:, None])
    line = np.concatenate(parts)
    line[-1] = nodes[-1]
    return line


def _onto_level(values: AnyArray, line: FloatArray, level: float, tolerance: float, closed: bool) -> FloatArray:
    """Move vertices that miss the level by more than the tolerance along the slope, by one step of Newton's method."""
    h = 1e-4
    miss = bilinear_at(values, *line.T) - level
    slope = np.column_stack(
        [
            (bilinear_at(values, line[:, 0] + h, line[:, 1]) - bilinear_at(values, line[:, 0] - h, line[:, 1]))
            / (2 * h),
            (bilinear_at(values, line[:, 0], line[:, 1] + h) - bilinear_at(values, line[:, 0], line[:, 1] - h))
            / (2 * h),
        ]
    )
    steep = (slope**2).sum(axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        shift = -miss[:, None] * slope / steep[:, None]
        good = (np.abs(miss) > 0.5 * tolerance) & np.isfinite(shift).all(axis=1) & (np.hypot(*shift.T) < 0.5)
        moved = np.where(good[:, None], line + shift, line)
        better = np.abs(bilinear_at(values, *moved.T) - level) < np.abs(miss)
    out = np.where(better[:, None], moved, line)
    out[-1] = out[0] if closed else line[-1]
    if not closed:
        out[0] = line[0]
    return out


def _averaged(line: FloatArray, closed: bool) -> FloatArray:
    target = line.copy()
    target[1:-1] = 0.25 * line[:-2] + 0.5 * line[1:-1] + 0.25 * line[2:]
    if closed:
        target[0] = target[-1] = 0.25 * line[-2] + 0.5 * line[0] + 0.25 * line[1]
    return target


def _beyond(values: AnyArray, line: FloatArray, level: float, tolerance: float) -> Any:
    """Vertices at which, or on a side of which, the surface leaves the tolerance: looked at four times per side.

    Between those places it may differ by a little more, which the last tenth of the tolerance is for.
    """
    limit = 0.9 * tolerance
    off = ~(np.abs(bilinear_at(values, *line.T) - level) <= limit)
    for share in (0.25, 0.5, 0.75):
        between = line[:-1] + share * (line[1:] - line[:-1])
        side = ~(np.abs(bilinear_at(values, *between.T) - level) <= limit)
        off[:-1] |= side
        off[1:] |= side
    return off


def _deviation(values: AnyArray, line: FloatArray, level: float) -> float:
    """Largest difference between the surface along a line and a level, looked at eight times per side."""
    steps = np.arange(8)[:, None, None] / 8
    places = np.concatenate([(line[:-1] + steps * (line[1:] - line[:-1])).reshape(-1, 2), line[-1:]])
    off = np.abs(bilinear_at(values, *places.T) - level)
    return float(np.nanmax(off)) if np.isfinite(off).any() else 0.0


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
