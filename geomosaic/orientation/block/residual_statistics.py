"""Statistics of the residuals of a block: redundancy numbers, and how improbable each residual is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomosaic.estimation.statistics import log_chi_squared_tail
from geomosaic.orientation.block.problem import BlockProblem
from geomosaic.orientation.block.unknowns import BlockState
from geomosaic.types import BoolArray, FloatArray, IntArray

# Weight of measurements left out, in networks that predict them: their residual counts for nothing, and the share of
# the solution in it is still known to eight digits.
PREDICTED = 1e-8
# Smallest share of a measurement that others check: below it nothing can be said about it.
CHECKED = 1e-6


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
        there = state.moving[group.point] if group.of_points else np.ones(len(weight), dtype=bool)
        weights.append(np.where(out & there, PREDICTED, weight))
    residuals = problem.misclosures(state)
    for left, weight in zip(residuals, weights, strict=True):
        weight[~np.isfinite(left).all(axis=1)] = 0.0
    network = problem.linearise(replace(state, weights=tuple(weights)))
    found = iter(network.redundancy_numbers())
    statistics = []
    for group, left, weight in zip(problem.groups, residuals, weights, strict=True):
        part = weight > 0.0
        size = left.shape[1]
        share = np.zeros((len(weight), size, size))
        if part.any():
            share[part] = next(found)
        out = part & (weight < 1e-6)
        share[out] = -(np.eye(size) + (np.eye(size) - share[out]) / PREDICTED)
        observed = group.observed
        share *= observed[:, :, None] & observed[:, None, :]
        statistics.append(_tested(left, share))
    return statistics


def _tested(left: FloatArray, share: FloatArray) -> ResidualStatistics:
    predicted = (np.trace(share, axis1=1, axis2=2) < 0.0)[:, None, None]
    # In the axes of the redundancy numbers: components that are not checked say nothing.
    values, vectors = np.linalg.eigh(np.where(predicted, -share, share))
    turned = np.einsum("nij,ni->nj", vectors, np.nan_to_num(left))
    checked = values > CHECKED
    # A residual is R·e of its error e; a prediction error is e itself, with cofactors I + A·Q·Aᵀ.
    statistic = np.where(checked, turned**2 / np.where(checked, values, 1.0), 0.0).sum(axis=1)
    freedom = checked.sum(axis=1)
    chance = log_chi_squared_tail(statistic, freedom)
    chance = np.where(np.isfinite(left).all(axis=1), chance, -np.inf)
    return ResidualStatistics(left, share, statistic, freedom, chance)
