"""Traced contours brought onto the bilinear surface, on which they are branches of hyperbolas in every cell.

In a cell z = a + b u + c v + d u v, so that a contour of height L is d (u - u0) (v - v0) = L - s about the saddle
point (u0, v0) = (-c/d, -b/d) of height s (G. M. Nielson and B. Hamann, The asymptotic decider, IEEE Visualization
1991). A tracer that puts straight lines between the sides of the cells leaves the surface by up to |d du dv| / 4. Where
a cell is crossed twice it may also join the wrong ends: such pairs lie on two branches, and they change partners.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from geomosaic.types import AnyArray, FloatArray, IntArray

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
