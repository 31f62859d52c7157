"""All photos of a block in one least squares adjustment; Wolf & Dewitt, sections 9-8 and 9-9.

The equations (9-3) and (9-4) are linear for conformal and affine transformations. Projective ones are linearised by
Taylor's series, started from the affine solution. The weights hang on the scale of the photos, which the solution
gives, so a linear adjustment too is repeated until they settle.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from geomosaic.adjust.planar.check import check_determined, check_plausible, ill_conditioned
from geomosaic.adjust.planar.equations import mean_positions, views_of, weights_of_pairs
from geomosaic.adjust.planar.normals import Normals
from geomosaic.adjust.planar.problem import Problem, frame_of
from geomosaic.adjust.planar.residuals import cofactor_blocks, image_residuals, standardised
from geomosaic.adjust.planar.solution import PlanarSolution
from geomosaic.adjust.planar.transform import PlanarTransform
from geomosaic.adjust.planar.values import PlanarBlock
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
    fixed = {name: transform for name, transform in (fixed or {}).items() if name in block.index}
    views = views_of(block)
    check_determined(block, kind, fixed, where)
    problem = Problem(block, kind, views, frame_of(block, fixed), fixed)
    values = problem.start.copy()
    if kind == "projective" and problem.unknowns:
        free = ~problem.held
        values[free, :6] = adjust(block, "affine", fixed, where).values[free]
    weights = weights_of_pairs(views, problem.sigma_ground(values if kind == "projective" else None))
    moved = np.inf
    for done in range(1, ROUNDS + 1):
        design, gap = problem.design(values, weights), problem.misclosure(values)
        normals = Normals.of(design)
        condition, worst = normals.condition()
        if not condition < WORST_CONDITION:
            raise ill_conditioned(block, kind, condition, problem.photo_of(worst), where)
        step = normals.solve(-(design.T @ (gap * np.sqrt(weights)[:, None]).ravel()))
        trial = problem.moved(values, step)
        if kind == "projective":
            trial = _damped(problem, values, step, weights, gap)
        change = problem.positions(trial) - problem.positions(values)
        values, sigma = trial, problem.sigma_ground(trial)
        weights = weights_of_pairs(views, sigma)
        if not np.isfinite(change).all():
            raise ill_conditioned(block, kind, condition, problem.photo_of(worst), where)
        inside = problem.in_photo
        pixel = sigma[inside] / views.sigma[inside]
        before, moved = moved, float((np.abs(change[inside]) / pixel[:, None]).max())
        if done > 1 and (moved < SETTLED or (moved < 1e3 * SETTLED and moved >= before)):
            break
    else:
        raise ill_conditioned(block, kind, condition, problem.photo_of(worst), where)
    return _finish(problem, values, weights, sigma, condition, done, where)


def _damped(problem: Problem, values: FloatArray, step: FloatArray, weights: FloatArray, gap: FloatArray) -> FloatArray:
    """Parameters after as much of a step as brings the misclosures down."""
    before, factor = float((weights[:, None] * gap**2).sum()), 1.0
    while factor > 1e-3:
        trial = problem.moved(values, factor * step)
        after = float((weights[:, None] * problem.misclosure(trial) ** 2).sum())
        if after <= before * (1.0 + 1e-9) + 1e-18:
            return trial
        factor *= 0.5  # also where a point came to lie beyond the horizon and `after` is NaN
    return problem.moved(values, step)


def _finish(
    problem: Problem,
    values: FloatArray,
    weights: FloatArray,
    sigma: FloatArray,
    condition: float,
    rounds: int,
    where: str | None,
) -> PlanarSolution:
    """Cofactors and residuals at the solution."""
    block, views = problem.block, problem.views
    normals = Normals.of(problem.design(values, weights))
    cofactors = cofactor_blocks(problem, normals)
    place, gap = problem.positions(values), problem.misclosure(values)
    points = mean_positions(views, place, sigma)
    residuals = image_residuals(problem, values, points)
    redundancy = views.redundancy_of_points - problem.unknowns
    squares = float((weights[:, None] * gap**2).sum())
    solution = PlanarSolution(
        block=block,
        kind=problem.kind,
        frame=problem.frame,
        values=values,
        cofactors=cofactors,
        views=views,
        points=problem.frame.map(points),
        residuals=residuals,
        standardised=standardised(problem, values, sigma, cofactors, residuals),
        sigma0=float(np.sqrt(squares / redundancy)) if redundancy > 0 else float("nan"),
        redundancy=redundancy,
        equations=2 * len(views.pairs),
        condition=condition,
        rounds=rounds,
    )
    check_plausible(solution, where)
    return solution
