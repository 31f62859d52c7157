"""Smallest set of points without which nothing contradicts the others.

Where few points hold many unknowns, as control does a block, a wrong one bends the solution: its error shows in its
neighbours as much as in itself, and of several wrong ones the first to be rejected would often be a good one. So sets
are compared, each by the decrease of the sum of squares without it (`statistics.deletion_statistic`): no other
adjustment is needed for that. Here the scale of errors is known; `mean_shift` serves where it is not.
"""

from __future__ import annotations

from itertools import combinations
from math import comb

import numpy as np

from geomosaic.estimation.statistics import deletion_statistic, log_chi_squared_tail
from geomosaic.types import BoolArray, FloatArray, IntArray

# Sets of one size that are all tried; of more, those that grow from the best smaller ones.
TRIED = 2_000
KEPT = 20
# Redundancy number of a direction from which on the rest checks it: the matrix is exact to some 1e-12.
CHECKED = 1e-9


def smallest_set(left: FloatArray, share: FloatArray, observed: BoolArray, alpha: float) -> BoolArray:
    """Smallest set of points without which no residual of the others is improbable.

    Parameters
    ----------
    left : array (N, K)
        Whitened residuals of all points.
    share : array (N·K, N·K)
        Their redundancy matrix.
    observed : bool array (N, K)
        Components that were observed.
    alpha : float
        Probability below which a residual is no chance.

    Returns
    -------
    bool array (N,)
        Nothing where more than a third of the points would be left out.
    """
    count, size = left.shape
    rows = [np.flatnonzero(observed[i]) + i * size for i in range(count)]
    flat, limit = left.ravel(), float(np.log(alpha / max(1, count)))
    best: list[tuple[int, ...]] = [()]
    for taken in range(count // 3 + 1):
        sets = best
        if taken:
            every = comb(count, taken) <= TRIED
            sets = (
                list(combinations(range(count), taken))
                if every
                else sorted({tuple(sorted((*one, i))) for one in best for i in range(count) if i not in one})
            )
        gains = [_gain(flat, share, rows, one)[0] for one in sets]
        order = np.argsort([-gain for gain in gains], kind="stable")[:KEPT]
        best = [sets[k] for k in order]
        if not _contradicted(flat, share, rows, best[0], limit):
            wrong = np.zeros(count, dtype=np.bool_)
            wrong[list(best[0])] = True
            return wrong
    return np.zeros(count, dtype=np.bool_)


def _gain(left: FloatArray, share: FloatArray, rows: list[IntArray], taken: tuple[int, ...]) -> tuple[float, int]:
    """Fall of the sum of squares without some points, and the number of their coordinates that the rest checks."""
    if not taken:
        return 0.0, 0
    own = np.concatenate([rows[i] for i in taken])
    statistic, checked = deletion_statistic(left[own], share[np.ix_(own, own)], CHECKED)
    return float(statistic), int(checked)


def _contradicted(
    left: FloatArray, share: FloatArray, rows: list[IntArray], taken: tuple[int, ...], limit: float
) -> bool:
    """Whether, without some points, the residual of another is improbable."""
    base, checked = _gain(left, share, rows, taken)
    for i in range(len(rows)):
        if i not in taken:
            gain, more = _gain(left, share, rows, (*taken, i))
            chance = log_chi_squared_tail(np.array([max(gain - base, 0.0)]), np.array([more - checked]))
            if chance[0] < limit:
                return True
    return False
