"""Tests of a block's residuals: how improbable each is, and the control points that contradict the rest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from geomosaic.estimation.blunders.smallest_set import smallest_set
from geomosaic.estimation.statistics import deletion_statistic, log_chi_squared_tail, median_variance
from geomosaic.orientation.block.observations import GroundControl
from geomosaic.orientation.block.problem import BlockProblem
from geomosaic.orientation.block.unknowns import BlockState
from geomosaic.orientation.block.weak_rotation import weak_rotation
from geomosaic.types import BoolArray, FloatArray, IntArray

# Weight of measurements left out, in networks that predict them: their residual counts for nothing, and the share of
# the solution in it is still known to eight digits.
PREDICTED = 1e-8
# Smallest share of a measurement that others check: below it nothing can be said about it.
CHECKED = 1e-6
# By how much a variance of N tests must exceed 1, times √N: four standard deviations of their median, of half as many
# independent ones.
SURELY = 8.0
# Growth of the standard deviation of the weakest rotation without some observations from which on these hold it.
HELD = 2.0


@dataclass(frozen=True, eq=False)
class ResidualStatistics:
    """Residuals of one group of N observations of K components, what was left out among them.

    Attributes
    ----------
    residuals : array (N, K)
        Whitened measured minus computed.
    share : array (N, K, K)
        Redundancy numbers R = I − A·Q·Aᵀ, the share of each measurement that the others check; of what was left out
        minus I + A·Q·Aᵀ, the cofactors of its prediction error. Zero where nothing is known.
    statistic : array (N,)
        vᵀ·R⁻¹·v: by how much the sum of squares would fall without the measurement, or rise with it.
    freedom : int array (N,)
        Components that others check.
    log_probability : array (N,)
        Natural logarithm of the probability of a statistic as large, by chance; 0 of what nothing checks.
    """

    residuals: FloatArray
    share: FloatArray
    statistic: FloatArray
    freedom: IntArray
    log_probability: FloatArray

    @property
    def predicted(self) -> BoolArray:
        """Measurements (N,) that were left out, and that the rest predicts."""
        return np.asarray(np.trace(self.share, axis1=1, axis2=2) < 0.0)

    @property
    def checked(self) -> BoolArray:
        """Measurements (N,) that take part, and that others check."""
        return np.asarray(np.trace(self.share, axis1=1, axis2=2) > CHECKED)


def residual_statistics(
    problem: BlockProblem, state: BlockState, rejected: Sequence[BoolArray]
) -> list[ResidualStatistics]:
    """Statistics of each group at a solution.

    Parameters
    ----------
    problem : BlockProblem
    state : BlockState
    rejected : sequence of bool array
        Measurements (N,) of each group that were left out.
    """
    weights = []
    for group, weight, out in zip(problem.groups, state.weights, rejected, strict=True):
        weights.append(np.where(out & group.placed(state.moving), PREDICTED, weight))
    residuals = problem.misclosures(state)
    for left, weight in zip(residuals, weights, strict=True):
        weight[~np.isfinite(left).all(axis=1)] = 0.0
    network = problem.linearise(replace(state, weights=tuple(weights)))
    found = iter(network.redundancy_numbers())
    statistics, unit = [], 1.0
    for index, (group, left, weight) in enumerate(zip(problem.groups, residuals, weights, strict=True)):
        part = weight > 0.0
        size = left.shape[1]
        share = np.zeros((len(weight), size, size))
        if part.any():
            share[part] = next(found)
        out = part & (weight < 1e-6)
        share[out] = -(np.eye(size) + (np.eye(size) - share[out]) / PREDICTED)
        observed = group.observed
        share *= observed[:, :, None] & observed[:, None, :]
        one = _tested(left, share, 1.0)
        if index == 0 and (unit := unit_variance(one)) > 1.0:
            one = _tested(left, share, unit)
        statistics.append(one)
    return statistics


def unit_variance(one: ResidualStatistics) -> float:
    """Variance of unit weight of image positions after the median of their tests; 1 unless it is surely larger.

    Parameters
    ----------
    one : ResidualStatistics
        Of the image positions.
    """
    # Where a model is too simple (a lens, a shutter), all positions are worse than they were declared. Judged by that,
    # a third of them would go one by one, those that say most about what is missing first.
    judged = one.checked & (one.freedom > 0)
    if not judged.any():
        return 1.0
    unit = median_variance(one.statistic[judged], one.freedom[judged])
    return unit if unit > 1.0 + SURELY / np.sqrt(judged.sum()) else 1.0


def _tested(left: FloatArray, share: FloatArray, unit: float) -> ResidualStatistics:
    """Tests of residuals whose variance of unit weight is `unit`."""
    predicted = (np.trace(share, axis1=1, axis2=2) < 0.0)[:, None, None]
    # A residual is R·e of its error e; a prediction error is e itself, with cofactors I + A·Q·Aᵀ.
    statistic, freedom = deletion_statistic(np.nan_to_num(left), np.where(predicted, -share, share), CHECKED)
    chance = log_chi_squared_tail(statistic / unit, freedom)
    chance = np.where(np.isfinite(left).all(axis=1), chance, -np.inf)
    return ResidualStatistics(left, share, statistic, freedom, chance)


def search_control(problem: BlockProblem, state: BlockState, alpha: float) -> dict[int, BoolArray]:
    """Control points that contradict the others and the rays of the block.

    Parameters
    ----------
    problem : BlockProblem
    state : BlockState
        A solution, whatever control took part in it.
    alpha : float
        Probability below which an error is no chance.

    Returns
    -------
    dict of int to bool array
        For each group of control, by its number, the points (N,) that are wrong. None of them where more than a third
        would be, or where the rest does not hold the block: then nobody can say which are right.
    """
    found = {}
    for index, group in enumerate(problem.groups):
        if isinstance(group, GroundControl) and len(group):
            found[index] = fewest_wrong(problem, state, index, alpha)
    return found


def fewest_wrong(problem: BlockProblem, state: BlockState, index: int, alpha: float) -> BoolArray:
    """Smallest set (N,) of observations of a group, of few, without which its others contradict nothing.

    Empty where a rotation of the block hangs on that set: what turns with it contradicts nothing, right or wrong.

    Parameters
    ----------
    problem : BlockProblem
    state : BlockState
        A solution, whatever took part in it.
    index : int
        Of the group.
    alpha : float
        Probability below which an error is no chance.
    """
    group, with_all = problem.groups[index], [*state.weights]
    with_all[index] = np.where(group.placed(state.moving), 1.0, 0.0)
    if not with_all[index].any():
        return np.zeros(len(group), dtype=np.bool_)
    network = problem.linearise(replace(state, weights=tuple(with_all)))
    part = with_all[index] > 0.0
    place = [i for i, weight in enumerate(with_all) if (weight > 0.0).any()].index(index)
    first = sum(each.misclosure.size for each in network.groups[:place])
    rows = np.arange(first, first + network.groups[place].misclosure.size)
    left = network.residuals(network.step())[rows]
    share, columns = network.redundancy_blocks(place), partial(network.redundancy_columns, place)
    size = network.groups[place].misclosure.shape[1]
    observed = group.observed[part]
    wrong = np.zeros(len(group), dtype=np.bool_)
    wrong[np.flatnonzero(part)] = smallest_set(left.reshape(-1, size), share, columns, observed, alpha)
    return np.zeros_like(wrong) if _hold_rotation(problem, state, with_all, index, wrong) else wrong


def _hold_rotation(
    problem: BlockProblem, state: BlockState, with_all: Sequence[FloatArray], index: int, some: BoolArray
) -> bool:
    """Whether nothing else than `some` (N,) of a group holds a rotation of images to a degree or so."""
    if not some.any():
        return False
    rest, nothing = [*with_all], np.zeros(len(state.models), dtype=np.bool_)
    rest[index] = np.where(some, 0.0, rest[index])
    less, state_less, _ = problem.with_determined_images(replace(state, weights=tuple(rest)), nothing)
    network = less.linearise(state_less)
    if not network.factored.regular:
        return not len(network.undetermined_points)  # points with parallel rays are left out by themselves
    without = weak_rotation(less, state_less)
    if without is None:
        return False
    # However small: one that grows from 0.9 to 1.1 degrees does not hang on the set.
    found = weak_rotation(problem, replace(state, weights=tuple(with_all)), least=0.0)
    return found is None or without.sigma > HELD * found.sigma
