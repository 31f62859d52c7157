"""Simultaneous least squares adjustment of all photos of a block; Wolf & Dewitt, sections 9-8 and 9-9.

The equations (9-3) and (9-4) are linear for conformal and affine transformations. Projective ones are linearised by
Taylor's series, started from the affine solution. What is measured, and errs, are image coordinates, which stand in the
coefficients of the equations: these are taken at the adjusted places, the measurements less their residuals (adjustment
of observations and parameters combined, Mikhail 1976), and the weights at the scale that the photos come to have. So a
linear adjustment too takes some rounds. At their end the sum of squared residuals in the images is least.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.estimation.equations import Equations
from geomosaic.estimation.problem import Problem
from geomosaic.estimation.solver import Outcome, Solution, Stopping, solve
from geomosaic.estimation.statistics import sigma0_of
from geomosaic.orientation.planar.determinacy import check_determined, check_plausible, ill_conditioned
from geomosaic.orientation.planar.measurements import PlanarBlock
from geomosaic.orientation.planar.observation_equations import (
    PlanarProblem,
    frame_of,
    mean_positions,
    views_of,
    weights_of_pairs,
)
from geomosaic.orientation.planar.solution import PlanarSolution, cofactor_blocks, image_residuals, standardised
from geomosaic.orientation.planar.transformations import PlanarTransform
from geomosaic.types import FloatArray

RULES = Stopping(rounds=40, step=1e-9, near=1e-6, gain=None, rise=0.1)
"""Movements are those of measured points, pixels. Near the solution the sum of squares may rise by a hair from round to
round: the places at which it is taken are not yet those of the step."""
WORST_CONDITION = 1e7
"""Of the design. Beyond it half of the digits of a solution are noise."""


def adjust(
    block: PlanarBlock, kind: str, fixed: Mapping[str, PlanarTransform] | None = None, where: str | None = None
) -> PlanarSolution:
    """Simultaneous adjustment of all photos of a block.

    Parameters
    ----------
    block : PlanarBlock
    kind : str
        'conformal', 'affine' or 'projective'.
    fixed : mapping of str to PlanarTransform, optional
        Photos whose place is given and held; they take the part of control. What a kind of fewer parameters cannot
        say of them is dropped.
    where : str, optional
        Named in errors.

    Returns
    -------
    PlanarSolution

    Raises
    ------
    SolveError
        Too few points or control, a block in pieces, points on a line; or, with projective transformations, an
        ill-conditioned or divergent solution, as strong relief causes it.
    """
    held = {name: transform for name, transform in (fixed or {}).items() if name in block.index}
    solution, start = adjust_unchecked(block, kind, held, where)
    check_plausible(solution, start, where)
    return solution


def adjust_unchecked(
    block: PlanarBlock, kind: str, fixed: Mapping[str, PlanarTransform], where: str | None
) -> tuple[PlanarSolution, PlanarSolution | None]:
    """Simultaneous adjustment, unchecked, and the affine one that a projective one started from.

    Parameters
    ----------
    block : PlanarBlock
    kind : str
        'conformal', 'affine' or 'projective'.
    fixed : mapping of str to PlanarTransform
        Photos that are held, by name.
    where : str, optional
        Named in errors.
    """
    if kind != "projective":
        return _solve(block, kind, fixed, None, where), None
    check_determined(block, kind, fixed, where)
    # Projective equations are not linear: from the affine solution, which needs no start, they converge.
    start = _solve(block, "affine", fixed, None, where)
    return _solve(block, kind, fixed, start, where), start


def _solve(
    block: PlanarBlock,
    kind: str,
    fixed: Mapping[str, PlanarTransform],
    start: PlanarSolution | None,
    where: str | None,
) -> PlanarSolution:
    check_determined(block, kind, fixed, where)
    problem = PlanarProblem(block, kind, views_of(block), frame_of(block, fixed), fixed)
    values = problem.start.copy()
    if start is not None:
        values[~problem.held, :6] = start.values[~problem.held]
    adjustment = _Adjustment(problem, where)
    first = _State(values, problem.views.xy, problem.sigma_ground(None if start is None else values, problem.views.xy))
    solution = solve(adjustment, first, RULES)
    if solution.outcome is not Outcome.CONVERGED:
        raise adjustment.ill_conditioned(solution.state)
    return _finish(adjustment, solution)


@dataclass(frozen=True, eq=False)
class _State:
    """Parameters (K, P), places (N, 2) of linearisation in the photos, standard deviations (N,) on the ground."""

    values: FloatArray
    at: FloatArray
    sigma: FloatArray


@dataclass(frozen=True, eq=False)
class _Adjustment(Problem[_State]):
    """The equations of pairs, whose places and weights are taken anew after each step."""

    block: PlanarProblem
    where: str | None

    def linearise(self, state: _State) -> Equations:
        equations = self.equations(state)
        if not equations.condition()[0] < WORST_CONDITION:
            raise self.ill_conditioned(state, equations)
        return equations

    def equations(self, state: _State) -> Equations:
        weights = weights_of_pairs(self.block.views, state.sigma)
        gap = self.block.misclosure(state.values, state.at)
        design = self.block.design(state.values, state.at, weights)
        return Equations(design, -(gap * np.sqrt(weights)[:, None]).ravel())

    def squares(self, state: _State) -> float:
        weights = weights_of_pairs(self.block.views, state.sigma)
        return float((weights[:, None] * self.block.misclosure(state.values, state.at) ** 2).sum())

    def moved(self, state: _State, step: FloatArray) -> _State:
        return replace(state, values=self.block.moved(state.values, step))

    def movement(self, state: _State, trial: _State, equations: Equations, step: FloatArray) -> float:
        """Largest shift of a measured point on the ground, in pixels of its photo."""
        inside, at = self.block.in_photo, state.at
        pixel = self.block.sigma_ground(trial.values, at)[inside] / self.block.views.sigma[inside]
        change = np.abs(self.block.positions(trial.values, at) - self.block.positions(state.values, at))[inside]
        return float((change / pixel[:, None]).max())

    def refreshed(self, state: _State) -> _State:
        """Weights at the scale the photos have now, and places at the measurements less their residuals."""
        sigma = self.block.sigma_ground(state.values, state.at)
        points = mean_positions(self.block.views, self.block.positions(state.values, state.at), sigma)
        at = self.block.adjusted(state.values, points)
        if not np.isfinite(at).all():
            raise self.ill_conditioned(state)
        return _State(state.values, at, sigma)

    def ill_conditioned(self, state: _State, equations: Equations | None = None) -> SolveError:
        """Error that names the photo determined worst."""
        condition, worst = (equations or self.equations(state)).condition()
        return ill_conditioned(self.block.block, self.block.kind, condition, self.block.photo_of(worst), self.where)


def _finish(adjustment: _Adjustment, solution: Solution[_State]) -> PlanarSolution:
    """Cofactors and residuals at the solution."""
    problem, values, at = adjustment.block, solution.state.values, solution.state.at
    views = problem.views
    sigma = problem.sigma_ground(values, at)
    final = _State(values, at, sigma)
    # At the final places and weights: those of the last round are one step old.
    equations, squares = adjustment.equations(final), adjustment.squares(final)
    cofactors = cofactor_blocks(problem, equations.normals)
    points = mean_positions(views, problem.positions(values, at), sigma)
    residuals = image_residuals(problem, values, points)
    redundancy = views.redundancy_of_points - problem.unknowns
    return PlanarSolution(
        block=problem.block,
        kind=problem.kind,
        frame=problem.frame,
        values=values,
        cofactors=cofactors,
        views=views,
        points=problem.frame.map(points),
        residuals=residuals,
        standardised=standardised(problem, values, at, sigma, cofactors, residuals),
        sigma0=sigma0_of(squares, redundancy),
        redundancy=redundancy,
        equations=2 * len(views.pairs),
        condition=equations.condition()[0],
        rounds=solution.rounds,
    )
