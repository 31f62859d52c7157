"""Scatter of image positions over their declared standard deviations: their variance component (Helmert 1924).

In the approximation of Förstner (1979): vᵀPv of the group over its share of the redundancy, again until it stands.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from geomosaic.errors import SolveError
from geomosaic.estimation.network import LEAST_PIVOT
from geomosaic.estimation.solver import Outcome, solve
from geomosaic.estimation.statistics import median_variance
from geomosaic.orientation.block.object_constraints import CommonHeights, Distances, OnSurfaces
from geomosaic.orientation.block.observations import GroundControl, SurfaceHeights, rescaled
from geomosaic.orientation.block.poses import Attitudes, CameraPositions, RelativePoses
from geomosaic.orientation.block.problem import RULES, BlockProblem
from geomosaic.orientation.block.residual_statistics import ResidualStatistics, residual_statistics, unit_variance
from geomosaic.orientation.block.unknowns import BlockState
from geomosaic.types import BoolArray, FloatArray

# Probability below which a scatter is no chance, and the change of a factor that ends the search for it.
SURE, SETTLED = 1e-4, 0.02
# Redundancy of tie points from which on a factor below 1 is known to a tenth, the least factor, and the share by which
# it must differ from 1 to matter.
WELL_KNOWN, LEAST_SCATTER, BETTER = 50.0, 0.1, 0.95
# Groups other than control that hold a block in place.
HOLDING = CameraPositions | Attitudes | RelativePoses | SurfaceHeights | CommonHeights | OnSurfaces | Distances
# Factors of the standard deviations of all these, and of control, where image positions are judged by themselves: the
# first that rounding bears, as a place good to 50 m leaves photos of millimetres without a digit; and the variance of
# unit weight below which they need not be: standard deviations that are a twentieth too small harm no control.
LOOSE, WORSE = (100.0, 10.0, 1.0), 1.1


def first_scatter(problem: BlockProblem, state: BlockState, rejected: Sequence[BoolArray]) -> float:
    """Factor by which image positions scatter more than declared, where nothing else holds the block tightly.

    Parameters
    ----------
    problem : BlockProblem
    state : BlockState
        After the robust rounds.
    rejected : sequence of bool array
        Measurements (N,) of each group that are left out.
    """
    # Before control and camera positions are judged: rays that pretend to be better than they are find all of these
    # wrong, in turn.
    weights = tuple(
        np.where(out | (weight == 0.0), 0.0, 1.0) for out, weight in zip(rejected, state.weights, strict=True)
    )
    state = replace(state, weights=weights)
    # Their scatter about points that follow them is enough to see that they are not, at a tenth of the cost.
    if _scatter_about_points(problem, problem.after_inner_iterations(state)) <= WORSE:
        return 1.0
    for factor in LOOSE:
        one = _loosened_statistics(problem, state, factor)
        if one is not None:
            return float(np.sqrt(unit_variance(one)))
    return 1.0


def _scatter_about_points(problem: BlockProblem, state: BlockState) -> float:
    """Variance of unit weight of image positions after the median of their points' sums of squares."""
    points, used = problem.views.points, state.weights[0] > 0.0
    squares = (problem.views.misclosure(state, problem.frame)[used] ** 2).sum(axis=1)
    freedom = 2 * np.bincount(points[used], minlength=len(state.moving)) - 3 * state.moving
    seen = freedom > 0
    if not seen.any():
        return 0.0
    # What images take up of it.
    share = 1.0 - problem.unknowns.count / float(freedom[seen].sum())
    sums: FloatArray = np.bincount(points[used], squares, len(state.moving)).astype(np.float64)
    return median_variance(sums[seen], freedom[seen]) / share if share > 0.0 else 0.0


def _loosened_statistics(problem: BlockProblem, state: BlockState, factor: float) -> ResidualStatistics | None:
    """Statistics of the image positions where all that holds the block has larger standard deviations.

    None where that does not determine it.
    """
    groups = [rescaled(g, factor) if isinstance(g, HOLDING | GroundControl) else g for g in problem.groups]
    nothing = np.zeros(len(state.models), dtype=np.bool_)
    try:
        loose, state, _ = replace(problem, groups=tuple(groups)).with_determined_images(state, nothing)
        if loose.linearise(state).least_pivot < LEAST_PIVOT:
            return None
        found = solve(loose, state, RULES)
    except SolveError:  # what does not determine the block is told where it is adjusted
        return None
    network = loose.linearise(found.state)
    if found.outcome is not Outcome.CONVERGED or network.least_pivot < LEAST_PIVOT:
        return None
    return residual_statistics(loose, found.state, [np.zeros(len(w), dtype=np.bool_) for w in state.weights])[0]


def image_scatter(one: ResidualStatistics, weight: FloatArray, scatter: float) -> float:
    """Scatter of image positions that are worse than declared, over what was declared; 1 where it may be chance.

    Parameters
    ----------
    one : ResidualStatistics
        Of the image positions, under `scatter`.
    weight : array (N,)
    scatter : float
    """
    part = weight > 0.0
    redundancy = float(np.trace(one.share[part], axis1=1, axis2=2).sum())
    squares = float((one.residuals[part] ** 2).sum())
    # The median is that of most measurements, and the sum keeps chance in a small block from passing for more.
    chance = redundancy < 1.0 or chi2.logsf(squares * scatter**2, redundancy) > np.log(SURE)
    if chance or unit_variance(replace(one, statistic=one.statistic * scatter**2)) == 1.0:
        return 1.0
    factor = float(np.sqrt(squares / redundancy))
    return scatter if abs(factor - 1.0) < SETTLED else max(1.0, scatter * factor)


def of_ties(problem: BlockProblem, surveyed: BoolArray | None) -> BoolArray:
    """Image positions (N,) of points that nobody has surveyed.

    Parameters
    ----------
    problem : BlockProblem
    surveyed : bool array (S,), optional
        Points beside control.
    """
    points = problem.views.points
    known = np.zeros(len(points), dtype=np.bool_) if surveyed is None else surveyed[points]
    for group in problem.groups:
        if isinstance(group, GroundControl):
            known = known | np.isin(points, group.points)
    return ~known


def tie_scatter(
    problem: BlockProblem, state: BlockState, one: ResidualStatistics, ties: BoolArray, factor: float
) -> float | None:
    """Scatter of tie points that are better than declared, over what was declared; None where it is settled, or 1.

    Of a block that nothing else holds, sigma0 alone says how good the image positions are.

    Parameters
    ----------
    problem : BlockProblem
    state : BlockState
    one : ResidualStatistics
        Of the image positions, under `factor`.
    ties : bool array (N,)
    factor : float
    """
    if problem.free is not None or not any((weight > 0.0).any() for weight in state.weights[1:]):
        return None
    part = ties & (state.weights[0] > 0.0)
    redundancy = float(np.trace(one.share[part], axis1=1, axis2=2).sum())
    squares = float((one.residuals[part] ** 2).sum()) * factor**2
    if redundancy < WELL_KNOWN or chi2.logcdf(squares, redundancy) > np.log(SURE):
        return None
    found = max(LEAST_SCATTER, float(np.sqrt(squares / redundancy)))
    return None if found > BETTER or abs(found / factor - 1.0) < SETTLED else found
