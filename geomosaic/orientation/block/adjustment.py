"""Adjustment of a block: robust start, rejection of blunders, and the statistics of what came out.

1. A few rounds with weights that fall with the length of a residual (Geman and McClure 1985), over the median length,
   so that a tenth of wrong measurements does not bend the block.
2. Least squares on what agrees, and data snooping (Baarda 1968): of each point the measurement whose residual is least
   probable is left out, as long as one is no chance; left-out measurements that the rest predicts come back.
3. Where the image positions that are left are surely worse than declared, their standard deviations are multiplied by
   what they scatter, a variance component (Helmert 1924), and all of it is done again: camera positions, attitudes,
   control and a-priori values of cameras count then as they should.
4. The same for tie points that are surely better than declared, where anything else holds the block; else their small
   sigma0 would make control better than it is. Blunders stay those of the declared standard deviations.
5. Cofactors of all unknowns from the factorised normal equations, redundancy numbers, variance components of the groups
   (Förstner 1979).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from geomosaic.errors import SolveError, listed
from geomosaic.estimation.network import LEAST_PIVOT, Network
from geomosaic.estimation.solver import Outcome, Solution, Stopping, solve
from geomosaic.estimation.statistics import sigma0_of
from geomosaic.orientation.block.group_blunders import GroupBlunder, search_groups
from geomosaic.orientation.block.image_scatter import HOLDING, first_scatter, image_scatter, of_ties, tie_scatter
from geomosaic.orientation.block.lost_points import lost_points, ray_intersections, recover_points
from geomosaic.orientation.block.observations import GroundControl, ImagePositions, in_units, rescaled
from geomosaic.orientation.block.poses import Attitudes, CameraPositions, PoseGroup
from geomosaic.orientation.block.problem import RULES, BlockProblem, Priors
from geomosaic.orientation.block.residual_statistics import (
    ResidualStatistics,
    residual_statistics,
    search_control,
)
from geomosaic.orientation.block.unknowns import BlockState
from geomosaic.orientation.block.weak_rotation import weak_rotation
from geomosaic.types import BoolArray, FloatArray, IntArray, Progress

# Probability of rejecting a good measurement, for one test.
ALPHA = 1e-4
# Median residual lengths at which an image position has a quarter of its weight in the robust rounds.
ROBUST = 3.0
ROBUST_ROUNDS = 12
# Information of a control point in the robust rounds, over that of its rays; and there the root of the weight of poses,
# heights of the DEM, lakes, planes and distances, over its own: rays lose against what does not give way.
SOFT = 0.1
# Control points seen twice from which on their median distance from where their rays meet says how good they are.
LEAST_JUDGED = 3
# Rounds of rejection at most; each leaves out at most one measurement of a point.
SEARCHES = 25
# Condition of the normalised design beyond which rounding decides.
WORST_CONDITION = 1e8
# Share of the largest movement along an undetermined direction from which on an image moves with it.
MOVING = 0.05
# Median distances from the middle of the points beyond which ground does not go on: of a strip they reach two of them.
DISTANT = 3.0
# Standard deviations, in the median of a group, from which on it is named where a block does not converge.
FAR = 10.0
# Standard deviation of a rotation, in degrees, from which on it is a reason not to converge: equations are linear
# within a few degrees, and errors are two or three standard deviations.
UNCERTAIN = 2.0
# Degrees from which on an attitude is turned over, and no boresight.
OVER = 90.0
# How many times as far off as their median a camera position is that is wrong by itself, where the start is of ties.
ALONE = 10.0
# Rounds of the search for the scatter of image positions at most.
SCALES = 4
# Share of the least log-probability among its images' measurements from which one is rejected in the same round.
SWAMPED = 0.5

# While blunders are searched: what a solution moves then by does not change a test.
SEARCHING_RULES = Stopping(rounds=100, step=1e-3, near=1e-1, gain=1e-5)
# Weights change from round to round, and a smaller median makes all sums larger.
ROBUST_RULES = Stopping(rounds=ROBUST_ROUNDS, step=1e-2, near=1e-1, rise=np.inf)
DAMPED_RULES = replace(ROBUST_RULES, rise=1e-12)


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
    statistics : tuple of ResidualStatistics
        Of each group.
    rejected : tuple of bool array
        Measurements (N,) of each group that were left out as blunders.
    undetermined : bool array (M,)
        Images that too few observations touch: they stay where they were, and take no part.
    image_factors : array (N,)
        Standard deviations of the image positions over those declared.
    wrong_groups : tuple of GroupBlunder
        Groups that contradict the rest as a whole.
    """

    problem: BlockProblem
    state: BlockState
    network: Network
    squares: float
    redundancy: int
    sigma0: float
    rounds: int
    statistics: tuple[ResidualStatistics, ...]
    rejected: tuple[BoolArray, ...]
    undetermined: BoolArray
    image_factors: FloatArray
    wrong_groups: tuple[GroupBlunder, ...] = ()

    @property
    def variance_components(self) -> dict[str, tuple[float, float]]:
        """Factor of the variances of each group (1 where they were right), and the redundancy that it rests on."""
        scatter: dict[int, Any] = {each.index: each.scatter for each in self.wrong_groups}
        scatter[0] = self.image_factors[self.state.weights[0] > 0.0, None]
        found = {}
        for index, (group, one, weight) in enumerate(
            zip(self.problem.groups, self.statistics, self.state.weights, strict=True)
        ):
            part = weight > 0.0
            redundancy = float(np.trace(one.share[part], axis1=1, axis2=2).sum())
            squares = float(((one.residuals[part] * scatter.get(index, 1.0)) ** 2).sum())
            found[group.name] = (squares / redundancy if redundancy > 0.5 else float("nan"), redundancy)
        return found


