"""Smallest set of points without which nothing contradicts the others.

Where few points hold many unknowns, as control does a block, a wrong one bends the solution: its error shows in its
neighbours as much as in itself, and of several wrong ones the first to be rejected would often be a good one. So sets
are compared, each by the decrease of the sum of squares without it (`statistics.deletion_statistic`): no other
adjustment is needed for that. Here the scale of errors is known; `mean_shift` serves where it is not.
"""

from __future__ import annotations

from dataclasses import dataclass
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
    count, limit = len(left), float(np.log(alpha / max(1, len(left))))
    points = _Residuals.of(left, share, observed)
    best: list[tuple[int, ...]] = [()]
    for taken in range(count // 3 + 1):
        gains: dict[tuple[int, ...], float] = {(): 0.0}
        if taken and comb(count, taken) <= TRIED:
            gains = {each: points.gain(each) for each in combinations(range(count), taken)}
        elif taken:
            gains = {}
            for one in best:
                grown = points.grown(one)[0].tolist()
                gains |= {tuple(sorted((*one, i))): grown[i] for i in range(count) if i not in one}
        best = sorted(sorted(gains), key=lambda one: -gains[one])[:KEPT]
        more, checked = points.grown(best[0])
        chance = log_chi_squared_tail(np.maximum(more - points.gain(best[0]), 0.0), checked)
        if not (np.delete(chance, best[0]) < limit).any():
            wrong = np.zeros(count, dtype=np.bool_)
            wrong[list(best[0])] = True
            return wrong
    return np.zeros(count, dtype=np.bool_)


@dataclass(frozen=True, eq=False)
class _Residuals:
    """Residuals (N, K) and their redundancy matrix (N·K, N·K), zero where nothing was observed."""

    left: FloatArray
    share: FloatArray

    @classmethod
    def of(cls, left: FloatArray, share: FloatArray, observed: BoolArray) -> _Residuals:
        known = observed.ravel()
        return cls(np.where(observed, left, 0.0), np.where(known[:, None] & known, share, 0.0))

    def _own(self, taken: tuple[int, ...]) -> tuple[IntArray, FloatArray, FloatArray]:
        """Rows of some points, a root of the inverse of their redundancy matrix, and their residuals times it."""
        size = self.left.shape[1]
        rows = (np.array(taken, dtype=np.int64)[:, None] * size + np.arange(size)).ravel()
        values, turns = np.linalg.eigh(self.share[np.ix_(rows, rows)])
        root: FloatArray = turns[:, values > CHECKED] / np.sqrt(values[values > CHECKED])
        return rows, root, root.T @ self.left.ravel()[rows]

    def gain(self, taken: tuple[int, ...]) -> float:
        """Fall of the sum of squares without some points."""
        amount = self._own(taken)[2]
        return float(amount @ amount)

    def grown(self, taken: tuple[int, ...]) -> tuple[FloatArray, IntArray]:
        """Falls (N,) without some points and each other one more, and the coordinates of this one that are checked."""
        # By the Schur complement of the set: a matrix of its own for each larger one took a minute for 100 points.
        (count, size), each = self.left.shape, np.arange(len(self.left))
        rows, root, amount = self._own(taken)
        by = (self.share[:, rows] @ root).reshape(count, size, root.shape[1])
        blocks = self.share.reshape(count, size, count, size)[each, :, each, :] - by @ np.swapaxes(by, 1, 2)
        more, checked = deletion_statistic(self.left - by @ amount, blocks, CHECKED)
        return float(amount @ amount) + more, checked
