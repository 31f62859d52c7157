"""Traced contours brought onto the bilinear surface, on which they are branches of hyperbolas in every cell.

In a cell z = a + b u + c v + d u v, so that a contour of height L is d (u - u0) (v - v0) = L - s about the saddle
point (u0, v0) = (-c/d, -b/d) of height s (G. M. Nielson and B. Hamann, The asymptotic decider, IEEE Visualization
1991). A tracer that puts straight lines between the sides of the cells leaves the surface by up to |d du dv| / 4. Where
a cell is crossed twice it may also join the wrong ends: such pairs lie on two branches, and they change partners.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from geomosaic.errors import InputError
from geomosaic.numbers import multiples, nice_step
from geomosaic.relief.contour_smoothing import bilinear_at, deviation, smooth
from geomosaic.types import AnyArray, FloatArray, IntArray

if TYPE_CHECKING:
    from affine import Affine


MOST = 100
"""Parts into which a segment is divided at most."""


def on_surface(values: AnyArray, lines: Sequence[FloatArray], level: float, tolerance: float) -> list[FloatArray]:
    """Bring the contours of one height within less than half a tolerance of the surface.

    Parameters
    ----------
    values : array (rows, cols)
        Heights at the nodes.
    lines : sequence of array (N, 2)
        Traced vertices in node coordinates (col, row) on the sides of the cells, the higher ground always on the same
        hand; rings where the first is the last.
    level, tolerance : float
        Metres.

    Returns
    -------
    list of array (N', 2)
        Vertices between those given lie on the surface exactly.
    """
    joined = _changed_partners(values, lines, level)
    return [_with_arcs(values, line, level, tolerance) for line in joined]


def _cells(values: AnyArray, start: FloatArray, end: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Coefficients a, b, c, d (4, N) of the cells of segments, the cells' corners (N, 2), and their numbers."""
    rows, cols = values.shape
    corner = np.floor((start + end) / 2).astype(np.int64)
    corner = np.clip(corner, 0, (cols - 2, rows - 2))
    i, j = corner.T
    z = [values[j + dv, i + du].astype(np.float64) for dv in (0, 1) for du in (0, 1)]
    parts = np.array([z[0], z[1] - z[0], z[2] - z[0], z[0] - z[1] - z[2] + z[3]])
    return parts, corner.astype(np.float64), j * cols + i


def _changed_partners(values: AnyArray, lines: Sequence[FloatArray], level: float) -> list[FloatArray]:
    """Lines whose ends in a cell lie on one branch."""
    sizes = [len(line) for line in lines]
    if not sizes:
        return []
    points = np.concatenate(lines)
    last = np.cumsum(sizes) - 1
    head = np.setdiff1d(np.arange(len(points)), last)  # starts of segments
    (_, _, c, d), corner, cell = _cells(values, points[head], points[head + 1])
    # Signs of d (u - u0) = c + d u tell the branches; unknown corners tell nothing.
    u, w = points[head, 0] - corner[:, 0], points[head + 1, 0] - corner[:, 0]
    wrong = np.flatnonzero((c + d * u) * (c + d * w) < 0)
    order = wrong[np.argsort(cell[wrong], kind="stable")]
    pairs = [k for k in range(len(order) - 1) if cell[order[k]] == cell[order[k + 1]]]
    if not pairs:
        return list(lines)
    following = np.arange(len(points)) + 1
    following[last] = -1
    for line, end in enumerate(last):
        start = end - sizes[line] + 1
        if sizes[line] > 2 and (points[start] == points[end]).all():
            following[end - 1] = start  # a ring: its last vertex is the first
    for k in pairs:
        first, second = head[order[k]], head[order[k + 1]]
        following[first], following[second] = following[second], following[first]
    return [points[path] for path in _paths(following, set(last.tolist()))]


def _paths(following: IntArray, ends: set[int]) -> list[list[int]]:
    """Numbers of vertices along each line; those of rings end with the first."""
    reached = np.zeros(len(following), dtype=bool)
    reached[following[following >= 0]] = True
    ahead, done = following.tolist(), [False] * len(following)
    found = []
    # Open lines start where none comes from; a ring's last vertex, which stands for the first, is on no line.
    starts = [k for k in np.flatnonzero(~reached).tolist() if not (k in ends and ahead[k] < 0)]
    for start in [*starts, *range(len(ahead))]:
        if done[start] or (start in ends and not reached[start]):
            continue
        path, at = [], start
        while at >= 0 and not done[at]:
            done[at] = True
            path.append(at)
            at = ahead[at]
        found.append([*path, start] if at == start else path)
    return [path for path in found if len(path) > 1]


def _with_arcs(values: AnyArray, line: FloatArray, level: float, tolerance: float) -> FloatArray:
    """Line with vertices on the branch between those that are far apart."""
    start, end = line[:-1], line[1:]
    (a, b, c, d), corner, _ = _cells(values, start, end)
    first, step = start - corner, end - start
    bend = np.abs(d * step[:, 0] * step[:, 1])  # four times what the middle leaves the surface
    one = (c + d * first[:, 0]) * (c + d * (first[:, 0] + step[:, 0])) > 0
    with np.errstate(invalid="ignore"):
        parts = np.where(one & (bend > 1.6 * tolerance), np.ceil(np.sqrt(bend / (1.6 * tolerance))), 1.0)
    count = np.minimum(parts, MOST).astype(np.int64)
    if (count == 1).all():
        return line
    more = 2 * (count - 1)
    place = np.arange(len(start)) + np.concatenate([[0], np.cumsum(more)[:-1]])
    out = np.empty((len(line) + int(more.sum()), 2))
    out[place], out[-1] = start, line[-1]
    for n in np.unique(count[count > 1]):
        here = np.flatnonzero(count == n)
        t = np.arange(1, n) / n
        u = first[here, :1] + t * step[here, :1]
        v = first[here, 1:] + t * step[here, 1:]
        ka, kb, kc, kd = (part[here, None] for part in (a, b, c, d))
        # As many steps across as up: no piece is longer than a part of the cell either way.
        arc = np.concatenate(
            [
                np.stack([u, (level - ka - kb * u) / (kc + kd * u)], axis=-1),
                np.stack([(level - ka - kc * v) / (kb + kd * v), v], axis=-1),
            ],
            axis=1,
        )
        run = np.abs(arc - first[here, None]).sum(axis=2)
        arc = np.take_along_axis(arc, np.argsort(run, axis=1, kind="stable")[..., None], axis=1)
        out[place[here, None] + 1 + np.arange(2 * (n - 1))] = arc + corner[here, None]
    return out


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
