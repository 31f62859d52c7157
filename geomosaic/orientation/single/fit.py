"""The fit of an image to its control points, with all its errors told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.orientation.single.leave_one_out import Cofactors, cofactors, leave_one_out
from geomosaic.orientation.single.problem import Build, Problem, is_mirrored, map_by_image
from geomosaic.sensor.model import SensorModel
from geomosaic.sensor.solve.derivatives import jacobian
from geomosaic.types import AnyArray, BoolArray, FloatArray

NINETY_FIVE = 2.5
"""Wolf & Dewitt, section 9-3: RMS error of one axis to a radius that holds about 95 % of points (exactly 2.4477)."""


@dataclass(frozen=True, eq=False)
class ControlFit:
    """A model fitted to control points.

    Residuals and errors are measured minus computed. Map values are in the units of x and y of `model.crs`, or in
    metres east and north where that is geocentric.

    Attributes
    ----------
    model : SensorModel
    ids : tuple of str
    xyz, colrow, sigma : array (N, 3), (N, 2), (N,)
        The points: places in `model.crs`, pixels, standard deviations in pixels.
    residuals : array (N, 2)
        col, row, in pixels.
    map_residuals : array (N, 2)
        x, y: how far on the map the image of a point lies from where the control has it.
    standardised : array (N, 2)
        Residuals divided by their standard deviations, sigma0 · sigma · √(redundancy number); NaN for an observation
        that nothing checks.
    redundancy_numbers : array (N, 2)
        Share of an error of col or row that shows in its own residual, 0 to 1.
    redundancy : int
    sigma0 : float
        Standard deviation of unit weight, pixels where no sigmas were given; NaN without redundancy.
    covariance : array (P, P)
        Of the parameters, scaled by sigma0²; NaN without redundancy.
    leave_one_out : array (N, 2)
        Errors of each point, pixels, under the fit to all others; NaN where those do not determine the model.
    map_leave_one_out : array (N, 2)
    mirrored : bool
        Ground and image run the same way round: the image's axes are right-handed (rows upwards), not left-handed.
    cofactors : Cofactors
    """

    model: SensorModel
    ids: tuple[str, ...]
    xyz: FloatArray
    colrow: FloatArray
    sigma: FloatArray
    residuals: FloatArray
    map_residuals: FloatArray
    standardised: FloatArray
    redundancy_numbers: FloatArray
    redundancy: int
    sigma0: float
    covariance: FloatArray
    leave_one_out: FloatArray
    map_leave_one_out: FloatArray
    mirrored: bool
    cofactors: Cofactors

    @property
    def lengths(self) -> FloatArray:
        """Lengths of the residuals, (N,) pixels."""
        lengths: FloatArray = np.hypot(*self.residuals.T)
        return lengths

    @property
    def rms(self) -> tuple[float, float]:
        """RMS of the residuals in col and row, pixels."""
        return axis_rms(self.residuals)

    @property
    def rms_total(self) -> float:
        """RMS length of the residuals, pixels: the root of the sum of squares of both axes."""
        return total_rms(self.residuals)

    @property
    def map_rms_total(self) -> float:
        """RMS length of the residuals on the map."""
        return total_rms(self.map_residuals)

    @property
    def leave_one_out_rms(self) -> float:
        """RMS length of the leave-one-out errors, pixels, over the points that have one."""
        return total_rms(self.leave_one_out)

    @property
    def figure95(self) -> float:
        """Radius, pixels, that holds about 95 % of errors like the residuals: 2.5 × RMS of one axis."""
        return textbook95(self.residuals)


def fit_control(
    build: Build,
    ids: Sequence[str],
    ground: AnyArray,
    colrow: AnyArray,
    sigma: AnyArray | float | None = None,
    *,
    omission: bool = True,
) -> ControlFit:
    """Fit a model to all points and tell its errors.

    Parameters
    ----------
    build : Build
        `build(selection, sigma)` fits a model to the points of an index array with their sigmas; see
        `geomosaic.orientation.single.problem.registry_build`.
    ids : sequence of str
        Names of the points.
    ground : array (N, 2) or (N, 3)
        Places in the CRS of the model.
    colrow : array (N, 2)
        Measured pixels.
    sigma : float or array (N,), optional
        Standard deviations of the measurements, pixels; 1 when left out.
    omission : bool
        Whether leave-one-out errors are wanted; NaN without.

    Raises
    ------
    InputError
        A coordinate or sigma that is no number.
    SolveError
        The points do not determine the model.
    """
    return fit_problem(Problem.of(build, ids, ground, colrow, sigma), omission=omission)


def fit_problem(problem: Problem, *, omission: bool = False) -> ControlFit:
    """Fit a model to the points of a problem; see `fit_control`."""
    model = problem.model()
    residuals = problem.errors(model)
    problem.need_seen(residuals)
    found = cofactors(model, problem.xyz, problem.sigma)
    weighted = residuals / problem.sigma[:, None]
    redundancy = found.redundancy
    sigma0 = float(np.sqrt((weighted**2).sum() / redundancy)) if redundancy > 0 else float("nan")
    numbers = found.numbers
    spread = sigma0 * np.sqrt(numbers)
    standardised = np.full_like(weighted, np.nan)
    np.divide(weighted, spread, out=standardised, where=spread > 0.0)
    left_out = leave_one_out(problem, model, residuals, found) if omission else np.full(residuals.shape, np.nan)
    to_map = map_by_image(model, problem.xyz)
    return ControlFit(
        model=model,
        ids=problem.ids,
        xyz=problem.xyz,
        colrow=problem.colrow,
        sigma=problem.sigma,
        residuals=residuals,
        map_residuals=_moved(to_map, residuals),
        standardised=standardised,
        redundancy_numbers=numbers,
        redundancy=redundancy,
        sigma0=sigma0,
        covariance=found.parameters * sigma0**2,
        leave_one_out=left_out,
        map_leave_one_out=_moved(to_map, left_out),
        mirrored=is_mirrored(model, problem.xyz),
        cofactors=found,
    )


def _moved(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    moved: FloatArray = np.einsum("nij,nj->ni", matrices, vectors)
    return moved


def axis_rms(errors: FloatArray) -> tuple[float, float]:
    """RMS of each of two columns (N, 2); NaN rows do not count."""
    seen = errors[np.isfinite(errors).all(axis=1)]
    if not len(seen):
        return float("nan"), float("nan")
    first, second = np.sqrt((seen**2).mean(axis=0))
    return float(first), float(second)


def total_rms(errors: FloatArray) -> float:
    """RMS length of vectors (N, 2); NaN rows do not count."""
    return float(np.hypot(*axis_rms(errors)))


def textbook95(errors: FloatArray) -> float:
    """2.5 × RMS of one axis (mean of both): with normal errors 95.6 % lie within it, and 39 % within 1 × RMS.

    The textbook's 40 % within the RMS and 95 % within 2.5 of it are those of the RMS of one axis. Of the total RMS,
    which is √2 larger, the 95 % factor is 1.73.
    """
    return NINETY_FIVE * total_rms(errors) / float(np.sqrt(2.0))


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
