"""Solution of one image's control points while they are measured: what each of them says, and would say otherwise.

One adjustment and what follows from it in closed form: leave-one-out errors, the solution without each point that takes
part and with each that does not, and wrong points by data snooping. For models that are not linear in their parameters
the closed forms are those of the linearisation at the solution.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.estimation.solver import Unknowns
from geomosaic.orientation.single.fit import ControlAdjustment, ControlFit, HasOmission, fit_problem
from geomosaic.orientation.single.problem import Build, map_by_image
from geomosaic.sensor.plugin import SensorModel
from geomosaic.sensor.solve import resect
from geomosaic.sensor.solve.control_judgement import Judgement, judge_points
from geomosaic.sensor.solve.control_resection import ROUNDS
from geomosaic.sensor.solve.newton import jacobian
from geomosaic.types import BoolArray, FloatArray, IntArray

# Points up to which the solution without or with each of them is told: its cost grows with their square.
MOST_TOGGLED = 500


def resection_build(model: SensorModel, xyz: FloatArray, colrow: FloatArray, start: FloatArray | None = None) -> Build:
    """Function that fits a sensor model of any kind to some of its control points, from the values it has.

    Parameters
    ----------
    model : SensorModel
        Parameters with sigma 0 are held, with a finite one observed.
    xyz : array (N, 3)
        In `model.crs`.
    colrow : array (N, 2)
        Pixels.
    start : array (P,), optional
        Values of the first fit to start from, such as those of the solution before; each fit is the start of the next.
    """
    last = [start]

    def build(selection: IntArray, sigma: FloatArray) -> SensorModel:
        found = resect(model, xyz[selection], colrow[selection], sigma, start=last[0]).model
        last[0] = found.parameters.values
        return found

    return build


@dataclass(frozen=True, eq=False)
class Blunder:
    """Control point that contradicts the others.

    Attributes
    ----------
    index : int
        Number of the point.
    error : float
        Length of its error under the fit without it and all other blunders, pixels.
    probability : float
        Of an error as large by chance.
    """

    index: int
    error: float
    probability: float


@dataclass(frozen=True, eq=False)
class LiveSolution:
    """Fit to the control points in use, and what it says of all N points.

    Attributes
    ----------
    used : bool array (N,)
        Points that take part in the fit.
    fit : ControlFit
        Of the points in use, in their order.
    residuals, map_residuals : array (N, 2)
        Measured minus computed of all points: pixels, and x and y of the map (metres east and north where the CRS of
        the model is geocentric); NaN where the model does not see a point.
    leave_one_out : array (N, 2)
        Errors under the fit to the others, pixels; of points that do not take part their residuals. NaN where the
        others do not determine the model.
    redundancy_numbers : array (N, 2)
        Share of each coordinate that the others check; 1 for points that do not take part.
    toggled_sigma0, toggled_rms : array (N,)
        Standard deviation of unit weight, and RMS length of the residuals in pixels, of the fit without a point that
        takes part, or with one that does not; NaN where there is no such fit, or of more than 500 points.
    blunders : tuple of Blunder
        The least probable first.
    rivals : tuple of int
        Points of which one is wrong, and the others do not tell which; the likeliest first.
    clean_rms : float
        RMS length of the residuals without the blunders, pixels.
    """

    used: BoolArray
    fit: ControlFit
    residuals: FloatArray
    map_residuals: FloatArray
    leave_one_out: FloatArray
    redundancy_numbers: FloatArray
    toggled_sigma0: FloatArray
    toggled_rms: FloatArray
    blunders: tuple[Blunder, ...]
    rivals: tuple[int, ...]
    clean_rms: float


def live_solution(problem: ControlAdjustment, used: BoolArray) -> LiveSolution:
    """Solution of the points in use, with what it says of each point.

    Parameters
    ----------
    problem : ControlAdjustment
        All N points.
    used : bool array (N,)
        Those that take part in the fit.

    Raises
    ------
    SolveError
        The points in use do not determine the model.
    """
    if not used.any():
        raise SolveError("no point takes part in the fit", hint="measure points, or switch some on")
    fit = fit_problem(problem.subset(used))
    residuals = problem.errors(fit.model)
    left_out, numbers = residuals.copy(), np.ones(residuals.shape)
    own = fit.model.omission() if isinstance(fit.model, HasOmission) else None
    left_out[used] = fit.cofactors.leave_one_out(fit.residuals) if own is None else own
    numbers[used] = fit.redundancy_numbers
    sigma0, rms = (np.full(len(problem), np.nan) for _ in range(2))
    if own is None and len(problem) <= MOST_TOGGLED:
        sigma0, rms = _toggled(problem, fit, used, residuals)
    found, clean = (Judgement.of_none(len(problem)), fit) if own is not None else _judged(problem, used, fit)
    errors, wrong = np.hypot(*problem.errors(clean.model).T), np.flatnonzero(found.wrong)
    order = wrong[np.argsort(found.probability[wrong], kind="stable")].tolist()
    return LiveSolution(
        used,
        fit,
        residuals,
        np.einsum("nij,nj->ni", map_by_image(fit.model, problem.xyz), residuals),
        left_out,
        numbers,
        sigma0,
        rms,
        tuple(Blunder(index, float(errors[index]), float(found.probability[index])) for index in order),
        found.rivals,
        clean.rms_total,
    )


def _toggled(
    problem: ControlAdjustment, fit: ControlFit, used: BoolArray, residuals: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Sigma0 (N,) and RMS residuals (N,), pixels, of the fit with each point switched over, see `LiveSolution`."""
    count, sigma = len(problem), problem.sigma
    weighted = residuals / sigma[:, None]
    design = jacobian(fit.model, problem.xyz)[0] / sigma[:, None, None]
    # Removing point i moves the residuals by A·Q·Aᵢᵀ·(I − AᵢQAᵢᵀ)⁻¹·vᵢ, adding it by −A·Q·Aᵢᵀ·(I + AᵢQAᵢᵀ)⁻¹·eᵢ.
    by = design @ fit.cofactors.parameters
    rows = design.reshape(2 * count, -1)
    sign = np.where(used, -1.0, 1.0)
    own = np.eye(2) + sign[:, None, None] * (by @ design.transpose(0, 2, 1))
    good: BoolArray = np.asarray(np.isfinite(weighted).all(axis=1) & np.isfinite(design).all(axis=(1, 2)))
    good[good] = np.linalg.eigvalsh(own[good])[:, 0] > 1e-7
    pull = np.zeros((count, 2))
    pull[good] = np.linalg.solve(own[good], weighted[good][:, :, None])[:, :, 0]
    moved = (rows @ np.einsum("nip,ni->pn", by, sign[:, None] * pull)).reshape(count, 2, count)
    after = (weighted[:, :, None] - moved) * sigma[:, None, None]  # pixels, of all points for each point switched
    takes = np.repeat(used[:, None], count, axis=1)
    np.fill_diagonal(takes, ~used)
    squares = (np.where(takes[:, None, :], after, 0.0) ** 2).sum(axis=(0, 1))
    number = takes.sum(axis=0)
    change = sign * (weighted * pull).sum(axis=1)
    freedom = fit.redundancy + 2.0 * sign
    with np.errstate(invalid="ignore", divide="ignore"):
        rms = np.where(good, np.sqrt(squares / number), np.nan)
        total = fit.sigma0**2 * fit.redundancy if fit.redundancy else 0.0
        sigma0 = np.sqrt(np.maximum(total + change, 0.0) / freedom)
    return np.where(good & (freedom > 0), sigma0, np.nan), np.where(number > 0, rms, np.nan)


def _judged(problem: ControlAdjustment, used: BoolArray, fit: ControlFit) -> tuple[Judgement, ControlFit]:
    """Judgement on the points in use, as one on all N, and the fit without those that are wrong.

    Nothing is taken from a-priori sigmas, which nobody knows while points are measured: the scatter of the points that
    agree judges the others.
    """
    whole, clean, wrong = problem.subset(used), fit, np.zeros(int(used.sum()), dtype=np.bool_)
    for _ in range(ROUNDS):
        model, given = clean.model, clean.model.parameters
        start = Unknowns(given.names, given.values, given.steps, given.sigmas)
        found = judge_points(model, whole.xyz, whole.colrow, whole.sigma, start, known_sigmas=False)
        if np.array_equal(found.wrong, wrong):
            break
        wrong = found.wrong
        clean = fit_problem(whole.subset(~wrong))
    return found.among(np.flatnonzero(used), len(problem)), clean
