"""Resection: parameters of one sensor model from control points, by least squares."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np
from pyproj import CRS

from geomosaic.errors import SolveError, counted
from geomosaic.estimation.equations import Equations
from geomosaic.estimation.solver import Linearised, Outcome, Problem, Solution, Unknowns, solve
from geomosaic.estimation.statistics import position_sigmas, sigma0_of, variance_factor
from geomosaic.geo.transform import Transform
from geomosaic.sensor.plugin import SensorModel
from geomosaic.sensor.solve.inverse import image_to_height
from geomosaic.sensor.solve.newton import jacobian
from geomosaic.types import BoolArray, FloatArray

Model = TypeVar("Model", bound=SensorModel)

# Of the scaled design. Beyond it rounding decides what the points do not.
WORST_CONDITION = 1e9


@dataclass(frozen=True)
class Resection(Generic[Model]):
    """Sensor model fitted to control points.

    Attributes
    ----------
    model : SensorModel
        With the estimated values.
    sigmas : array (P,)
        Standard deviations of the parameters in their units; 0 for those held fixed.
    covariance : array (P, P)
        Of the parameters in their units.
    residuals : array (N, 2)
        Measured minus computed (col, row) in pixels; NaN for points that took no part.
    sigma0 : float
        Standard deviation of unit weight: about 1 where the sigmas given describe the residuals; in pixels where none
        were given; NaN without redundancy.
    redundancy : int
        Observations, a-priori values among them, minus unknowns.
    iterations : int
    condition : float
        Of the design matrix with columns of length one.
    """

    model: Model
    sigmas: FloatArray
    covariance: FloatArray
    residuals: FloatArray
    sigma0: float
    redundancy: int
    iterations: int
    condition: float

    @property
    def pooled_covariance(self) -> FloatArray:
        """Covariance of the parameters from given sigmas and sigma0 together; see `variance_factor`."""
        return self.covariance * variance_factor(self.sigma0, self.redundancy)


def resect(
    model: Model,
    xyz: FloatArray,
    colrow: FloatArray,
    sigmas_px: FloatArray | float | None = None,
    *,
    priors: FloatArray | None = None,
    start: FloatArray | None = None,
) -> Resection[Model]:
    """Resection of a model: its parameters from control points.

    Minimises Σ ((measured − computed) / σ_px)² + Σ ((p − p₀) / σ_p)², the second sum over parameters with a finite
    a-priori sigma, p₀ being the values `model` comes with. Gauss-Newton steps on columns scaled to length one, damped
    after Levenberg and Marquardt where a step does not lower the sum.

    Parameters
    ----------
    model : SensorModel
        Start.
    xyz : array (N, 3)
        Control points in `model.crs`.
    colrow : array (N, 2)
        Their measured image coordinates in pixels.
    sigmas_px : float or array (N,) or (N, 2), optional
        Standard deviations of the measurements. They count as true: the covariance follows from them alone, and sigma0
        tells whether they fit. Without them every measurement has the same, unknown deviation, and sigma0 estimates it.
    priors : array (P,), optional
        A-priori sigmas of the parameters in place of `model.parameters.sigmas`: 0 fixed, inf free.
    start : array (P,), optional
        Values to start from, where better ones are known than the a-priori values of `model`.

    Returns
    -------
    Resection
        Points that are NaN or that the model cannot see take no part, and their residuals are NaN.

    Raises
    ------
    SolveError
        The points do not determine the parameters (it names them), or there is no convergence.
    """
    problem = _Problem.of(model, xyz, colrow, sigmas_px, priors)
    first = problem.at(model if start is None else model.with_values(start))
    problem.need_enough(first.seen)
    return problem.result(solve(problem, first).required("check the start values, the points and their CRS"))


def fit(
    model: Model, xyz: FloatArray, colrow: FloatArray, sigmas_px: FloatArray | float | None = None
) -> Resection[Model]:
    """Resection without soft constraints: a-priori values are a start and nothing more; what is not held fixed is free.

    For models that are linear in their parameters (polynomials, affine) one step from any start is the solution.

    Parameters
    ----------
    model : SensorModel
        Parameters with a sigma of 0 are held.
    xyz : array (N, 3)
        Control points in `model.crs`.
    colrow : array (N, 2)
        Their measured (col, row) in pixels.
    sigmas_px : array (N,) or (N, 2) or float, optional
        Standard deviations of the measurements in pixels; equal weights without.

    Raises
    ------
    SolveError
        As `resect`.
    """
    sigmas = model.parameters.sigmas
    return resect(model, xyz, colrow, sigmas_px, priors=np.where(sigmas == 0.0, 0.0, np.inf))


def precision(
    model: Model, xyz: FloatArray, colrow: FloatArray, sigmas_px: FloatArray | float | None = None
) -> Resection[Model]:
    """Statistics of a model at the values it has, which an adjustment on these points gave it.

    Parameters
    ----------
    model : SensorModel
        A finite a-priori sigma of a parameter counts as an observation that fits.
    xyz, colrow, sigmas_px
        As for `resect`.

    Raises
    ------
    SolveError
        The points do not determine the parameters.
    """
    problem = _Problem.of(model, xyz, colrow, sigmas_px, None)
    state = problem.at(model)
    problem.need_enough(state.seen)
    return problem.result(Solution(state, problem.squares(state), 0, Outcome.CONVERGED, problem.linearise(state)))


def expected_errors(
    model: SensorModel, covariance: FloatArray, height: float, crs: CRS
) -> tuple[FloatArray, FloatArray]:
    """Errors to be expected at the corners and in the middle of an image, by propagation of a covariance.

    Parameters
    ----------
    model : SensorModel
    covariance : array (P, P)
        Of its parameters in their units.
    height : float
        Of the ground, in the unit and datum of `crs`: a plane, as relief changes an expected error by little.
    crs : CRS
        Map of the places; 3-D where the model has heights.

    Returns
    -------
    places : array (5, 2)
        Map positions of the corners and of the middle.
    sigmas : array (5,)
        Lengths of one standard deviation, pixels; NaN where there is no ground.
    """
    (width, height_px), share = model.size, np.array([[0, 0], [1, 0], [1, 1], [0, 1], [0.5, 0.5]])
    ground = image_to_height(model, share * (width, height_px), height, crs)
    return ground[:, :2], position_sigmas(jacobian(model, Transform(crs, model.crs)(ground))[0], covariance)


@dataclass(frozen=True, eq=False)
class _State(Generic[Model]):
    """A model, its residuals (N, 2) in pixels, and which points (N,) take part."""

    model: Model
    residuals: FloatArray
    seen: BoolArray


@dataclass(frozen=True, eq=False)
class _Problem(Problem[_State[Model]]):
    """Image positions of control points, and the parameters of one model."""

    unknowns: Unknowns
    xyz: FloatArray
    colrow: FloatArray
    weights: FloatArray  # 1 / sigma, (N, 2)
    known_sigmas: bool

    @classmethod
    def of(
        cls,
        model: Model,
        xyz: FloatArray,
        colrow: FloatArray,
        sigmas_px: FloatArray | float | None,
        priors: FloatArray | None,
    ) -> _Problem[Model]:
        points, image = np.asarray(xyz, dtype=np.float64), np.asarray(colrow, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or image.shape != (len(points), 2):
            raise ValueError(f"shapes {points.shape} and {image.shape} are not (N, 3) and (N, 2)")
        given = np.asarray(1.0 if sigmas_px is None else sigmas_px, dtype=np.float64)
        spread = np.broadcast_to(given[:, None] if given.ndim == 1 else given, image.shape)
        if not (spread > 0.0).all():
            raise SolveError("a standard deviation of an image measurement is not positive", hint="give pixels above 0")
        parameters = model.parameters
        sigmas = np.asarray(parameters.sigmas if priors is None else priors, dtype=np.float64)
        if sigmas.shape != (len(parameters),) or not (sigmas >= 0.0).all():
            raise SolveError(
                "a-priori sigmas must be one number of 0 or more for each parameter",
                hint="give one for each parameter: 0 holds it, inf frees it",
            )
        unknowns = Unknowns(parameters.names, parameters.values.copy(), parameters.steps, sigmas)
        return cls(unknowns, points, image, 1.0 / spread, sigmas_px is not None)

    def at(self, model: Model, seen: BoolArray | None = None) -> _State[Model]:
        residuals = self.colrow - model.ground_to_image(self.xyz)
        # Points keep their part within a round: sums of squares over different points could not be compared.
        return _State(model, residuals, np.isfinite(residuals.sum(axis=1)) if seen is None else seen)

    def moved(self, state: _State[Model], step: FloatArray) -> _State[Model]:
        values = self.unknowns.moved(state.model.parameters.values, step)
        return self.at(state.model.with_values(values), state.seen)

    def refreshed(self, state: _State[Model]) -> _State[Model]:
        """Points that came into sight take part from now on."""
        seen = np.isfinite(state.residuals.sum(axis=1))
        return state if np.array_equal(seen, state.seen) else replace(state, seen=seen)

    def movement(self, state: _State[Model], trial: _State[Model], equations: Linearised, step: FloatArray) -> float:
        return self.unknowns.movement(step)

    def squares(self, state: _State[Model]) -> float:
        """Sum over the points seen and the a-priori values; infinite when one of the points is lost."""
        image = (state.residuals * self.weights)[state.seen].ravel()
        vector = np.concatenate([image, self.unknowns.a_priori_misclosure(state.model.parameters.values)])
        # An infinite sum makes the solver shorten the step that lost the point.
        total = float(vector @ vector)
        return total if np.isfinite(total) else float("inf")

    def equations(self, state: _State[Model]) -> Equations:
        weights = self.weights[state.seen]
        by_parameters = jacobian(state.model, self.xyz[state.seen])[0][:, :, self.unknowns.free] * weights[:, :, None]
        design = by_parameters.reshape(-1, by_parameters.shape[2])
        design[~np.isfinite(design).all(axis=1)] = 0.0  # a difference that left the visible part pulls at nothing
        image = Equations(design, (state.residuals[state.seen] * weights).ravel())
        return Equations.stacked(image, self.unknowns.a_priori(state.model.parameters.values))

    def linearise(self, state: _State[Model]) -> Equations:
        """Equations at a state, refused where columns depend on each other; the parameters concerned are named."""
        equations = self.equations(state)
        names = np.array(self.unknowns.names)[self.unknowns.free]
        # Steps move the image by about a pixel, so the effect of a step says whether a parameter acts at all.
        effect = np.linalg.norm(equations.design, axis=0) * self.unknowns.steps[self.unknowns.free]
        # A billionth of the strongest effect is what differences leave of a parameter that does nothing.
        dead = ~(effect > 1e-9 * np.max(effect))
        if dead.any():
            raise SolveError(
                f"the points say nothing about {', '.join(names[dead])}",
                hint="fix these parameters (sigma 0) or give points that depend on them",
            )
        condition, weakest = equations.condition()
        if condition > WORST_CONDITION:
            together = names[np.abs(weakest) > 0.1]
            raise SolveError(
                f"the points cannot tell {', '.join(together)} apart (condition {condition:.1e})",
                hint="spread the points over the image and over height, add points, or fix parameters",
            )
        return equations

    def need_enough(self, seen: BoolArray) -> None:
        # Soft constraints are observations: each pays for one unknown.
        given = int(self.unknowns.observed.sum())
        unknowns, observations = int(np.count_nonzero(self.unknowns.free)), 2 * int(seen.sum()) + given
        if unknowns == 0:
            raise SolveError(
                "every parameter is held fixed: nothing to estimate", hint="free one: give it a sigma above 0"
            )
        if not seen.any():
            raise SolveError(
                "with its start values the model sees none of the points",
                hint="check the order of coordinates, the CRS of the points and the start values",
            )
        if observations < unknowns:
            names = ", ".join(np.array(self.unknowns.names)[self.unknowns.free])
            points = counted(int(seen.sum()), "point")
            verb = "gives" if points == "1 point" else "give"
            raise SolveError(
                f"{points} {verb} {counted(observations, 'observation')} for {counted(unknowns, 'unknown')} ({names})",
                hint=f"give at least {-(-(unknowns - given) // 2)} points, or fix parameters",
            )

    def result(self, solution: Solution[_State[Model]]) -> Resection[Model]:
        state, free = solution.state, self.unknowns.free
        equations = self.equations(state)
        redundancy = equations.redundancy
        sigma0 = sigma0_of(solution.squares, redundancy)
        covariance = np.zeros((len(free), len(free)))
        # Sigmas that were given are taken as true; without them the residuals tell the precision.
        covariance[np.ix_(free, free)] = equations.parameter_cofactors() * (1.0 if self.known_sigmas else sigma0**2)
        left = np.where(state.seen[:, None], state.residuals, np.nan)
        sigmas = np.sqrt(np.diag(covariance))
        return Resection(
            state.model, sigmas, covariance, left, sigma0, redundancy, solution.rounds, equations.condition()[0]
        )  # fmt: skip
