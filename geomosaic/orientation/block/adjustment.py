"""Adjustment of a block: robust start, rejection of blunders, and the statistics of what came out.

1. A few rounds with weights that fall with the length of a residual (Geman and McClure 1985), over the median length, so
   that a tenth of wrong measurements does not bend the block.
2. Least squares on what agrees, and data snooping (Baarda 1968): of each point the measurement whose residual is least
   probable is left out, as long as one is no chance; left-out measurements that the rest predicts come back.
3. Cofactors of all unknowns from the factorised normal equations, redundancy numbers, variance components of the groups
   (Förstner 1979).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from geomosaic.errors import SolveError
from geomosaic.estimation.network import Network
from geomosaic.estimation.solver import Outcome, Solution, Stopping, solve
from geomosaic.estimation.statistics import sigma0_of
from geomosaic.orientation.block.problem import BlockProblem
from geomosaic.orientation.block.unknowns import BlockState
from geomosaic.types import BoolArray, FloatArray, IntArray

# Probability of rejecting a good measurement, for one test.
ALPHA = 1e-4
# Median residual lengths at which an image position has a quarter of its weight in the robust rounds.
ROBUST = 3.0
ROBUST_ROUNDS = 12
# Rounds of rejection at most; each leaves out at most one measurement of a point.
SEARCHES = 25
# Weight of measurements left out, in networks that predict them: their residual counts for nothing, and the share of
# the solution in it is still known to eight digits.
PREDICTED = 1e-8
# Smallest share of a measurement that others check: below it nothing can be said about it.
CHECKED = 1e-6

RULES = Stopping(rounds=50, step=1e-6, near=1e-3, gain=1e-9)
# Weights change from round to round, and a smaller median makes all sums larger.
ROBUST_RULES = Stopping(rounds=ROBUST_ROUNDS, step=1e-2, near=1e-1, rise=np.inf)


@dataclass(frozen=True, eq=False)
class BlockAdjustment:
    """Adjusted block.

    Attributes
    ----------
    problem : BlockProblem
    state : BlockState
        At the minimum; observations with weight 0 are left out.
    network : Network
        Linearised there, of what takes part.
    squares : float
        Weighted sum of squares.
    redundancy : int
    sigma0 : float
        Standard deviation of unit weight.
    rounds : int
        Linearisations solved, of all stages.
    residuals : tuple of array
        Whitened measured minus computed (N, K) of each group, what was left out among them.
    redundancy_numbers : tuple of array
        Share (N, K, K) of each group's measurements that the others check; of what was left out the negative, I + A·Q·Aᵀ
        being the cofactors of its prediction error.
    probability : tuple of array
        Of an error (N,) as large as each measurement's, by chance.
    rejected : tuple of bool array
        Measurements (N,) of each group that were left out as blunders.
    """

    problem: BlockProblem
    state: BlockState
    network: Network
    squares: float
    redundancy: int
    sigma0: float
    rounds: int
    residuals: tuple[FloatArray, ...]
    redundancy_numbers: tuple[FloatArray, ...]
    probability: tuple[FloatArray, ...]
    rejected: tuple[BoolArray, ...]

    @property
    def variance_components(self) -> dict[str, tuple[float, float]]:
        """Factor of the variances of each group (1 where they were right), and the redundancy that it rests on."""
        found = {}
        for group, left, share, weight in zip(
            self.problem.groups, self.residuals, self.redundancy_numbers, self.state.weights, strict=True
        ):
            part = weight > 0.0
            redundancy = float(np.trace(share[part], axis1=1, axis2=2).sum())
            squares = float((left[part] ** 2).sum())
            found[group.name] = (squares / redundancy if redundancy > 0.5 else float("nan"), redundancy)
        return found


def adjust_block(
    problem: BlockProblem, start: BlockState, *, robust: bool = True, alpha: float | None = ALPHA
) -> BlockAdjustment:
    """Least squares adjustment of a block, without its blunders.

    Parameters
    ----------
    problem : BlockProblem
    start : BlockState
    robust : bool
        Whether weights that fall with the residuals precede least squares.
    alpha : float, optional
        Probability below which a residual is no chance; None keeps everything.

    Returns
    -------
    BlockAdjustment

    Raises
    ------
    SolveError
        The observations do not determine the unknowns, or there is no convergence.
    """
    rounds, state = 0, problem.checked(start)
    rejected = [np.zeros(len(weight), dtype=np.bool_) for weight in state.weights]
    if robust and alpha is not None:
        found = solve(replace(problem, robust=ROBUST), state, ROBUST_RULES)
        rounds += found.rounds
        rejected = _outlying(problem, found.state)
        state = found.state
    for _ in range(SEARCHES):
        solution = _solved(problem, _without(problem, state, start, rejected))
        state = solution.state
        rounds += solution.rounds
        residuals, shares, probability = _statistics(problem, state, rejected)
        if alpha is None or not _searched(problem, state, rejected, (residuals, shares, probability), alpha):
            break
    network = problem.linearise(state)
    redundancy = network.redundancy
    return BlockAdjustment(
        problem, state, network, solution.squares, redundancy, sigma0_of(solution.squares, redundancy), rounds,
        tuple(residuals), tuple(shares), tuple(probability), tuple(rejected),
    )  # fmt: skip


def _without(
    problem: BlockProblem, state: BlockState, start: BlockState, rejected: Sequence[BoolArray]
) -> BlockState:
    """Present values with all observations that can be computed, but those rejected."""
    weights = tuple(np.where(out, 0.0, first) for out, first in zip(rejected, start.weights, strict=True))
    return problem.checked(replace(state, weights=weights, moving=start.moving))


def _outlying(problem: BlockProblem, state: BlockState) -> list[BoolArray]:
    """Observations whose weight fell below a twenty-fifth in robust rounds."""
    found = []
    for group, weight in zip(problem.groups, state.weights, strict=True):
        far = (weight > 0.0) & (weight < 0.04)
        found.append(far if group.of_points else np.zeros(len(weight), dtype=np.bool_))
    return found


def _solved(problem: BlockProblem, state: BlockState) -> Solution[BlockState]:
    solution = solve(problem, state, RULES)
    if solution.outcome is not Outcome.CONVERGED:
        raise SolveError(
            f"the block adjustment does not converge ({solution.rounds} rounds)",
            hint="check the start values, the CRS of the control points and the units of sigmas",
        )
    return solution


Statistics = tuple[list[FloatArray], list[FloatArray], list[FloatArray]]


def _statistics(problem: BlockProblem, state: BlockState, rejected: Sequence[BoolArray]) -> Statistics:
    """Whitened residuals, redundancy numbers and probabilities of each group at a state."""
    weights = []
    for group, weight, out in zip(problem.groups, state.weights, rejected, strict=True):
        there = state.moving[group.point] if group.of_points else np.zeros(len(weight), dtype=bool)
        weights.append(np.where(out & there, PREDICTED, weight))
    full = replace(state, weights=tuple(weights))
    residuals = problem.misclosures(state)
    for left, weight in zip(residuals, weights, strict=True):
        weight[~np.isfinite(left).all(axis=1)] = 0.0
    network = problem.linearise(full)
    shares, probabilities, place = [], [], 0
    for group, left, weight in zip(problem.groups, residuals, weights, strict=True):
        part = weight > 0.0
        size = left.shape[1]
        share = np.zeros((len(weight), size, size))
        if part.any():
            share[part] = network.redundancy_numbers(place)
            place += 1
        out = part & (weight < 1e-6)
        # R = I − w·A·Q·Aᵀ of what is predicted: the cofactors of its error are I + A·Q·Aᵀ.
        share[out] = -(np.eye(size) + (np.eye(size) - share[out]) / PREDICTED)
        shares.append(share)
        probabilities.append(_probability(left, share))
    return residuals, shares, probabilities


def _probability(left: FloatArray, share: FloatArray) -> FloatArray:
    """Probability (N,) of whitened errors as large as these by chance; 1 of what nothing checks."""
    predicted = (np.trace(share, axis1=1, axis2=2) < 0.0)[:, None, None]
    # In the axes of the redundancy numbers: components that are not checked say nothing.
    values, vectors = np.linalg.eigh(np.where(predicted, -share, share))
    turned = np.einsum("nij,ni->nj", vectors, np.nan_to_num(left))
    checked = values > CHECKED
    over = np.where(checked, values, 1.0)
    # A residual is R·e of its error e; a prediction is the error itself, with cofactors I + A·Q·Aᵀ.
    statistic = np.where(checked, turned**2 / over, 0.0).sum(axis=1)
    freedom = checked.sum(axis=1)
    out: FloatArray = np.where(freedom > 0, chi2.sf(statistic, np.maximum(freedom, 1)), 1.0)
    return np.where(np.isfinite(left).all(axis=1), out, 0.0)


def _searched(
    problem: BlockProblem, state: BlockState, rejected: list[BoolArray], statistics: Statistics, alpha: float
) -> bool:
    """One round of the search for blunders, which changes `rejected` in place; False where nothing is left to do."""
    residuals, shares, probability = statistics
    # The least probable of each point among all groups, image positions and control alike.
    least, tested = np.ones(len(state.points)), []
    for index, group in enumerate(problem.groups):
        usable = (np.trace(shares[index], axis1=1, axis2=2) > CHECKED) & (state.weights[index] > 0.0)
        tested.append(np.where(usable, probability[index], 1.0))
        if group.of_points:
            np.minimum.at(least, group.point, tested[-1])
    changed = False
    for index, group in enumerate(problem.groups):
        if group.of_points:
            worst = (tested[index] < alpha) & (tested[index] <= least[group.point])
            worst = _one_of_each_point(worst, group.point, residuals[index], len(least))
            rejected[index] |= worst
            changed |= bool(worst.any())
    if changed:
        return True
    for index in range(len(problem.groups)):
        predicted = np.trace(shares[index], axis1=1, axis2=2) < 0.0
        back = rejected[index] & predicted & (probability[index] > alpha)
        rejected[index] &= ~back
        changed |= bool(back.any())
    return changed


def _one_of_each_point(worst: BoolArray, point: IntArray, left: FloatArray, size: int) -> BoolArray:
    """Of several rows of one point, the one with the longest whitened residual."""
    length = np.where(worst, np.nan_to_num((left**2).sum(axis=1), nan=np.inf), -1.0)
    longest = np.full(size, -1.0)
    np.maximum.at(longest, point, length)
    return worst & (length >= longest[point])