def adjust_block(
    problem: BlockProblem,
    start: BlockState,
    *,
    robust: bool = True,
    alpha: float | None = ALPHA,
    surveyed: BoolArray | None = None,
    progress: Progress | None = None,
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
    surveyed : bool array (S,), optional
        Points beside control that were measured one by one, such as check points: what tie points scatter says nothing
        of them.
    progress : callable, optional
        Called with (iterations, 0, stage).

    Raises
    ------
    SolveError
        The observations do not determine the unknowns, or there is no convergence.
    """
    rounds, every, declared, scatter, scales = 0, problem, problem.views, 1.0, 0
    weak = np.zeros(len(start.models), dtype=np.bool_)
    problem, state, held = every.with_determined_images(start, weak)
    rejected = [np.zeros(len(weight), dtype=np.bool_) for weight in state.weights]
    if robust and alpha is not None:
        state, rejected, rounds = _robust_start(problem, state)
        scatter = first_scatter(problem, state, rejected)
        every = _scaled(every, declared, scatter)
    looked = np.full(len(start.moving), alpha is None)  # for where the rays of a lost point meet
    wrong: list[GroupBlunder] = []
    tried, seen = alpha is None, set[tuple[float, bytes]]()
    rules = RULES if alpha is None else SEARCHING_RULES
    for left in range(SEARCHES, -1, -1):
        problem, state, start, held = _determined(every, state, start, rejected, weak)
        solution = solve(problem, state, rules if left else RULES)
        if alpha is not None and not tried:
            found_wrong = search_groups(problem, solution, state, start, {each.index for each in wrong}, alpha)
            if found_wrong is not None:
                wrong.append(found_wrong)
                every, start = found_wrong.applied(every, start)
                if found_wrong.offset is None:
                    state = solution.state  # near the next one, and a bent one straightens as less holds it
                continue
            tried = True
        if left and (without := _without_distant(solution, start)) is not None:
            start = without
            continue
        _require_converged(problem, solution, replace(start, weights=state.weights, moving=state.moving))
        state = solution.state
        rounds += solution.rounds
        if progress is not None:
            progress(rounds, 0, "iterations")
        # A point of wrong rays that are nearly parallel has run away: all that is said of it would be rounding.
        if left and len(cast(Network, solution.equations).undetermined_points):
            continue
        if alpha is not None and left and _changed(rejected, search_control(problem, state, alpha)):
            continue
        lost = lost_points(problem, state, start, rejected[0]) & ~looked
        if left and lost.any():
            looked |= lost
            again = recover_points(problem, state, lost, rejected, held)
            if again is not None:
                state, rejected = again
                continue
        statistics = residual_statistics(problem, state, rejected)
        if alpha is None or not left:
            break
        before = [each.copy() for each in rejected]
        if _searched(problem, state, rejected, statistics, alpha):
            if (now := _key(scatter, rejected)) not in seen:
                seen.add(now)
                continue
            # What leaves and comes back in turn would do so to the last round.
            rejected = before
        found_scatter = image_scatter(statistics[0], state.weights[0], scatter) if scales < SCALES else scatter
        if found_scatter == scatter and rules is RULES:
            break
        rules = RULES if found_scatter == scatter else SEARCHING_RULES
        scales += found_scatter != scatter
        scatter = found_scatter
        every = _scaled(every, declared, scatter)
    factors = np.full(len(declared), scatter)
    ties = of_ties(problem, surveyed)
    for _ in range(SEARCHES if scatter == 1.0 else 0):
        if alpha is None:
            break
        tighter = tie_scatter(problem, state, statistics[0], ties, float(factors[ties].min(initial=1.0)))
        if tighter is not None:
            factors = np.where(ties, tighter, 1.0)
            every = _scaled(every, declared, factors)
        # What is small beside the declared standard deviations is a blunder beside those that ties turn out to have.
        elif (factors == 1.0).all() or not _searched(problem, state, rejected, statistics, alpha, ties):
            break
        problem, state, start, held = _determined(every, state, start, rejected, weak)
        solution = solve(problem, state, RULES)
        while (without := _without_distant(solution, start)) is not None:
            problem, state, start, held = _determined(every, state, without, rejected, weak)
            solution = solve(problem, state, RULES)
        _require_converged(problem, solution, replace(start, weights=state.weights, moving=state.moving))
        state = solution.state
        rounds += solution.rounds
        statistics = residual_statistics(problem, state, rejected)
    if held.any():
        # Robust rounds may have taken them anywhere before too little was left of what was measured in them.
        pairs = zip(state.models, start.models, held.tolist(), strict=True)
        models = tuple(now.with_values(first.parameters.values) if out else now for now, first, out in pairs)
        state = replace(state, models=models)
    network = problem.linearise(state)
    redundancy = _redundancy(problem, state, network)
    if scatter > 1.0:
        used = state.weights[0] > 0.0
        more = (scatter**2 - 1.0) * float((statistics[0].residuals[used] ** 2).sum())
        wrong.append(
            GroupBlunder(0, int(used.sum()), None, scatter, (), sigma0_of(solution.squares + more, redundancy))
        )
    for each in wrong:
        if each.offset is not None:
            rejected[each.index][:] = True
    return BlockAdjustment(
        problem, state, network, solution.squares, redundancy, sigma0_of(solution.squares, redundancy), rounds,
        tuple(statistics), tuple(rejected), held, factors, tuple(wrong),
    )  # fmt: skip


def _robust_start(problem: BlockProblem, state: BlockState) -> tuple[BlockState, list[BoolArray], int]:
    """State after rounds of weights that fall with the residuals, what it rejects of each group, and the rounds."""
    met = _where_rays_meet(problem, state)
    softened = replace(_softened(problem, state, met), robust=ROBUST)
    # Rays to copies of a repeated texture would throw a good start away in the first round, at full weight. Where
    # wrong control put a point, its rays are judged by where they meet.
    starts = (state, softened.after_inner_iterations(state), met)
    judged = [softened.refreshed(each).weights for each in starts]
    weights = tuple(np.maximum.reduce(each) for each in zip(*judged, strict=True))
    turned = _contradicted(problem, state)
    weights = tuple(np.where(out, 0.0, weight) for out, weight in zip(turned, weights, strict=True))
    found = solve(softened, replace(state, weights=weights), ROBUST_RULES)
    rounds = found.rounds
    if not _median_length(problem, found.state) <= _median_length(problem, state):
        # Where little holds a block, over flat control, an undamped step may throw it away.
        found = solve(softened, replace(state, weights=weights), DAMPED_RULES)
        rounds += found.rounds
    # Image positions, and points of lakes and planes, whose weight fell below a twenty-fifth.
    weights = found.state.weights
    rejected = [(weight > 0.0) & (weight < 0.04) | far for weight, far in zip(weights, turned, strict=True)]
    rejected[0] &= ~_rays_of_lost_control(problem, state, rejected[0])
    return found.state, rejected, rounds


def _redundancy(problem: BlockProblem, state: BlockState, network: Network) -> int:
    """Redundancy of what takes part and was observed."""
    pairs = zip(problem.groups, state.weights, strict=True)
    return network.redundancy - sum(int((~group.observed[weight > 0.0]).sum()) for group, weight in pairs)


def _scaled(problem: BlockProblem, declared: ImagePositions, factor: float | FloatArray) -> BlockProblem:
    """Problem with the standard deviations of the image positions a factor, or factors (N,), times those declared."""
    views = declared if np.all(factor == 1.0) else rescaled(declared, factor)
    return replace(problem, groups=(views, *problem.groups[1:]))


def _median_length(problem: BlockProblem, state: BlockState) -> float:
    """Median whitened length of what the image positions that count are off."""
    length = np.linalg.norm(problem.views.misclosure(state, problem.frame)[state.weights[0] > 0.0], axis=1)
    return float(np.median(length)) if len(length) else 0.0


def _key(scatter: float, rejected: Sequence[BoolArray]) -> tuple[float, bytes]:
    """Value that is equal where scatter and rejected measurements are."""
    return scatter, b"".join(np.packbits(each).tobytes() for each in rejected)


def _changed(rejected: list[BoolArray], found: Mapping[int, BoolArray]) -> bool:
    """Whether the rejected control is another now; `rejected` follows."""
    changed = False
    for index, wrong in found.items():
        changed |= bool((wrong != rejected[index]).any())
        rejected[index] = wrong
    return changed


def _softened(problem: BlockProblem, state: BlockState, met: BlockState) -> BlockProblem:
    """Problem whose control counts no more than a tenth of the rays to its points, poses and the DEM little.

    Nor does control count more than its distance from where its rays meet bears out, in the state `met`.
    """
    # Exact control would hold a point where it is not, and all its rays would seem wrong, one by one.
    views = problem.views
    rays = views.linearised(state, problem.unknowns, problem.frame)
    by = views.by_coordinates(rays, problem.unknowns)
    # Points that nothing places lie at the origin, where a camera may be: their rays count for nothing.
    normal, seen = np.zeros((len(state.points), 3, 3)), state.weights[0] > 0.0
    np.add.at(normal, views.points[seen], np.swapaxes(by[seen], 1, 2) @ by[seen])
    # Along the direction that the rays know least, mostly height; single rays know nothing of it.
    values = np.linalg.eigvalsh(normal)
    known = np.maximum(values[:, 0], 1e-6 * values[:, 2])
    alone = all(isinstance(group, ImagePositions | GroundControl | Priors) for group in problem.groups)
    groups = []
    for group in problem.groups:
        if isinstance(group, GroundControl):
            own = (group.root**2).sum(axis=(1, 2)) / 3.0
            by_rays = known[group.points]
            # Points without any ray stay where they are given: nothing else would place them.
            share = np.where(by_rays > 0.0, np.minimum(1.0, np.sqrt(SOFT * by_rays / np.maximum(own, 1e-300))), 1.0)
            # Control that is metres off would bend the camera; beside other groups either may be what is wrong.
            moved = (met.points[group.points] != state.points[group.points]).any(axis=1)
            apart = np.linalg.norm(group.misclosure(met, problem.frame)[moved], axis=1)
            worse = max(1.0, float(np.median(apart))) if alone and len(apart) >= LEAST_JUDGED else 1.0
            group = rescaled(group, np.maximum(1.0 / share, worse))
        elif isinstance(group, HOLDING):
            group = rescaled(group, 1.0 / SOFT)
        groups.append(group)
    return replace(problem, groups=tuple(groups))


def _where_rays_meet(problem: BlockProblem, state: BlockState) -> BlockState:
    """State in which control points that are seen twice lie where their rays meet."""
    pairs = list(zip(problem.groups, state.weights, strict=True))
    of_control: list[IntArray] = [group.points for group, _ in pairs if isinstance(group, GroundControl)]
    known = np.isin(np.arange(len(state.moving)), np.concatenate([np.zeros(0, np.int64), *of_control]))
    rays = np.bincount(problem.views.points[state.weights[0] > 0.0], minlength=len(known))
    known &= state.moving & (rays > 1)
    known[problem.unknowns.kept] = False
    if not known.any():
        return state
    weights = tuple(np.zeros_like(w) if isinstance(group, GroundControl) else w for group, w in pairs)
    nearest = problem.after_inner_iterations(replace(state, weights=weights)).points
    # Of three rays a wrong one would draw the point away from the others.
    met = ray_intersections(problem, state, known)
    met = np.where(np.isfinite(met), met, nearest)
    return replace(state, points=np.where(known[:, None], met, state.points))


def _without(
    problem: BlockProblem, state: BlockState, start: BlockState, rejected: Sequence[BoolArray], weak: BoolArray
) -> tuple[BlockProblem, BlockState, BoolArray]:
    """Present values with all observations that can be computed, but those rejected, and those of `weak` images."""
    weights = tuple(np.where(out, 0.0, first) for out, first in zip(rejected, start.weights, strict=True))
    return problem.with_determined_images(replace(state, weights=weights, moving=start.moving), weak)


def _determined(
    every: BlockProblem, state: BlockState, start: BlockState, rejected: Sequence[BoolArray], weak: BoolArray
) -> tuple[BlockProblem, BlockState, BlockState, BoolArray]:
    """What `_without` gives, with the start, less points and images along whose change nothing is determined."""
    while True:
        problem, state, held = _without(every, state, start, rejected, weak)
        network = problem.linearise(state)
        if network.least_pivot >= LEAST_PIVOT:
            return problem, state, start, held
        # Parallel rays: the images can be determined all the same.
        if len(points := network.undetermined_points):
            moving = start.moving.copy()
            moving[points] = False
            start = replace(start, moving=moving)
            continue
        lost = _undetermined(problem, state, network, held)
        if not lost.any():
            return problem, state, start, held
        weak |= lost


def _without_distant(solution: Solution[BlockState], start: BlockState) -> BlockState | None:
    """Start without points far from all others, where a solution does not converge; None where it does, or has none.

    Two wrong rays that diverge have their best place at no distance: it is approached in hundreds of rounds.
    """
    if solution.outcome is Outcome.CONVERGED:
        return None
    points, moving = solution.state.points, solution.state.moving
    length = np.linalg.norm(points - np.median(points[moving], axis=0), axis=1)
    distant = moving & ~(length <= DISTANT * float(np.median(length[moving])))
    return replace(start, moving=start.moving & ~distant) if distant.any() else None


def _undetermined(problem: BlockProblem, state: BlockState, network: Network, held: BoolArray) -> BoolArray:
    """Images (M,) that move along a direction which nothing determines.

    Raises
    ------
    SolveError
        More than half of the images do: the block as a whole hangs on nothing.
    """
    # It costs a hundred solutions, and is asked for where a pivot is rounding.
    condition, direction = network.condition()
    if condition < WORST_CONDITION:
        return np.zeros(len(held), dtype=np.bool_)
    unknowns, size = problem.unknowns, np.abs(direction[: network.parameters])
    moved = np.zeros(len(held))
    for image in np.flatnonzero(~held).tolist():
        columns = unknowns.of_image(image)[: len(unknowns.image_parameters[image].names)]
        moved[image] = size[columns[columns >= 0]].max(initial=0.0)
    lost = moved > MOVING * max(float(moved.max(initial=0.0)), float(size.max(initial=0.0)))
    if not lost.any() or lost.sum() > max(2, (~held).sum() // 2):
        names = [name for name, one in zip(unknowns.images, lost, strict=True) if one]
        if (weak := weak_rotation(problem, state)) is not None and weak.roll:
            raise SolveError(
                f"the observations do not determine the block: {weak.text(unknowns.images)}", hint=weak.hint
            )
        raise SolveError(
            "the observations do not determine the block: "
            + (
                f"nothing holds {listed(names, 6)} in place" if names else "it leaves parameters open that images share"
            ),
            hint="give control points that are not on one line, camera positions, or a-priori sigmas; and check that "
            "common points join the images",
        )
    return lost


def _rays_of_lost_control(problem: BlockProblem, state: BlockState, rejected: BoolArray) -> BoolArray:
    """Image positions (N,) of control points that are seen twice and of which robust rounds left none."""
    # Control hundreds of pixels off does not give way there, and its rays do: whatever is wrong is judged afterwards.
    points, size, used = problem.views.points, len(state.moving), state.weights[0] > 0.0
    seen = np.bincount(points[used], minlength=size)
    left = np.bincount(points[used & ~rejected], minlength=size)
    known = np.zeros(size, dtype=np.bool_)
    for group in problem.groups:
        if isinstance(group, GroundControl):
            known[group.points] = True
    return np.asarray((known & (seen > 1) & (left == 0))[points] & used)


def _contradicted(problem: BlockProblem, state: BlockState) -> list[BoolArray]:
    """Attitudes and camera positions (N,) that tie points contradict from the start: nothing leads back from there."""
    # A gimbal that looks straight down tells the yaw of either side, half a turn off; a position that is off by more
    # than the photos are high turns its photo over. They come back where the rest predicts them.
    found = []
    for group, left, weight in zip(problem.groups, problem.misclosures(state), state.weights, strict=True):
        out = np.zeros(len(weight), dtype=np.bool_)
        if isinstance(group, Attitudes | CameraPositions) and len(weight):
            length = np.linalg.norm(np.nan_to_num(left), axis=1)
            if isinstance(group, Attitudes):
                out = (length > FAR) & (np.linalg.norm(np.nan_to_num(in_units(group, left)), axis=1) > OVER)
            else:
                out = length > max(FAR, ALONE * float(np.median(length)))
        found.append(out)
    return found


def _require_converged(problem: BlockProblem, solution: Solution[BlockState], first: BlockState) -> None:
    """Check of a solution, begun from `first` or thereabouts, where the message is looked for: it has not run away."""
    if solution.outcome is Outcome.CONVERGED:
        return
    off = dict[str, float]()
    for group, left, weight in zip(
        problem.groups, problem.misclosures(solution.state), solution.state.weights, strict=True
    ):
        if (weight > 0.0).any():
            off[group.name] = float(np.median(np.linalg.norm(left[weight > 0.0], axis=1)))
    far = sorted((name for name, size in off.items() if size > FAR), key=lambda name: -off[name])
    listing = listed((f"{name} by {off[name]:.2g}" for name in far), 4)
    weak = weak_rotation(problem, first)
    if weak is not None and weak.sigma > UNCERTAIN:
        raise SolveError(
            f"the block adjustment does not converge ({solution.rounds} rounds): {weak.text(problem.unknowns.images)}",
            hint=weak.hint,
        )
    raise SolveError(
        f"the block adjustment does not converge ({solution.rounds} rounds)"
        + (f"; off in the median, in standard deviations: {listing}" if far else ""),
        hint="check the start values, the CRS of the control points and the units of sigmas"
        + (f"; try without {far[0]}" if far and far[0] != problem.views.name else ""),
    )


def _searched(
    problem: BlockProblem,
    state: BlockState,
    rejected: list[BoolArray],
    statistics: Sequence[ResidualStatistics],
    alpha: float,
    alone: BoolArray | None = None,
) -> bool:
    """One round of the search for blunders, which changes `rejected` in place; False where nothing is left to do.

    Where `alone` (N,) names image positions, no other measurement is left out or taken back.
    """
    limit, size = float(np.log(alpha)), len(state.points)
    of_points = {i: g.row_points for i, g in enumerate(problem.groups) if not isinstance(g, GroundControl)}
    searched = {index: pairs for index, pairs in of_points.items() if len(pairs[0])}
    # The least probable of each point among all groups but control, and of each image.
    worst_points, worst_images, tested = np.zeros(size), np.zeros(len(state.models)), {}
    posed = {i: g.row_images for i, g in enumerate(problem.groups) if isinstance(g, PoseGroup)}
    for index in (*searched, *posed):
        usable = statistics[index].checked & (state.weights[index] > 0.0)
        if alone is not None:
            usable &= alone if index == 0 else False
        tested[index] = np.where(usable, statistics[index].log_probability, 0.0)
    for index, (row, point) in searched.items():
        np.minimum.at(worst_points, point, tested[index][row])
    views, rays = problem.views, state.weights[0] > 0.0
    np.minimum.at(worst_images, views.image[rays], worst_points[views.points[rays]])
    for index, (row, image) in posed.items():
        np.minimum.at(worst_images, image, tested[index][row])
    # An error shows in its neighbours, too, as long as it takes part: those are left for the next round.
    around = np.zeros(size)
    np.minimum.at(around, views.points[rays], worst_images[views.image[rays]])
    near = worst_images.copy()
    np.minimum.at(near, views.image[rays], around[views.points[rays]])
    changed, quiet = False, np.ones(size, dtype=np.bool_)
    for index, pairs in posed.items():
        worst = (tested[index] < limit) & _least(tested[index], np.minimum(worst_images, SWAMPED * near), pairs)
        rejected[index] |= worst
        changed |= bool(worst.any())
    for index, pairs in searched.items():
        worst = (tested[index] < limit) & _least(tested[index], np.minimum(worst_points, SWAMPED * around), pairs)
        worst = _one_of_each_point(worst, pairs, statistics[index].residuals, size)
        rejected[index] |= worst
        quiet[pairs[1][worst[pairs[0]]]] = False
        changed |= bool(worst.any())
    # Points are judged one by one: what comes back to one need not wait for what leaves another.
    settled, judged = not changed and alone is None, quiet[views.points] & (True if alone is None else alone)
    for index in (*searched, *posed):
        back = rejected[index] & statistics[index].predicted & (statistics[index].log_probability > limit)
        back &= judged if index == 0 else settled
        rejected[index] &= ~back
        changed |= bool(back.any())
    return changed


def _least(tested: FloatArray, bounds: FloatArray, pairs: tuple[IntArray, IntArray]) -> BoolArray:
    """Observations (N,) that are as improbable as the bounds of all their points, or of all their images."""
    row, own = pairs
    least = np.zeros(len(tested))
    np.minimum.at(least, row, bounds[own])
    return np.asarray(tested <= least)


def _one_of_each_point(worst: BoolArray, pairs: tuple[IntArray, IntArray], left: FloatArray, size: int) -> BoolArray:
    """Of several observations of one point, the one with the longest whitened residual."""
    row, point = pairs
    length = np.where(worst, np.nan_to_num((left**2).sum(axis=1), nan=np.inf), -1.0)
    longest = np.full(size, -1.0)
    np.maximum.at(longest, point, length[row])
    shorter = length[row] < longest[point]
    found = worst.copy()
    found[row[shorter]] = False
    return found
