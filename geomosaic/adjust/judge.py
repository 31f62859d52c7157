"""How probable the error of each point is, whether it takes part in a fit or not."""

from __future__ import annotations

import numpy as np

from geomosaic.adjust.fit import ControlFit, fit_problem
from geomosaic.adjust.problem import Problem
from geomosaic.sensor.solve.jacobian import jacobian
from geomosaic.types import BoolArray, FloatArray


def judge(problem: Problem, kept: BoolArray, scale: float, freedom: float) -> tuple[ControlFit, FloatArray]:
    """Fit the points kept, and test every point against that fit.

    For a point kept, T = vᵀ (I − H)⁻¹ v is what the weighted sum of squares loses without it; for one left out, it is
    eᵀ (I + A Q Aᵀ)⁻¹ e of its error of prediction. T / (2 s²) has the distribution F(2, f) when the point is good: one
    test for both axes of a point, in place of Baarda's w for each.

    Parameters
    ----------
    problem : Problem
    kept : bool array (N,)
    scale : float
        Standard deviation of unit weight, s.
    freedom : float
        Degrees of freedom it rests on, f; inf where it is known beforehand.

    Returns
    -------
    fit : ControlFit
    probability : array (N,)
        That chance alone brings an error as large; 1 for points that nothing checks, 0 for those the model cannot see.
    """
    from scipy.special import chdtrc, fdtrc

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
    ratio = statistic / scale**2
    found = chdtrc(2, ratio) if np.isinf(freedom) else fdtrc(2, freedom, ratio / 2.0)
    probability: FloatArray = np.where(np.isinf(statistic), 0.0, found)
    return fit, probability
