"""Fit of one sensor model to control points: adjustment, cofactors, leave-one-out errors, refits without blunders."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, runtime_checkable

import numpy as np

from geomosaic.errors import GeomosaicError, SolveError
from geomosaic.estimation.blunders.data_snooping import BlunderSearch
from geomosaic.estimation.equations import Equations
from geomosaic.estimation.solver import Unknowns
from geomosaic.estimation.statistics import Cofactors, axis_rms, sigma0_of, total_rms, variance_factor
from geomosaic.orientation.single.problem import ControlProblem, is_mirrored, map_by_image
from geomosaic.sensor.plugin import SensorModel
from geomosaic.sensor.solve.newton import jacobian
from geomosaic.types import AnyArray, BoolArray, FloatArray, IntArray


def cofactors(model: SensorModel, xyz: FloatArray, sigma: FloatArray) -> Cofactors:
    """Cofactors of a model that was fitted to points.

    Parameters
    ----------
    model : SensorModel
        Parameters with sigma 0 count as fixed, with a finite one as observed, with an infinite one as free.
    xyz : array (N, 3)
        In `model.crs`.
    sigma : array (N,)
        Standard deviations of the image coordinates, pixels.

    Raises
    ------
    SolveError
        The points do not determine the parameters.
    """
    parameters = model.parameters
    unknowns = Unknowns(parameters.names, parameters.values, parameters.steps, parameters.sigmas)
    design = jacobian(model, xyz)[0][:, :, unknowns.free] / sigma[:, None, None]
    image = Equations(design.reshape(-1, design.shape[2]), np.zeros(2 * len(xyz)))
    equations = Equations.stacked(image, unknowns.a_priori(parameters.values))
    return Cofactors.of(equations, unknowns.free, len(xyz))


def _is_linear(model: SensorModel, xyz: FloatArray) -> bool:
    """Whether the image is linear in the free parameters, from the Jacobian at other values of them."""
    parameters = model.parameters
    free = parameters.sigmas > 0.0
    # Steps of unlike size and sign, so that changes of the Jacobian do not cancel.
    turns = np.where(np.arange(len(parameters)) % 2, 3.0, -2.0) * free
    other = model.with_values(parameters.values + turns * parameters.steps)
    change = jacobian(other, xyz)[0] - jacobian(model, xyz)[0]
    return bool(np.abs(change * parameters.steps)[:, :, free].max(initial=0.0) < 1e-9)


# Points without a closed form that are all refitted.
MOST_REFITS = 200
# Points that are refitted where there are more.
SAMPLE = 100
# Points up to which a model that is not linear is refitted; beyond, one of them bends it too little to matter.
FEW = 40


@runtime_checkable
class HasOmission(Protocol):
    """Optional power of a model that passes through its points: leave-one-out errors in closed form.

    Its parameters are the image coordinates of the points: col of all, then row.
    """

    def omission(self) -> FloatArray | None:
        """Measured minus computed (col, row) (N, 2) of each point under the model of all others, in the order of the
        points it was built from, pixels; None where the model, of another kind, has no closed form.
        """


def leave_one_out(problem: ControlProblem, model: SensorModel, residuals: FloatArray, found: Cofactors) -> FloatArray:
    """Errors of points under fits to all the others.

    In closed form, (I − H_ii)⁻¹ v_i, where the model is linear in its parameters, or more than 40 points hold its
    linearisation; by refits where it is not, and where a point has no residual because the fit passes through it. Of
    more than 200 such points 100, evenly drawn, are refitted.

    Parameters
    ----------
    problem : ControlProblem
    model : SensorModel
        Fitted to all points.
    residuals : array (N, 2)
        Pixels.
    found : Cofactors
        At the model.

    Returns
    -------
    array (N, 2)
        Measured minus computed (col, row), pixels; NaN where the other points do not determine the model, or where it
        was not computed.
    """
    errors = found.leave_one_out(residuals)
    closed: BoolArray = np.isfinite(errors.sum(axis=1))
    # The closed form holds the linearisation; with few points one of them moves it.
    if not _is_linear(model, problem.xyz) and len(problem) <= FEW:
        closed[:] = False
    left = np.flatnonzero(~closed)
    errors[left] = np.nan
    if len(left) > MOST_REFITS:
        left = left[np.linspace(0, len(left) - 1, SAMPLE).astype(np.int64)]
    for index in left:
        errors[index] = _without(problem, int(index))
    return errors


def _without(problem: ControlProblem, index: int) -> FloatArray:
    others: IntArray = np.delete(np.arange(len(problem)), index)
    try:
        model = problem.model(others)
    except GeomosaicError:
        return np.full(2, np.nan)
    error: FloatArray = problem.colrow[index] - model.ground_to_image(problem.xyz[[index]])[0]
    return error


# Wolf & Dewitt, section 9-3: RMS error of one axis to a radius that holds about 95 % of points (exactly 2.4477).
NINETY_FIVE = 2.5


@dataclass(frozen=True, eq=False)
class ControlFit:
    """Sensor model fitted to control points, with its errors.

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
    leave_one_out: FloatArray
    map_leave_one_out: FloatArray
    mirrored: bool
    cofactors: Cofactors

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the parameters, scaled by sigma0², shaped as their cofactors; NaN without redundancy."""
        return self.cofactors.parameters * self.sigma0**2

    @property
    def errs_by_omission(self) -> bool:
        """Whether leave-one-out errors alone tell the errors of measurement: the model passes through its points."""
        return self.redundancy <= 0 and bool(np.isfinite(self.leave_one_out).all(axis=1).any())

    @property
    def variance_factor(self) -> float:
        """Factor from cofactors to the covariance of expected errors."""
        if not self.errs_by_omission:
            return variance_factor(self.sigma0, self.redundancy)
        return total_rms(self.leave_one_out / self.sigma[:, None]) ** 2 / 2.0

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
    def leave_one_out_rms(self) -> float:
        """RMS length of the leave-one-out errors, pixels, over the points that have one."""
        return total_rms(self.leave_one_out)

    @property
    def circular_error_95(self) -> float:
        """Radius, pixels, that holds about 95 % of errors like the residuals: 2.5 × RMS of one axis."""
        return circular_error_95(self.residuals)


def fit_problem(problem: ControlProblem, *, omission: bool = False) -> ControlFit:
    """Fit of a model to all points of a problem, with its errors.

    Parameters
    ----------
    problem : ControlProblem
    omission : bool
        Whether leave-one-out errors are wanted; NaN without.

    Raises
    ------
    SolveError
        The points do not determine the model.
    """
    model = problem.model()
    residuals = problem.errors(model)
    problem.need_seen(residuals)
    own = model.omission() if isinstance(model, HasOmission) else None
    found = cofactors(model, problem.xyz, problem.sigma) if own is None else Cofactors.of_interpolation(problem.sigma)
    weighted = residuals / problem.sigma[:, None]
    redundancy = found.redundancy
    sigma0 = sigma0_of((weighted**2).sum(), redundancy)
    numbers = found.redundancy_numbers
    spread = sigma0 * np.sqrt(numbers)
    standardised = np.full_like(weighted, np.nan)
    np.divide(weighted, spread, out=standardised, where=spread > 0.0)
    if not omission:
        left_out = np.full(residuals.shape, np.nan)
    else:
        left_out = leave_one_out(problem, model, residuals, found) if own is None else own
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
        leave_one_out=left_out,
        map_leave_one_out=_moved(to_map, left_out),
        mirrored=is_mirrored(model, problem.xyz),
        cofactors=found,
    )


def _moved(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    moved: FloatArray = np.einsum("nij,nj->ni", matrices, vectors)
    return moved


def circular_error_95(errors: FloatArray) -> float:
    """Radius of 95 % of the errors: 2.5 × RMS of one axis.

    Parameters
    ----------
    errors : array (N, 2)
        Position errors in one unit; rows with NaN do not count.

    Returns
    -------
    float
        In the unit of `errors`; NaN where no row counts.
    """
    # Of normal errors 95.6 % lie within it, and 39 % within 1 × RMS. The textbook's 40 % within the RMS and 95 % within
    # 2.5 of it are those of the RMS of one axis. Of the total RMS, which is √2 larger, the 95 % factor is 1.73.
    return NINETY_FIVE * total_rms(errors) / float(np.sqrt(2.0))


@dataclass(frozen=True, eq=False)
class ControlAdjustment(ControlProblem):
    """Control points whose fit can be repeated without some of them, for searches for blunders (`blunders.Refit`).

    Attributes
    ----------
    linear : bool
        Whether the image is linear in the parameters, whatever the points.
    """

    linear: bool = False

    @cached_property
    def _whole(self) -> tuple[FloatArray, FloatArray] | None:
        """Errors (N, 2) and derivatives (N, 2, P) under the fit to all points, over their standard deviations."""
        if not self.linear:
            return None
        try:
            model = self.model()
        except GeomosaicError:  # gross blunders may leave the middle of the image without a place
            return None
        weight = 1.0 / self.sigma[:, None]
        return self.errors(model) * weight, jacobian(model, self.xyz)[0] * weight[:, :, None]

    def errors_under(self, selection: AnyArray) -> FloatArray:
        """Errors (N, 2) of all points, pixels, under the model fitted to a selection (bool (N,) or int (K,))."""
        if self._whole is None:
            return self.errors(self.model(selection))
        # One step from the fit to all points leads to that to some. A search takes hundreds, and models are dearer.
        errors, design = self._whole
        equations = Equations(design[selection].reshape(-1, design.shape[2]), errors[selection].ravel())
        if not equations.determined:
            raise SolveError("the points chosen do not determine the model", hint="choose more of them")
        return (errors - design @ equations.step()) * self.sigma[:, None]

    def subset(self, kept: AnyArray) -> ControlAdjustment:
        """Problem of some of the points (bool (N,) or int (K,))."""
        chosen = np.arange(len(self))[np.asarray(kept)]
        whole = self.build

        def build(selection: IntArray, sigma: FloatArray) -> SensorModel:
            return whole(chosen[selection], sigma)

        names = tuple(self.ids[i] for i in chosen)
        return ControlAdjustment(build, names, self.xyz[chosen], self.colrow[chosen], self.sigma[chosen])

    def fit(self, kept: AnyArray) -> ControlFit:
        """Fit to a selection, with leave-one-out errors."""
        return fit_problem(self.subset(kept), omission=True)

    def statistics(self, kept: BoolArray) -> tuple[ControlFit, FloatArray]:
        """Fit to the points kept, and the statistic (N,) of each point's error against that fit.

        That of a point kept is what the weighted sum of squares loses without it; that of one left out, its error of
        prediction. 0 for points that nothing checks, inf for those the model cannot see.
        """
        fit = fit_problem(self.subset(kept))
        statistic = np.zeros(len(self))
        statistic[kept] = fit.cofactors.deletion_statistic(fit.residuals / fit.sigma[:, None])
        outside = np.flatnonzero(~kept)
        if len(outside):
            errors = self.errors(fit.model)[outside] / self.sigma[outside, None]
            design = jacobian(fit.model, self.xyz[outside])[0] / self.sigma[outside, None, None]
            statistic[outside] = fit.cofactors.prediction_statistic(errors, design)
        return fit, statistic


# Search for blunders among control points.
ControlBlunders = BlunderSearch[ControlFit]
