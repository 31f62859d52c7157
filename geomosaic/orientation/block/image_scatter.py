"""Scatter of image positions over their declared standard deviations: their variance component (Helmert 1924).

In the approximation of Förstner (1979): vᵀPv of the group over its share of the redundancy, again until it stands.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from geomosaic.orientation.block.observations import GroundControl
from geomosaic.orientation.block.problem import BlockProblem
from geomosaic.orientation.block.residual_statistics import ResidualStatistics, unit_variance
from geomosaic.orientation.block.unknowns import BlockState
from geomosaic.types import BoolArray, FloatArray

# Probability below which a scatter is no chance, and the change of a factor that ends the search for it.
SURE, SETTLED = 1e-4, 0.02
# Redundancy of tie points from which on a factor below 1 is known to a tenth, the least factor, and the share by which
# it must differ from 1 to matter.
WELL_KNOWN, LEAST_SCATTER, BETTER = 50.0, 0.1, 0.95


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
