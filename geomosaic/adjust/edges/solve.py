"""Gauss-Newton on the combined adjustment, with its cofactors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.adjust.edges.problem import Problem
from geomosaic.adjust.network.linear import Network
from geomosaic.errors import SolveError
from geomosaic.sensor.model import SensorModel
from geomosaic.types import AnyArray, FloatArray

ROUNDS = 50
HALVINGS = 20
GOAL = 1e-9
WORST_CONDITION = 1e7
"""Of the design. Beyond it half of the digits of a solution are noise."""


@dataclass(frozen=True)
class Solution:
    """What the adjustment found.

    Attributes
    ----------
    models : list of SensorModel
    ground : array (S, 3)
        Adjusted stations in the map CRS.
    ground_cofactors : array (S, 2, 2)
        Of x and y; 0 for stations that are held.
    residuals : array (N, 2)
        Measured minus computed, pixels.
    cofactors : array (P, P)
        Of all parameters, photo after photo; 0 for those held fixed.
    sigma0 : float
        NaN without redundancy.
    redundancy : int
    iterations : int
    condition : float
        Of the design of all unknowns, columns of unit length.
    network : Network
        Linearised there.
    """

    models: list[SensorModel]
    ground: FloatArray
    ground_cofactors: FloatArray
    residuals: FloatArray
    cofactors: FloatArray
    sigma0: float
    redundancy: int
    iterations: int
    condition: float
    network: Network


def solve(problem: Problem, models: list[SensorModel], ground: FloatArray) -> Solution:
    """Adjust from a start.

    Parameters
    ----------
    problem : Problem
    models : list of SensorModel
        Start values.
    ground : array (S, 3)
        Start of the stations, in the map CRS.

    Raises
    ------
    SolveError
        The points do not determine the parameters (it names them), or there is no convergence.
    """
    free = problem.free
    labels = np.array(problem.names)[free]
    values = np.concatenate([model.parameters.values for model in models])
    residuals = problem.residuals(models, ground)
    _need_seen(problem, residuals)
    cost = problem.cost(residuals, ground, values)
    for iteration in range(1, ROUNDS + 1):
        network = problem.network(models, residuals, ground, values)
        _need_determined(network, labels)
        step, shift = network.changes()
        factor = 1.0
        for _ in range(HALVINGS):
            trial_values, trial_ground = values.copy(), ground.copy()
            trial_values[free] += factor * step
            trial_ground[:, :2] += factor * shift
            trial_models = _with(problem, models, trial_values)
            trial_residuals = problem.residuals(trial_models, trial_ground)
            trial_cost = problem.cost(trial_residuals, trial_ground, trial_values)
            if trial_cost <= cost * (1.0 + 1e-12) + 1e-20:
                break
            factor *= 0.5
        moved = float(np.max(np.abs(step) / problem.steps[free], initial=0.0))
        if trial_cost <= cost * (1.0 + 1e-12) + 1e-20:
            done = moved < GOAL or (cost - trial_cost <= 1e-14 * cost and moved < 1e-5)
            values, ground, models, residuals, cost = (
                trial_values, trial_ground, trial_models, trial_residuals, trial_cost,
            )  # fmt: skip
        else:
            done = moved < 1e-4  # nothing better within reach: rounding, not failure
        if done:
            return _solution(problem, models, residuals, ground, values, cost, iteration, labels)
        if factor < 1e-5:
            break
    raise SolveError(
        "the edge matching does not converge",
        mend="check the start values of the photos, and the points for wrong measurements",
    )


def _with(problem: Problem, models: list[SensorModel], values: FloatArray) -> list[SensorModel]:
    ends = problem.offsets
    return [model.with_values(values[ends[i] : ends[i + 1]]) for i, model in enumerate(models)]


def _need_seen(problem: Problem, residuals: FloatArray) -> None:
    lost = np.flatnonzero(~np.isfinite(residuals).all(axis=1))
    if len(lost):
        s = problem.stations
        raise SolveError(
            f"the photo does not see point '{s.ids[s.station[lost[0]]]}' where it starts",
            where=problem.photos[s.photo[lost[0]]],
            mend="check the point's coordinates and the start values of the photo",
        )


def _need_determined(network: Network, labels: AnyArray) -> float:
    """Condition number; refuse a design whose columns depend on each other."""
    condition, direction = network.normals.condition() if sum(network.design.shape[1:]) else (1.0, np.zeros(0))
    if network.redundancy < 0 or not condition < WORST_CONDITION:
        share = np.abs(direction[: network.unknowns])
        together = labels[share > 0.1 * share.max(initial=0.0)]
        raise SolveError(
            f"control and common points do not determine {', '.join(together)}",
            mend="add control or common points, spread over the photos, or choose a simpler model",
        )
    return condition


def _solution(
    problem: Problem,
    models: list[SensorModel],
    residuals: FloatArray,
    ground: FloatArray,
    values: FloatArray,
    cost: float,
    iterations: int,
    labels: AnyArray,
) -> Solution:
    network = problem.network(models, residuals, ground, values)
    condition = _need_determined(network, labels)
    small, of_ground = network.cofactors()
    cofactors = np.zeros((len(problem.free), len(problem.free)))
    cofactors[np.ix_(problem.free, problem.free)] = small
    redundancy = network.redundancy
    sigma0 = float(np.sqrt(cost / redundancy)) if redundancy > 0 else float("nan")
    return Solution(models, ground, of_ground, residuals, cofactors, sigma0, redundancy, iterations, condition, network)
