"""Refinement of traced contours: brought onto the bilinear surface, then smoothed within a height tolerance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geomosaic.interpolation import bilinear, interval
from geomosaic.types import AnyArray, BoolArray, FloatArray, IntArray

if TYPE_CHECKING:
    from affine import Affine

# Rounds of smoothing: about the influence of 2.5 cells to each side.
_PASSES = 12
# Distance of vertices, in cells.
_STEP = 0.5


def bilinear_at(values: AnyArray, col: FloatArray, row: FloatArray) -> FloatArray:
    """Bilinear values at node coordinates, (0, 0) being the first node; NaN outside.

    Parameters
    ----------
    values : array (rows, cols)
    col, row : array (N,)
    """
    rows, cols = values.shape
    hair = 1e-6  # vertices on the outermost nodes lie outside by rounding
    inside = (col >= -hair) & (row >= -hair) & (col <= cols - 1 + hair) & (row <= rows - 1 + hair)
    c, r = np.nan_to_num(col), np.nan_to_num(row)
    (i, u), (j, v) = interval(c, cols), interval(r, rows)
    # A vertex on the side of a cell lies beside it by rounding; what the neighbour is worth there does not count.
    found = bilinear(values, np.column_stack([i, j]), np.column_stack([u, v]), least=1e-9)
    return np.where(inside, found, np.nan)


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


# On the surface a contour is a branch of a hyperbola in every cell: z = a + b u + c v + d u v, so that a contour of
# height L is d (u - u0) (v - v0) = L - s about the saddle point (u0, v0) = (-c/d, -b/d) of height s (G. M. Nielson and
# B. Hamann, The asymptotic decider, IEEE Visualization 1991). A tracer that puts straight lines between the sides of
# the cells leaves the surface by up to |d du dv| / 4. Where a cell is crossed twice it may also join the wrong ends:
# such pairs lie on two branches, and they change partners.

# Parts into which a segment is divided at most.
_MOST_PARTS = 100


def on_surface(values: AnyArray, lines: Sequence[FloatArray], level: float, tolerance: float) -> list[FloatArray]:
    """Contours of one height brought within less than half a tolerance of the surface.

    Parameters
    ----------
    values : array (rows, cols), heights at the nodes
    lines : sequence of array (N, 2)
        Traced vertices in node coordinates (col, row) on the sides of the cells, the higher ground always on the same
        hand; rings where the first is the last.
    level, tolerance : float, metres

    Returns
    -------
    list of array (N', 2), vertices between those given lie on the surface exactly
    """
    joined = _changed_partners(values, lines)
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


def _changed_partners(values: AnyArray, lines: Sequence[FloatArray]) -> list[FloatArray]:
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
    # Four times the deviation of the middle from the surface; n parts reduce it to 1/n², hence the square root.
    bend = np.abs(d * step[:, 0] * step[:, 1])
    one = (c + d * first[:, 0]) * (c + d * (first[:, 0] + step[:, 0])) > 0
    with np.errstate(invalid="ignore"):
        parts = np.where(one & (bend > 1.6 * tolerance), np.ceil(np.sqrt(bend / (1.6 * tolerance))), 1.0)
    count = np.minimum(parts, _MOST_PARTS).astype(np.int64)
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


@dataclass(frozen=True)
class _Lines:
    """Many lines in one array of vertices: where each starts and ends, which are rings; level, line of each vertex."""

    first: IntArray
    last: IntArray
    ring: BoolArray
    level: FloatArray
    line: IntArray

    def tie(self, marks: BoolArray) -> None:
        """A ring's first and last vertex are one."""
        a, b = self.first[self.ring], self.last[self.ring]
        marks[a] |= marks[b]
        marks[b] = marks[a]


def smooth(
    values: AnyArray, lines: Sequence[FloatArray], levels: Sequence[float], tolerance: float
) -> list[FloatArray]:
    """Smoothed contours that keep within the tolerance.

    Parameters
    ----------
    values : array (rows, cols), heights at the nodes
    lines : sequence of array (N, 2), vertices in node coordinates (col, row); rings where the first is the last
    levels : sequence of float, one per line, metres
    tolerance : float, metres

    Returns
    -------
    list of array (N', 2), vertices are half a cell apart. Ends of open lines stay, rings stay closed.
    """
    dense = [_densified(line) for line in lines]
    if not dense:
        return []
    sizes = np.array([len(line) for line in dense])
    last = np.cumsum(sizes) - 1
    first = last - sizes + 1
    ring = np.array([bool((line[0] == line[-1]).all()) and len(line) > 3 for line in dense])
    all_ = _Lines(
        first,
        last,
        ring,
        np.repeat(np.asarray(levels, dtype=np.float64), sizes),
        np.repeat(np.arange(len(dense)), sizes),
    )
    # Each round moves every vertex towards the mean of its neighbours (weights 1/4, 1/2, 1/4), by all, a half or a
    # quarter of the way or not at all: as far as the surface stays within the tolerance of the contour's height at the
    # vertex and on the way to its neighbours.
    points = start = _onto_level(values, np.concatenate(dense), all_, tolerance)
    for _ in range(_PASSES):
        step = _averaged(points, all_) - points
        points = points + _allowed(values, points, step, all_, tolerance)[:, None] * step
    return np.split(_within_tolerance(values, start, points, all_, tolerance), last[:-1] + 1)


def _allowed(values: AnyArray, points: FloatArray, step: FloatArray, lines: _Lines, tolerance: float) -> FloatArray:
    """Share (N,) of its step by which each vertex may move."""
    weight = np.ones(len(points))
    for factor in (0.5, 0.5, 0.0):
        bad = _exceeds_tolerance(values, points + weight[:, None] * step, lines, tolerance)
        if not bad.any():
            return weight
        weight[bad] *= factor
    # Where a neighbour was held back, the line between may have left the tolerance again.
    for _ in range(20):
        bad = _exceeds_tolerance(values, points + weight[:, None] * step, lines, tolerance) & (weight > 0)
        if not bad.any():
            return weight
        weight[bad] = 0.0
    weight[np.isin(lines.line, np.unique(lines.line[bad]))] = 0.0
    return weight


def _within_tolerance(
    values: AnyArray, start: FloatArray, points: FloatArray, lines: _Lines, tolerance: float
) -> FloatArray:
    """Take vertices back towards where they started, as far as the tolerance wants it on all of their sides."""
    # Where the ground has a kink, at the sides of steep cells, the few places that the rounds look at miss the worst
    # one.
    weight = np.ones(len(points))
    sides = np.setdiff1d(np.arange(len(points) - 1), lines.last[:-1])  # not from one line to the next
    for _ in range(10):
        now = start + weight[:, None] * (points - start)
        off = sides[_deviations(values, now[sides], now[sides + 1], lines.level[sides]) > tolerance]
        if not len(off):
            return now
        bad = np.zeros(len(points), dtype=bool)
        bad[off] = bad[off + 1] = True
        lines.tie(bad)
        sides = sides[bad[sides] | bad[sides + 1]]  # the others stay as they are
        weight[bad] = np.where(weight[bad] > 0.2, 0.5 * weight[bad], 0.0)
    weight[np.isin(lines.line, np.unique(lines.line[bad]))] = 0.0
    return start + weight[:, None] * (points - start)


def _densified(nodes: FloatArray) -> FloatArray:
    lengths = np.hypot(*np.diff(nodes, axis=0).T)
    parts = [nodes[:1]]
    for a, b, length in zip(nodes[:-1], nodes[1:], lengths, strict=True):
        n = max(1, round(length / _STEP))
        parts.append(a + (b - a) * (np.arange(1, n + 1) / n)[:, None])
    line = np.concatenate(parts)
    line[-1] = nodes[-1]
    return line


def _onto_level(values: AnyArray, points: FloatArray, lines: _Lines, tolerance: float) -> FloatArray:
    """Vertices brought to their level along the slope where they miss half the tolerance (one Newton step)."""
    h = 1e-4
    col, row = points.T
    miss = bilinear_at(values, col, row) - lines.level
    slope = np.column_stack(
        [
            bilinear_at(values, col + h, row) - bilinear_at(values, col - h, row),
            bilinear_at(values, col, row + h) - bilinear_at(values, col, row - h),
        ]
    ) / (2 * h)
    with np.errstate(invalid="ignore", divide="ignore"):
        shift = -miss[:, None] * slope / (slope**2).sum(axis=1)[:, None]
        good = (np.abs(miss) > 0.5 * tolerance) & np.isfinite(shift).all(axis=1) & (np.hypot(*shift.T) < 0.5)
        good[lines.first] = good[lines.last] = False
        moved = np.where(good[:, None], points + shift, points)
        better = np.abs(bilinear_at(values, *moved.T) - lines.level) < np.abs(miss)
    return np.where(better[:, None], moved, points)


def _averaged(points: FloatArray, lines: _Lines) -> FloatArray:
    """Vertices averaged with their neighbours; ends of open lines stay."""
    target = points.copy()
    target[1:-1] = 0.25 * points[:-2] + 0.5 * points[1:-1] + 0.25 * points[2:]
    open_ends = np.concatenate([lines.first[~lines.ring], lines.last[~lines.ring]])
    target[open_ends] = points[open_ends]
    a, b = lines.first[lines.ring], lines.last[lines.ring]
    target[a] = 0.25 * points[b - 1] + 0.5 * points[a] + 0.25 * points[a + 1]
    target[b] = target[a]
    return target


def _exceeds_tolerance(values: AnyArray, points: FloatArray, lines: _Lines, tolerance: float) -> BoolArray:
    """Vertices at which, or on a side of which, the surface leaves the tolerance: looked at four times per side."""
    # Between those places it may differ by a little more, which the last tenth of the tolerance is for.
    limit = 0.9 * tolerance
    off: BoolArray = ~(np.abs(bilinear_at(values, *points.T) - lines.level) <= limit)
    side = np.zeros(len(points) - 1, dtype=bool)
    for share in (0.25, 0.5, 0.75):
        between = points[:-1] + share * (points[1:] - points[:-1])
        side |= ~(np.abs(bilinear_at(values, *between.T) - lines.level[:-1]) <= limit)
    side[lines.last[:-1]] = False  # from one line to the next
    off[:-1] |= side
    off[1:] |= side
    lines.tie(off)
    return off


def _deviations(values: AnyArray, start: FloatArray, end: FloatArray, level: AnyArray | float) -> FloatArray:
    """Largest differences (N,) in metres between the surface along sides, in node coordinates (N, 2), and a level."""
    # Nine places of each side, and where it crosses from a cell to the next: there the surface has its kinks. fmax
    # leaves out places where the surface is unknown. Sides are no longer than a cell, so that there is one crossing
    # each way.
    worst = np.zeros(len(start))
    step, line = end - start, np.rint((start + end) / 2)  # the nearest lines of nodes
    with np.errstate(invalid="ignore", divide="ignore"):
        kinks = np.where(step != 0, (line - start) / step, 0.0)
    shares: list[AnyArray] = [np.full(len(start), k / 8) for k in range(9)] + list(np.clip(kinks, 0.0, 1.0).T)
    for share in shares:
        off = np.abs(bilinear_at(values, *(start + share[:, None] * step).T) - level)
        worst = np.fmax(worst, off)
    return worst


def deviation(values: AnyArray, line: FloatArray, level: float) -> float:
    """Largest difference between the surface along a line and a level, as `_deviations` has it.

    Parameters
    ----------
    values : array (rows, cols), heights at the nodes, metres
    line : array (N, 2), vertices in node coordinates (col, row)
    level : float, metres
    """
    return float(_deviations(values, line[:-1], line[1:], level).max())
