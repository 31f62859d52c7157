"""Distributed corrections: misfits at points spread smoothly over the image, scale by scale.

Each scale is made of bumps φ(r) = (1 − r)⁴ (4r + 1), r = distance / radius < 1 (Wendland 1995: smooth, and exactly 0
beyond the radius). The widest takes most of what neighbouring points have in common, with a ridge that keeps close
points that differ from swinging far beyond; every next one, about half as wide, takes what is left; the last, as narrow
as the points are close, is solved for the rest through the interpolation of the grid itself, so that the finished grid
meets every point.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.errors import InputError, SolveError, warn
from geomosaic.sensor.corrected import CorrectionGrid
from geomosaic.types import AnyArray, FloatArray

# Added to the diagonal of the wide scales: close points that differ are met in part only, and do not swing.
RIDGE = 0.1
# Nodes per radius of a bump.
CELLS = 6
# Pixels within which the grid meets its points.
MET = 1e-3
# Largest correction anywhere, in lengths of the largest one at a point.
SWING = 2.0
# Nodes of zeros around: the cubic kernel reaches two nodes, so that corrections fade to exactly 0 at the border.
_MARGIN = 2


def _finest_spacing(places: FloatArray, reach: float, most_nodes: int) -> float:
    """Node spacing in pixels of a grid of `most_nodes` over all that the corrections reach."""
    return float(np.sqrt(np.prod(np.ptp(places, axis=0) + 2.0 * reach) / most_nodes))


def _correction_through(places: FloatArray, values: FloatArray, reach: float, most_nodes: int) -> CorrectionGrid | None:
    """Correction grid through corrections (K, 2) at places (K, 2), no two of which are the same."""
    from scipy.spatial import cKDTree

    # As far as a bump at the outermost point reaches.
    low, high = places.min(axis=0) - reach, places.max(axis=0) + reach
    closest = float(cKDTree(places).query(places, k=2)[0][:, 1].min())  # inf for one point
    last = min(reach, max(2.5 * closest, CELLS * _finest_spacing(places, reach, most_nodes)))
    steps = int(np.ceil(np.log2(reach / last) - 1e-9))
    scales = reach * (last / reach) ** (np.arange(steps + 1) / max(steps, 1))  # each about half the one before
    fine = _empty(low, high, float(scales[-1]) / CELLS)
    nodes = _node_places(fine)
    total, left = np.zeros((len(nodes), 2)), values.copy()
    try:
        for radius in scales[:-1]:
            layer = _layer(places, left, float(radius), low, high)
            total += layer.at(nodes)
            left = left - layer.at(places)
        narrow = _bumps(nodes, places, float(scales[-1]))
        made = _filled(fine, total)
        for _ in range(2):  # once is enough but for rounding
            total = total + narrow @ _through_grid(made, narrow, places, values - made.at(places))
            # To a billionth of a pixel: digits below it are rounding, and would differ between machines.
            made = _filled(fine, np.round(total, 9))
    except InputError:  # too steep
        return None
    # A grid that meets all points may still be useless between them.
    swings = np.linalg.norm(total, axis=1).max() > SWING * max(np.linalg.norm(values, axis=1).max(), MET)
    missed = not np.abs(values - made.at(places)).max() <= MET
    return None if swings or missed else made


def _layer(places: FloatArray, values: FloatArray, radius: float, low: FloatArray, high: FloatArray) -> CorrectionGrid:
    """Grid of one scale: bumps with a ridge."""
    from scipy.sparse import identity
    from scipy.sparse.linalg import splu

    grid = _empty(low, high, radius / CELLS)
    between = _bumps(places, places, radius) + RIDGE * identity(len(values))
    heights = splu(between.tocsc()).solve(values)
    return _filled(grid, _bumps(_node_places(grid), places, radius) @ heights)


def _through_grid(grid: CorrectionGrid, narrow: AnyArray, places: FloatArray, left: FloatArray) -> FloatArray:
    """Heights of the narrow bumps that, sampled at the nodes and interpolated, give what is left at the points."""
    from scipy.sparse import csr_matrix
    from scipy.sparse.linalg import splu

    index, weight = grid.weights(places)
    row = np.repeat(np.arange(len(places)), 16)
    count = grid.nodes.shape[0] * grid.nodes.shape[1]
    interpolate = csr_matrix((weight.ravel(), (row, index.ravel())), shape=(len(places), count))
    try:
        solved: FloatArray = splu((interpolate @ narrow).tocsc()).solve(left)
    except RuntimeError:  # exactly singular: seen by what the grid then misses
        return np.zeros_like(left)
    return solved


def _bumps(at: FloatArray, centres: FloatArray, radius: float) -> AnyArray:
    """Sparse φ(|at − centre| / radius), (len(at), len(centres))."""
    from scipy.sparse import csr_matrix
    from scipy.spatial import cKDTree

    near = cKDTree(at).query_ball_point(centres, radius)
    column = np.repeat(np.arange(len(centres)), [len(rows) for rows in near])
    row = np.concatenate([np.asarray(rows, dtype=np.int64) for rows in near])
    r = np.minimum(np.linalg.norm(at[row] - centres[column], axis=1) / radius, 1.0)
    bumps: AnyArray = csr_matrix(((1.0 - r) ** 4 * (4.0 * r + 1.0), (row, column)), shape=(len(at), len(centres)))
    return bumps


def _empty(low: FloatArray, high: FloatArray, spacing: float) -> CorrectionGrid:
    columns, rows = np.ceil((high - low) / spacing).astype(int) + 1 + 2 * _MARGIN
    return CorrectionGrid(low - _MARGIN * spacing, np.full(2, spacing), np.zeros((rows, columns, 2)))


def _node_places(grid: CorrectionGrid) -> FloatArray:
    rows, columns, _ = grid.nodes.shape
    c, r = np.meshgrid(np.arange(columns), np.arange(rows))
    return grid.origin + np.column_stack([c.ravel(), r.ravel()]) * grid.spacing


def _filled(grid: CorrectionGrid, nodes: FloatArray) -> CorrectionGrid:
    return CorrectionGrid(grid.origin, grid.spacing, nodes.reshape(grid.nodes.shape))


# Nodes of a grid at most: the second where points are too close for the first.
NODES = (60_000, 240_000)
# Where points contradict each other, those closer than so many node spacings are met in their mean.
TOGETHER = (0.25, 0.5, 1.0, 2.0)
# Pixels within which a point counts as met.
EXACT = 0.02


def spread(points: FloatArray, corrections: FloatArray, reach: float, names: tuple[str, ...]) -> CorrectionGrid:
    """Correction grid that meets given corrections at points.

    Parameters
    ----------
    points : array (K, 2)
        Ideal image positions, pixels.
    corrections : array (K, 2)
        d_col, d_row there, pixels.
    reach : float
        Distance in pixels from a point at which its correction has faded away; a few times the distance between
        neighbouring points, so that it does not sag between them.
    names : tuple of str (K,)
        Of the points, for messages.

    Returns
    -------
    CorrectionGrid
        Bicubic, zero beyond, within 0.001 pixel of the corrections at the points.

    Warns
    -----
    GeomosaicWarning
        Points stand so close together, and their corrections differ so much, that a smooth grid can only meet their
        mean; it says how many and names the worst pair.

    Raises
    ------
    SolveError
        That does not help either.
    """
    each = _PointCorrections(points, corrections, names)
    spacing = _finest_spacing(points, reach, NODES[-1])
    # The cheapest way that meets all points comes first; means of close points are the last resort.
    for most_nodes, within in (
        (NODES[0], 1e-3),
        (NODES[1], 1e-3),
        *((NODES[1], share * spacing) for share in TOGETHER),
    ):
        wanted = each.together(within)
        grid = _correction_through(wanted.places, wanted.values, reach, most_nodes)
        if grid is not None:
            missed = np.abs(grid.at(points) - corrections).max(axis=1) > EXACT
            if missed.any():
                first, second = each.steepest_pair()
                warn(
                    f"{int(missed.sum())} of {len(points)} points lie so close to others, and contradict them so much, "
                    f"that the join meets only their mean: first of all '{first}' and '{second}'. Look for wrong "
                    "measurements; a place measured under two ids should have one"
                )
            return grid
    first, second = each.steepest_pair()
    raise SolveError(
        f"the misfits at points '{first}' and '{second}' differ so much for their distance that no smooth correction "
        "meets both",
        hint="look for a wrong measurement; a place that is measured under two ids gets one; else leave one out",
    )


@dataclass(frozen=True)
class _PointCorrections:
    """Points with their corrections."""

    places: FloatArray
    values: FloatArray
    names: tuple[str, ...]

    def together(self, within: float) -> _PointCorrections:
        """Points with means in place of those closer than some pixels."""
        from scipy.spatial import cKDTree

        group = np.arange(len(self.places))
        for first, second in sorted(cKDTree(self.places).query_pairs(within)):
            if group[first] == first and group[second] == second:  # a group is what is near its first point
                group[second] = first
            elif group[second] == second:
                group[second] = group[first]
        _, which, count = np.unique(group, return_inverse=True, return_counts=True)
        if len(count) == len(group):
            return self
        mean = np.zeros((len(count), 4))
        np.add.at(mean, which, np.hstack([self.places, self.values]))
        mean /= count[:, None]
        return _PointCorrections(mean[:, :2], mean[:, 2:], ())

    def steepest_pair(self) -> tuple[str, str]:
        """Names of the neighbours whose corrections differ most for their distance."""
        from scipy.spatial import cKDTree

        if len(self.places) < 2:
            return self.names[0], self.names[0]
        distance, other = cKDTree(self.places).query(self.places, k=min(6, len(self.places)))
        differ = np.linalg.norm(self.values[other] - self.values[:, None], axis=2)
        slope = np.where(other == np.arange(len(other))[:, None], 0.0, differ / np.maximum(distance, 1e-6))
        first, k = np.unravel_index(int(np.argmax(slope)), slope.shape)
        return self.names[first], self.names[other[first, k]]
