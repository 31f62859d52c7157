"""All photos of a block in one least squares adjustment; Wolf & Dewitt, sections 9-8 and 9-9.

The equations (9-3) and (9-4) are linear for conformal and affine transformations. Projective ones are linearised by
Taylor's series, started from the affine solution. What is measured, and errs, are image coordinates, which stand in the
coefficients of the equations: these are taken at the adjusted places, the measurements less their residuals (adjustment
of observations and parameters combined, Mikhail 1976), and the weights at the scale that the photos come to have. So a
linear adjustment too takes some rounds. At their end the sum of squared residuals in the images is least.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from geomosaic.estimation.normal_equations import Normals
from geomosaic.orientation.planar.determinacy import check_determined, check_plausible, ill_conditioned
from geomosaic.orientation.planar.measurements import PlanarBlock
from geomosaic.orientation.planar.observation_equations import (
    Problem,
    frame_of,
    mean_positions,
    views_of,
    weights_of_pairs,
)
from geomosaic.orientation.planar.solution import PlanarSolution, cofactor_blocks, image_residuals, standardised
from geomosaic.orientation.planar.transformations import PlanarTransform
from geomosaic.types import FloatArray

ROUNDS = 40
SETTLED = 1e-9
"""Pixels: rounds end when no measured point moves by more, or none moves less than in the round before."""
WORST_CONDITION = 1e7
"""Of the design. Beyond it half of the digits of a solution are noise."""


def adjust(
    block: PlanarBlock, kind: str, fixed: Mapping[str, PlanarTransform] | None = None, where: str | None = None
) -> PlanarSolution:
    """Adjust all photos together.

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
    solution, start = solve(block, kind, held, where)
    check_plausible(solution, start, where)
    return solution


def solve(
    block: PlanarBlock, kind: str, fixed: Mapping[str, PlanarTransform], where: str | None
) -> tuple[PlanarSolution, PlanarSolution | None]:
    """Adjust without a look at what comes out; and the affine adjustment that a projective one started from."""
    if kind != "projective":
        return _solve(block, kind, fixed, None, where), None
    check_determined(block, kind, fixed, where)
    start = _solve(block, "affine", fixed, None, where)
    return _solve(block, kind, fixed, start, where), start


def _solve(
    block: PlanarBlock,
    kind: str,
    fixed: Mapping[str, PlanarTransform],
    start: PlanarSolution | None,
    where: str | None,
) -> PlanarSolution:
    views = views_of(block)
    check_determined(block, kind, fixed, where)
    problem = Problem(block, kind, views, frame_of(block, fixed), fixed)
    values, at = problem.start.copy(), views.xy
    if start is not None:
        values[~problem.held, :6] = start.values[~problem.held]
    sigma = problem.sigma_ground(values if start is not None else None, at)
    moved = np.inf
    for done in range(1, ROUNDS + 1):
        weights = weights_of_pairs(views, sigma)
        design, gap = problem.design(values, at, weights), problem.misclosure(values, at)
        normals = Normals.of(design)
        condition, worst = normals.condition()
        if not condition < WORST_CONDITION:
            raise ill_conditioned(block, kind, condition, problem.photo_of(worst), where)
        step = normals.solve(-(design.T @ (gap * np.sqrt(weights)[:, None]).ravel()))
        trial = (
            _damped(problem, values, at, step, weights, gap) if kind == "projective" else problem.moved(values, step)
        )
        place = problem.positions(trial, at)
        sigma = problem.sigma_ground(trial, at)
        pixel = sigma[problem.in_photo] / views.sigma[problem.in_photo]
        change = np.abs(place - problem.positions(values, at))[problem.in_photo] / pixel[:, None]
        values, at = trial, problem.adjusted(trial, mean_positions(views, place, sigma))
        if not (np.isfinite(at).all() and np.isfinite(change).all()):
            raise ill_conditioned(block, kind, condition, problem.photo_of(worst), where)
        before, moved = moved, float(change.max())
        if done > 1 and (moved < SETTLED or (moved < 1e3 * SETTLED and moved >= before)):
            break
    else:
        raise ill_conditioned(block, kind, condition, problem.photo_of(worst), where)
    return _finish(problem, values, at, condition, done)


def _damped(
    problem: Problem, values: FloatArray, at: FloatArray, step: FloatArray, weights: FloatArray, gap: FloatArray
) -> FloatArray:
    """Parameters after a step, or as much of it as does not bring the misclosures up.

    Near the solution their sum may rise by a hair: the places at which it is taken are not yet those of the step.
    """
    before, factor = float((weights[:, None] * gap**2).sum()), 1.0
    while factor > 1e-3:
        trial = problem.moved(values, factor * step)
        after = float((weights[:, None] * problem.misclosure(trial, at) ** 2).sum())
        if after <= 1.1 * before + 1e-18:
            return trial
        factor *= 0.5  # also where a point came to lie beyond the horizon and `after` is NaN
    return problem.moved(values, step)


def _finish(problem: Problem, values: FloatArray, at: FloatArray, condition: float, rounds: int) -> PlanarSolution:
    """Cofactors and residuals at the solution."""
    views = problem.views
    sigma = problem.sigma_ground(values, at)
    weights = weights_of_pairs(views, sigma)
    cofactors = cofactor_blocks(problem, Normals.of(problem.design(values, at, weights)))
    points = mean_positions(views, problem.positions(values, at), sigma)
    residuals = image_residuals(problem, values, points)
    redundancy = views.redundancy_of_points - problem.unknowns
    squares = float((weights[:, None] * problem.misclosure(values, at) ** 2).sum())
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
        sigma0=float(np.sqrt(squares / redundancy)) if redundancy > 0 else float("nan"),
        redundancy=redundancy,
        equations=2 * len(views.pairs),
        condition=condition,
        rounds=rounds,
    )
