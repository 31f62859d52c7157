"""Smallest set of points without which nothing contradicts the others.

Where few points hold many unknowns, as control does a block, a wrong one bends the solution: its error shows in its
neighbours as much as in itself, and of several wrong ones the first to be rejected would often be a good one. So sets
are compared, each by the decrease of the sum of squares without it (`statistics.deletion_statistic`): no other
adjustment is needed for that. Here the scale of errors is known; `mean_shift` serves where it is not.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
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
# Directions that the others must keep to contradict each other, over those that they check of the set: with none left
# any set of this size explains everything. The redundancy number from which on a direction is one, and points from
# which on there are enough in any case.
LEFT, CONTRADICTED, PLENTY = 0.5, 1e-6, 60


def smallest_set(
    left: FloatArray,
    share: FloatArray,
    columns: Callable[[IntArray], FloatArray],
    observed: BoolArray,
    alpha: float,
) -> BoolArray:
    """Smallest set of points without which no residual of the others is improbable.

    Parameters
    ----------
    left : array (N, K)
        Whitened residuals of all points.
    share : array (N, K, K)
        Redundancy numbers of each: the blocks on the diagonal of their redundancy matrix.
    columns : callable
        Columns (N·K, M·K) of that matrix that belong to some points (M,).
    observed : bool array (N, K)
        Components that were observed.
    alpha : float
        Probability below which a residual is no chance.

    Returns
    -------
    bool array (N,)
        Nothing where more than a third of the points would be left out, or where too little would check the others.
    """
    count, limit = len(left), float(np.log(alpha / max(1, len(left))))
    known = observed[:, :, None] & observed[:, None, :]
    points = _Residuals(np.where(observed, left, 0.0), np.where(known, share, 0.0), observed.ravel(), columns)
    redundancy = points.redundancy
    best: list[tuple[int, ...]] = [()]
    for taken in range(count // 3 + 1):
        gains: dict[tuple[int, ...], float] = {(): 0.0}
        if taken == 1:
            grown = points.grown(())[0].tolist()
            gains = {(i,): grown[i] for i in range(count)}
        elif taken and comb(count, taken) <= TRIED:
            gains = {each: points.gain(each) for each in combinations(range(count), taken)}
        elif taken:
            gains = {}
            for one in best:
                grown = points.grown(one)[0].tolist()
                gains |= {tuple(sorted((*one, i))): grown[i] for i in range(count) if i not in one}
        best = sorted(sorted(gains), key=lambda one: -gains[one])[:KEPT]
        more, checked = points.grown(best[0])
        chance = log_chi_squared_tail(np.maximum(more - points.gain(best[0]), 0.0), checked)
        if redundancy - points.checked(best[0]) < LEFT * points.checked(best[0]):
            break
        if not (np.delete(chance, best[0]) < limit).any():
            wrong = np.zeros(count, dtype=np.bool_)
            wrong[list(best[0])] = True
            return wrong
    return np.zeros(count, dtype=np.bool_)


@dataclass(frozen=True, eq=False)
class _Residuals:
    """Residuals (N, K) and their redundancy numbers (N, K, K), zero where nothing was observed (N·K,)."""

    left: FloatArray
    share: FloatArray
    known: BoolArray
    columns: Callable[[IntArray], FloatArray]
    # Columns (N·K, K) of points that were tried: the whole matrix of 3,000 points would take gigabytes.
    tried: dict[int, FloatArray] = field(default_factory=dict)

    def _of(self, taken: tuple[int, ...]) -> FloatArray:
        """Columns (N·K, T·K) of the redundancy matrix that belong to some points."""
        size = self.left.shape[1]
        new = [each for each in taken if each not in self.tried]
        if new:
            found = self.columns(np.array(new)).reshape(len(self.known), len(new), size)
            for place, each in enumerate(new):
                both = self.known[:, None] & self.known[each * size : (each + 1) * size]
                self.tried[each] = np.where(both, found[:, place], 0.0)
        return np.hstack([np.zeros((len(self.known), 0)), *(self.tried[each] for each in taken)])

    def _own(self, taken: tuple[int, ...]) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Columns of some points, a root of the inverse of their redundancy matrix, and their residuals times it."""
        size = self.left.shape[1]
        columns = self._of(taken)
        rows = (np.array(taken, dtype=np.int64)[:, None] * size + np.arange(size)).ravel()
        values, turns = np.linalg.eigh(columns[rows])
        root: FloatArray = turns[:, values > CHECKED] / np.sqrt(values[values > CHECKED])
        return columns, root, root.T @ self.left.ravel()[rows]

    @property
    def redundancy(self) -> float:
        """Directions in which the points contradict each other or the rest; infinite where they are many."""
        if len(self.left) > PLENTY:
            return float("inf")
        return float((np.linalg.eigvalsh(self._of(tuple(range(len(self.left))))) > CONTRADICTED).sum())

    def checked(self, taken: tuple[int, ...]) -> int:
        """Components of some points that the others check."""
        return len(self._own(taken)[2])

    def gain(self, taken: tuple[int, ...]) -> float:
        """Fall of the sum of squares without some points."""
        amount = self._own(taken)[2]
        return float(amount @ amount)

    def grown(self, taken: tuple[int, ...]) -> tuple[FloatArray, IntArray]:
        """Falls (N,) without some points and each other one more, and the coordinates of this one that are checked."""
        # By the Schur complement of the set: a matrix of its own for each larger one took a minute for 100 points.
        columns, root, amount = self._own(taken)
        by = (columns @ root).reshape(*self.left.shape, root.shape[1])
        more, checked = deletion_statistic(self.left - by @ amount, self.share - by @ np.swapaxes(by, 1, 2), CHECKED)
        return float(amount @ amount) + more, checked
