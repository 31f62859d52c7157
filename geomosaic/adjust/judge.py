"""How probable the error of each point is, whether it takes part in a fit or not."""

from __future__ import annotations

import numpy as np

from geomosaic.adjust.fit import ControlFit, fit_problem
from geomosaic.adjust.problem import Problem
from geomosaic.sensor.solve.derivatives import jacobian
from geomosaic.types import BoolArray, FloatArray


def judge(problem: Problem, kept: BoolArray, scale: float, freedom: float) -> FloatArray:
    """Probability (N,) that chance alone brings the error of each point under a fit to those kept.

    Parameters
    ----------
    problem : Problem
    kept : bool array (N,)
    scale : float
        Standard deviation of unit weight.
    freedom : float
        Degrees of freedom it rests on; inf where it is known beforehand.
    """
    return probabilities(statistics(problem, kept)[1], scale, freedom)


def statistics(problem: Problem, kept: BoolArray) -> tuple[ControlFit, FloatArray]:
    """Fit the points kept, and measure the error of every point against that fit.

    For a point kept, T = vᵀ (I − H)⁻¹ v is what the weighted sum of squares loses without it; for one left out, it is
    eᵀ (I + A Q Aᵀ)⁻¹ e of its error of prediction: one number for both axes of a point, in place of Baarda's w of each.

    Returns
    -------
    fit : ControlFit
    statistic : array (N,)
        0 for points that nothing checks, inf for those the model cannot see.
    """
    fit = fit_problem(problem.subset(kept))
    statistic = np.zeros(len(problem))
    own = fit.residuals / fit.sigma[:, None]
    inside = np.einsum("ni,nij,nj->n", own, fit.cofactors.checked, own)
    statistic[kept] = np.where(np.isfinite(inside), inside, 0.0)
    outside = np.flatnonzero(~kept)
    if len(outside):
        errors = problem.errors(fit.model)[outside] / problem.sigma[outside, None]
        design = jacobian(fit.model, problem.xyz[outside])[0] / problem.sigma[outside, None, None]
        spread = np.eye(2) + np.einsum("nip,pq,njq->nij", design, fit.cofactors.parameters, design)
        seen = np.isfinite(errors).all(axis=1) & np.isfinite(spread).all(axis=(1, 2))
        statistic[outside] = np.inf
        solved = np.linalg.solve(spread[seen], errors[seen][:, :, None])[:, :, 0]
        statistic[outside[seen]] = (errors[seen] * solved).sum(axis=1)
    return fit, statistic


def probabilities(statistic: FloatArray, scale: float, freedom: float) -> FloatArray:
    """Probability of statistics as large by chance: T / (2 s²) has the distribution F(2, f) when the point is good.

    With two degrees of freedom above, its upper tail is (1 + T / (f s²))^(−f/2), and exp(−T / (2 s²)) where s is known.
    """
    ratio = statistic / scale**2
    power = -0.5 * ratio if np.isinf(freedom) else -0.5 * freedom * np.log1p(ratio / freedom)
    probability: FloatArray = np.exp(power)
    return probability
