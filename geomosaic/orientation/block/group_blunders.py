"""Groups of observations that contradict the rest of a block as a whole: another datum, a boresight, wrong sigmas.

A DEM that is everywhere too high bends the block as long as it takes part, and single rays and control points would be
blamed for it one by one. So whole groups are tried before single measurements. A common offset c of a group, whose
whitened observations move by J·c, has in the adjusted block the estimate (Jᵀ·R·J)⁻¹·Jᵀ·v (Baarda 1968), with the
redundancy matrix R and the residuals v. A group whose offset would make each of its observations a blunder is left out
for a trial: where that explains what the sum of squares had in excess, and most of its observations share an offset
from what the rest predicts, the group is wrong, and not some of them.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import chi2

from geomosaic.errors import SolveError
from geomosaic.estimation.network import LEAST_PIVOT, Network
from geomosaic.estimation.solver import Outcome, Solution, solve
from geomosaic.orientation.block.observations import (
    GroundControl,
    Group,
    ImagePositions,
    SurfaceHeights,
    in_units,
    rescaled,
    whitening_of,
)
from geomosaic.orientation.block.poses import Attitudes, CameraPositions
from geomosaic.orientation.block.problem import RULES, BlockProblem, Priors
from geomosaic.orientation.block.residual_statistics import (
    CHECKED,
    ResidualStatistics,
    fewest_wrong,
    residual_statistics,
)
from geomosaic.orientation.block.unknowns import BlockState
from geomosaic.types import BoolArray, FloatArray

# Groups that are tried, the least trusted first: where two contradict each other, and nothing else speaks for one of
# them, the first is left out. Image positions are not among them: without these there is no block.
KINDS = (SurfaceHeights, Attitudes, CameraPositions, GroundControl)
# Observations of a group from which on most of them is more than one.
LEAST = 3
# Scatter about the common offset, over the offset, up to which it is one.
COMMON = 0.5
# Share of what the sum of squares has in excess of its expectation that a group must explain to be left out.
EXPLAINED = 0.5
# Share of the largest fall of the sum of squares from which on another group, which the block cannot do without,
# explains the contradiction as well: a linear estimate at a state that is bent.
LINEAR = 0.8
# Observations of a group up to which the sets of those that may be wrong can be tried.
FEW = 30
# Rounds for the scale of standard deviations, and the change that ends them.
ROUNDS, SETTLED = 8, 0.2


@dataclass(frozen=True, eq=False)
class GroupBlunder:
    """Group that contradicts the rest of a block as a whole.

    Attributes
    ----------
    index : int
        Of the group.
    count : int
        Observations.
    offset : array (K,), optional
        Median of measured minus predicted, in the unit of the group: it is left out. None where it only scatters.
    scatter : float
        Factor of the standard deviations under which it takes part.
    others : tuple of int
        Groups that would explain the contradiction as well.
    sigma0_with : float
        Standard deviation of unit weight that the block had with the group as it was given.
    """

    index: int
    count: int
    offset: FloatArray | None
    scatter: float
    others: tuple[int, ...]
    sigma0_with: float

    def applied(self, problem: BlockProblem, start: BlockState) -> tuple[BlockProblem, BlockState]:
        """Problem and first state in which the group takes no part, or only with its larger standard deviations."""
        if self.offset is not None:
            weights = [np.zeros_like(w) if index == self.index else w for index, w in enumerate(start.weights)]
            return problem, replace(start, weights=tuple(weights))
        return _rescaled(problem, self.index, self.scatter), start


@dataclass(frozen=True, eq=False)
class _Trial:
    """Group that was left out for a trial, or given larger standard deviations, and what the rest says of it."""

    index: int
    excess: float  # of the sum of squares over its expectation
    components: int  # of the group
    offset: FloatArray | None
    scale: float = 1.0


def search_groups(
    problem: BlockProblem,
    solution: Solution[BlockState],
    before: BlockState,
    start: BlockState,
    known: Collection[int],
    alpha: float,
) -> GroupBlunder | None:
    """Group that contradicts the rest of the block; None where none does.

    Parameters
    ----------
    problem : BlockProblem
    solution : Solution
        With everything, converged or not.
    before : BlockState
        State from which it was solved: the next solutions begin there, not at one that is bent.
    start : BlockState
        Before any rejection.
    known : collection of int
        Groups that are not looked at.
    alpha : float
        Probability below which an error is no chance.
    """
    solved, squares = solution.state, solution.squares
    candidates = [
        index
        for index, group in enumerate(problem.groups)
        if isinstance(group, KINDS) and index not in known and (solved.weights[index] > 0.0).sum() >= LEAST
    ]
    # Most blocks end here, and at no cost.
    redundancy = _redundancy(problem, solved)
    fits = solution.outcome is Outcome.CONVERGED and chi2.logsf(squares, redundancy) > np.log(alpha)
    few = [index for index in candidates if _control_alone(problem) and len(problem.groups[index]) <= FEW]
    if not candidates or (fits and not few):
        return None
    network = problem.linearise(solved)
    if not network.factored.regular:
        return None  # a solution that ran away says nothing of anybody
    if fits and not any(_contradictory(problem, network, solved, index, alpha) for index in few):
        return None
    sigma0 = float(np.sqrt(squares / max(redundancy, 1)))
    falls = {index: _fall(problem, network, solved, index, alpha) for index in candidates}
    statistics = residual_statistics(problem, solved, [np.zeros(len(w), dtype=np.bool_) for w in solved.weights])
    excess = squares - redundancy
    least_fall = EXPLAINED * excess
    trials, scattered, untried = list[_Trial](), list[int](), list[int]()
    for index, fall in falls.items():
        improbable = _improbable(problem, statistics[index], solved.weights[index], alpha)
        if not fall and not improbable:
            continue
        trial = _tried(problem, before, start, index, alpha)
        if trial is None:
            # What the rest cannot predict is judged by the block that is bent.
            untried += [index] if fall > LINEAR * max(falls.values()) else []
            explains = improbable
        else:
            explains = excess - trial.excess > least_fall
        if trial is not None and explains and fall and trial.offset is not None:
            trials.append(trial)
        elif explains and not _few(problem, solved, index, alpha):
            scattered.append(index)
    if not trials:
        # Larger standard deviations give nothing up: image positions may have an excess of their own beside it.
        trials, untried = [_scattered(problem, before, index) for index in scattered], []
        if _control_alone(problem):
            least_fall = -2.0 * float(np.log(alpha))
    least = min(trials, key=lambda trial: trial.excess, default=None)
    if least is None or excess - least.excess <= least_fall:
        return None
    equal = [trial for trial in trials if trial.excess - least.excess <= _chance(trial, least, alpha)]
    first = min(equal, key=lambda trial: _trust(problem.groups[trial.index]))
    others = (*untried, *(trial.index for trial in equal if trial is not first))
    count = int((solved.weights[first.index] > 0.0).sum())
    return GroupBlunder(first.index, count, first.offset, first.scale, tuple(sorted(others)), sigma0)


def _few(problem: BlockProblem, solved: BlockState, index: int, alpha: float) -> bool:
    """Whether some wrong observations of a group explain what seems to be wrong with all of them."""
    return len(problem.groups[index]) <= FEW and bool(fewest_wrong(problem, solved, index, alpha).any())


def _chance(one: _Trial, other: _Trial, alpha: float) -> float:
    """Difference of excess that may be chance: a likelihood ratio, and the scatter of squares that one lacks."""
    return float(-2.0 * np.log(alpha) + 3.0 * np.sqrt(2.0 * (one.components + other.components)))


def _redundancy(problem: BlockProblem, state: BlockState) -> int:
    """Observed components less unknowns."""
    observed = 0
    for group, weight in zip(problem.groups, state.weights, strict=True):
        size = group.components if group is problem.views else group.observed.shape[1]
        observed += int(np.broadcast_to(group.observed, (len(group), size))[weight > 0.0].sum())
    return observed - problem.unknowns.count - 3 * int(np.delete(state.moving, problem.unknowns.kept).sum())


def _rescaled(problem: BlockProblem, index: int, factor: float) -> BlockProblem:
    """Problem with the standard deviations of a group times a factor."""
    groups = [*problem.groups]
    groups[index] = rescaled(groups[index], factor)
    return replace(problem, groups=tuple(groups))


def _trust(group: Group) -> int:
    return next(place for place, kind in enumerate(KINDS) if isinstance(group, kind))


def _control_alone(problem: BlockProblem) -> bool:
    """Whether nothing but image positions and control was observed."""
    return all(isinstance(each, ImagePositions | GroundControl | Priors) for each in problem.groups)


def _improbable(problem: BlockProblem, one: ResidualStatistics, weight: FloatArray, alpha: float) -> bool:
    """Whether most observations of a group are no chance, or a few control points together that nothing else bends."""
    part = weight > 0.0
    if float(np.median(one.log_probability[part])) < np.log(alpha):
        return True
    if not _control_alone(problem) or part.sum() > FEW:
        return False
    return _too_large(one.residuals[part], one.share[part], alpha)


def _contradictory(problem: BlockProblem, network: Network, state: BlockState, index: int, alpha: float) -> bool:
    """Whether a few control points contradict each other, which the sum of squares of all image positions hides."""
    part = state.weights[index] > 0.0
    place = sum(bool((weight > 0.0).any()) for weight in state.weights[:index])
    left = problem.groups[index].misclosure(state, problem.frame)[part]
    return _too_large(left, network.redundancy_blocks(place), alpha)


def _too_large(left: FloatArray, share: FloatArray, alpha: float) -> bool:
    """Whether whitened residuals (N, K) with redundancy numbers (N, K, K) are together no chance."""
    redundancy = float(np.trace(share, axis1=1, axis2=2).sum())
    return bool(redundancy >= 1.0 and chi2.logsf(float((left**2).sum()), redundancy) < np.log(alpha))


def _fall(problem: BlockProblem, network: Network, state: BlockState, index: int, alpha: float) -> float:
    """Fall of the sum of squares with a common offset of a group.

    0 of one that is chance, or no larger than what single observations may be off.
    """
    part = state.weights[index] > 0.0
    place = sum(bool((weight > 0.0).any()) for weight in state.weights[:index])
    by = whitening_of(problem.groups[index])[part]
    size = by.shape[2]
    left = np.split(network.residuals(network.step()), np.cumsum([g.misclosure.size for g in network.groups])[:-1])
    own = by.reshape(-1, size)
    sides = []
    for axis in range(size):
        each = [np.zeros(group.misclosure.shape) for group in network.groups]
        each[place] = np.ascontiguousarray(by[:, :, axis])
        parameters, points = network.normals.turned_product(each)
        sides.append(np.concatenate([parameters, points[network.moving]]))
    side = np.array(sides).T
    total = own.T @ own
    information = total - side.T @ network.solve(side)
    # Along what a strip's offset or a boresight takes up, nothing is left to test.
    values, vectors = np.linalg.eigh(information)
    determined = values > CHECKED * np.trace(total)
    amount = vectors.T @ (own.T @ left[place])
    fall = float((amount[determined] ** 2 / values[determined]).sum())
    if not determined.any() or chi2.logsf(fall, determined.sum()) > np.log(alpha):
        return 0.0
    offset = vectors[:, determined] @ (amount[determined] / values[determined])
    return fall if _off(by, offset) > chi2.isf(alpha, size) else 0.0


def _tried(problem: BlockProblem, before: BlockState, start: BlockState, index: int, alpha: float) -> _Trial | None:
    """Solution without a group, and what it predicts; None where the rest does not determine the block."""
    group = problem.groups[index]
    weights = [weight.copy() for weight in before.weights]
    used = weights[index] > 0.0
    weights[index][:] = 0.0
    state = replace(before, weights=tuple(weights))
    nothing: BoolArray = np.zeros(len(before.models), dtype=np.bool_)
    try:
        rest, state, held = problem.with_determined_images(state, nothing)
        if (held & ~_held(problem)).any() or not rest.linearise(state).least_pivot >= LEAST_PIVOT:
            return None
        solution = solve(rest, state, RULES)
        state, squares, first = solution.state, solution.squares, solution.state
        if isinstance(group, GroundControl) and solution.outcome is Outcome.CONVERGED:
            state = solve(rest, _with_rays(rest, state, start, group), RULES).state
    except SolveError:
        return None
    if solution.outcome is not Outcome.CONVERGED:
        return None
    out = [np.zeros(len(weight), dtype=np.bool_) for weight in weights]
    out[index] = used
    predicted = residual_statistics(rest, state, out)[index]
    known = used & predicted.predicted
    if known.sum() < LEAST:
        return None
    components = int(used.sum()) * predicted.residuals.shape[1]
    offset = _common(in_units(group, predicted.residuals)[known])
    # As large as would make each of its observations a blunder.
    if offset is not None and _off(whitening_of(group)[known], offset) <= chi2.isf(alpha, len(offset)):
        offset = None
    return _Trial(index, squares - _redundancy(rest, first), components, offset)


def _off(by: FloatArray, offset: FloatArray) -> float:
    """Median square of an offset (K,) over the standard deviations of observations with whitening matrices `by`."""
    return float(np.median(((by @ offset) ** 2).sum(axis=1)))


def _with_rays(problem: BlockProblem, state: BlockState, start: BlockState, group: GroundControl) -> BlockState:
    """State with the rays of control points that lost against these."""
    mine = np.isin(problem.views.points, group.points)
    weights, points, moving = [*state.weights], state.points.copy(), state.moving.copy()
    weights[0] = np.where(mine, start.weights[0], weights[0])
    lost = group.points[~moving[group.points]]
    points[lost], moving[lost] = group.xyz[~moving[group.points]], True
    return problem.checked(replace(state, weights=tuple(weights), points=points, moving=moving))


def _held(problem: BlockProblem) -> BoolArray:
    """Images (M,) of which nothing is free already."""
    return np.array([not each.free.any() for each in problem.unknowns.image_parameters], dtype=np.bool_)


def _common(errors: FloatArray) -> FloatArray | None:
    """Offset (K,) that most of some errors (N, K) share; None where they scatter."""
    offset: FloatArray = np.median(errors, axis=0)
    scatter = float(np.median(np.linalg.norm(errors - offset, axis=1)))
    return offset if scatter < COMMON * float(np.linalg.norm(offset)) else None


def _scattered(problem: BlockProblem, before: BlockState, index: int) -> _Trial:
    """Solution with a group whose standard deviations are so large that its median residual is what chance brings."""
    scale, squares, state = 1.0, np.inf, before
    nothing = [np.zeros(len(weight), dtype=np.bool_) for weight in before.weights]
    for _ in range(ROUNDS):
        trial = _rescaled(problem, index, scale)
        # From the solution under smaller ones: where little holds a block, its first values are hundreds of rounds off.
        solution = solve(trial, state, RULES)
        if not trial.linearise(solution.state).factored.regular:
            break  # it ran away, and says nothing of the group
        state, squares = solution.state, solution.squares
        one = residual_statistics(trial, state, nothing)[index]
        known = one.checked & (state.weights[index] > 0.0)
        if not known.any():
            break
        change = float(np.median(one.statistic[known] / chi2.median(one.freedom[known])))
        scale = max(1.0, scale * float(np.sqrt(change)))
        if abs(change - 1.0) < SETTLED:
            break
    return _Trial(index, squares - _redundancy(problem, before), 0, None, scale)
