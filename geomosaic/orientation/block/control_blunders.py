"""Blunders among the control points of a block: the smallest set without which nothing contradicts the rest.

A block leans on few control points, and a wrong one bends it: its error shows in its neighbours as much as in itself,
and of several wrong ones the first to be rejected would often be a good one. So sets are compared. With the whitened
residuals v of all control and their redundancy matrix R = I − A·Q·Aᵀ of one adjustment, the sum of squares without the
set S falls by v_Sᵀ R_SS⁻¹ v_S (Kok 1984): every set can be judged without another adjustment.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from math import comb

import numpy as np

from geomosaic.estimation.statistics import log_chi_squared_tail
from geomosaic.orientation.block.observations import GroundControl
from geomosaic.orientation.block.problem import BlockProblem
from geomosaic.orientation.block.unknowns import BlockState
from geomosaic.types import BoolArray, FloatArray, IntArray

# Sets of one size that are all tried; of more, those that grow from the best smaller ones.
TRIED = 2_000
KEPT = 20
# Eigenvalue of R_SS from which on the rest of the block checks a direction.
CHECKED = 1e-9


def search_control(problem: BlockProblem, state: BlockState, alpha: float, scale: float = 1.0) -> dict[int, BoolArray]:
    """Control points that contradict the others and the rays of the block.

    Parameters
    ----------
    problem : BlockProblem
    state : BlockState
        A solution, whatever control took part in it.
    alpha : float
        Probability below which an error is no chance.
    scale : float
        Standard deviation of unit weight of the image positions.

    Returns
    -------
    dict of int to bool array
        For each group of control, by its number, the points (N,) that are wrong. None of them where more than a third
        would be: then nobody can say which are right.
    """
    found = {}
    for index, group in enumerate(problem.groups):
        if isinstance(group, GroundControl) and len(group):
            found[index] = _searched(problem, state, index, group, alpha, scale)
    return found


def _searched(
    problem: BlockProblem, state: BlockState, index: int, group: GroundControl, alpha: float, scale: float
) -> BoolArray:
    with_all = [*state.weights]
    with_all[index] = np.where(state.moving[group.points], 1.0, 0.0)
    if not with_all[index].any():
        return np.zeros(len(group), dtype=np.bool_)
    network = problem.linearise(replace(state, weights=tuple(with_all)))
    part = with_all[index] > 0.0
    place = [i for i, weight in enumerate(with_all) if (weight > 0.0).any()].index(index)
    first = sum(each.misclosure.size for each in network.groups[:place])
    rows = np.arange(first, first + network.groups[place].misclosure.size)
    left = network.residuals(network.step())[rows] / scale
    share = network.redundancy_matrix(place)
    size = group.root.shape[1]
    observed = group.observed[part]
    wrong = np.zeros(len(group), dtype=np.bool_)
    wrong[np.flatnonzero(part)] = smallest_set(left.reshape(-1, size), share, observed, alpha)
    return wrong


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
    values, vectors = np.linalg.eigh(share[np.ix_(own, own)])
    checked = values > CHECKED
    return float(((vectors.T @ left[own])[checked] ** 2 / values[checked]).sum()), int(checked.sum())


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
