"""Parameters of one sensor model from control points, by least squares."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from geomosaic.errors import SolveError, counted
from geomosaic.sensor.model import SensorModel
from geomosaic.sensor.solve.derivatives import jacobian
from geomosaic.types import BoolArray, FloatArray

Model = TypeVar("Model", bound=SensorModel)

ROUNDS = 100
STEP_GOAL = 1e-10
WORST_CONDITION = 1e9


@dataclass(frozen=True)
class Resection(Generic[Model]):
    """A model fitted to control points.

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


def resect(
    model: Model,
    xyz: FloatArray,
    colrow: FloatArray,
    sigmas_px: FloatArray | float | None = None,
    *,
    priors: FloatArray | None = None,
) -> Resection[Model]:
    """Estimate a model's parameters from control points.

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
        Standard deviations of the measurements. They are believed: the covariance follows from them alone, and sigma0
        tells whether they fit. Without them every measurement has the same, unknown deviation, and sigma0 estimates it.
    priors : array (P,), optional
        A-priori sigmas of the parameters in place of `model.parameters.sigmas`: 0 fixed, inf free.

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
    start = model.parameters.values.copy()
    values, damping = start.copy(), 0.0
    residuals = problem.residuals(model)
    seen = _seen(residuals)
    problem.need_enough(seen)
    cost, iteration = problem.cost(residuals, seen, values), 0
    while True:
        iteration += 1
        if iteration > ROUNDS:
            raise SolveError(
                f"the adjustment did not converge in {ROUNDS} rounds",
                hint="check the start values, the points and their CRS",
            )
        here = model.with_values(values)
        design = problem.design(here, seen)
        problem.need_determined(design)
        right = problem.right(residuals, seen, values)
        step = _damped_step(design, right, damping)
        trial = values.copy()
        trial[problem.free] += step
        moved = float(np.max(np.abs(step) / problem.steps, initial=0.0))
        trial_residuals = problem.residuals(model.with_values(trial))
        trial_cost = problem.cost(trial_residuals, seen, trial)
        if trial_cost <= cost * (1.0 + 1e-12) or moved < STEP_GOAL:
            gain = cost - trial_cost
            values, residuals, damping = trial, trial_residuals, damping * 0.1 if damping > 1e-9 else 0.0
            seen = _seen(residuals)
            cost = problem.cost(residuals, seen, values)
            if moved < STEP_GOAL or (gain <= 1e-15 * cost and moved < 1e-4):
                break
        else:
            damping = max(10.0 * damping, 1e-4)
            if damping > 1e12:
                if moved < 1e-3:  # nothing better within reach: rounding, not failure
                    break
                raise SolveError(
                    "the adjustment does not converge", hint="check the start values, the points and their CRS"
                )
    return problem.result(model.with_values(values), residuals, seen, values, iteration)


def fit(
    model: Model, xyz: FloatArray, colrow: FloatArray, sigmas_px: FloatArray | float | None = None
) -> Resection[Model]:
    """Like `resect`, but every parameter that is not held fixed is free: a-priori values are a start and nothing more.

    For models that are linear in their parameters (polynomials, affine) one step from any start is the solution.
    """
    sigmas = model.parameters.sigmas
    return resect(model, xyz, colrow, sigmas_px, priors=np.where(sigmas == 0.0, 0.0, np.inf))


def _damped_step(design: FloatArray, right: FloatArray, damping: float) -> FloatArray:
    """Solve min |design·dx − right|² + damping·|scaled dx|²; columns are brought to length one first."""
    scale = np.linalg.norm(design, axis=0)
    scaled = design / scale
    if damping > 0.0:
        scaled = np.vstack([scaled, np.sqrt(damping) * np.eye(scaled.shape[1])])
        right = np.concatenate([right, np.zeros(scaled.shape[1])])
    solution: FloatArray = np.linalg.lstsq(scaled, right, rcond=None)[0] / scale
    return solution


@dataclass(frozen=True)
class _Problem:
    """Observations, weights and priors of one resection."""

    names: tuple[str, ...]
    start: FloatArray
    all_steps: FloatArray
    xyz: FloatArray
    colrow: FloatArray
    weights: FloatArray  # 1 / sigma, (N, 2)
    known_sigmas: bool
    sigmas: FloatArray  # (P,) a priori
    free: BoolArray  # (P,) which are estimated

    @classmethod
    def of(
        cls,
        model: SensorModel,
        xyz: FloatArray,
        colrow: FloatArray,
        sigmas_px: FloatArray | float | None,
        priors: FloatArray | None,
    ) -> _Problem:
        points, image = np.asarray(xyz, dtype=np.float64), np.asarray(colrow, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 3 or image.shape != (len(points), 2):
            raise ValueError(f"shapes {points.shape} and {image.shape} are not (N, 3) and (N, 2)")
        given = np.asarray(1.0 if sigmas_px is None else sigmas_px, dtype=np.float64)
        spread = np.broadcast_to(given[:, None] if given.ndim == 1 else given, image.shape)
        if not (spread > 0.0).all():
            raise SolveError("a standard deviation of an image measurement is not positive")
        parameters = model.parameters
        sigmas = np.asarray(parameters.sigmas if priors is None else priors, dtype=np.float64)
        if sigmas.shape != (len(parameters),) or not (sigmas >= 0.0).all():
            raise SolveError("a-priori sigmas must be one number of 0 or more for each parameter")
        return cls(
            parameters.names,
            parameters.values.copy(),
            parameters.steps,
            points,
            image,
            1.0 / spread,
            sigmas_px is not None,
            sigmas,
            sigmas > 0.0,
        )

    @property
    def steps(self) -> FloatArray:
        chosen: FloatArray = self.all_steps[self.free]
        return chosen

    @property
    def prior(self) -> BoolArray:
        """Which of the estimated parameters have an a-priori value."""
        known: BoolArray = np.isfinite(self.sigmas[self.free])
        return known

    def residuals(self, model: SensorModel) -> FloatArray:
        return self.colrow - model.ground_to_image(self.xyz)

    def _pull(self, values: FloatArray) -> FloatArray:
        """Weighted misfit of the a-priori values, (number of priors,)."""
        misfit: FloatArray = ((self.start - values)[self.free] / self.sigmas[self.free])[self.prior]
        return misfit

    def right(self, residuals: FloatArray, seen: BoolArray, values: FloatArray) -> FloatArray:
        return np.concatenate([(residuals * self.weights)[seen].ravel(), self._pull(values)])

    def cost(self, residuals: FloatArray, seen: BoolArray, values: FloatArray) -> float:
        """Weighted sum of squares over the points seen; infinite when one of them is lost."""
        vector = self.right(residuals, seen, values)
        total = float(vector @ vector)
        return total if np.isfinite(total) else float("inf")

    def design(self, model: SensorModel, seen: BoolArray) -> FloatArray:
        by_parameters = jacobian(model, self.xyz[seen])[0][:, :, self.free] * self.weights[seen][:, :, None]
        image = by_parameters.reshape(-1, by_parameters.shape[2])
        image[~np.isfinite(image).all(axis=1)] = 0.0  # a difference that left the visible part pulls at nothing
        priors = np.eye(image.shape[1])[self.prior] / self.sigmas[self.free][self.prior][:, None]
        return np.vstack([image, priors])

    def need_enough(self, seen: BoolArray) -> None:
        unknowns, observations = int(np.count_nonzero(self.free)), 2 * int(seen.sum()) + int(self.prior.sum())
        if unknowns == 0:
            raise SolveError("every parameter is held fixed: nothing to estimate")
        if not seen.any():
            raise SolveError(
                "the model sees none of the points where it starts",
                hint="check the order of coordinates, the CRS of the points and the start values",
            )
        if observations < unknowns:
            names = ", ".join(np.array(self.names)[self.free])
            points = counted(int(seen.sum()), "point")
            verb = "gives" if points == "1 point" else "give"
            raise SolveError(
                f"{points} {verb} {observations} observations for {unknowns} unknowns ({names})",
                hint=f"give at least {-(-(unknowns - int(self.prior.sum())) // 2)} points, or fix parameters",
            )

    def need_determined(self, design: FloatArray) -> None:
        """Refuse a design whose columns depend on each other, and name the parameters concerned."""
        names = np.array(self.names)[self.free]
        length = np.linalg.norm(design, axis=0)
        # Steps move the image by about a pixel, so the effect of a step says whether a parameter acts at all.
        dead = ~(length * self.steps > 1e-9 * np.max(length * self.steps))
        if dead.any():
            raise SolveError(
                f"the points say nothing about {', '.join(names[dead])}",
                hint="fix these parameters (sigma 0) or give points that depend on them",
            )
        _, singular, right = np.linalg.svd(design / length, full_matrices=False)
        if singular[-1] * WORST_CONDITION < singular[0]:
            together = names[np.abs(right[-1]) > 0.1]
            raise SolveError(
                f"the points cannot tell {', '.join(together)} apart (condition {_ratio(singular):.1e})",
                hint="spread the points over the image and over height, add points, or fix parameters",
            )

    def result(
        self, model: Model, residuals: FloatArray, seen: BoolArray, values: FloatArray, iterations: int
    ) -> Resection[Model]:
        design = self.design(model, seen)
        length = np.linalg.norm(design, axis=0)
        _, singular, right = np.linalg.svd(design / length, full_matrices=False)
        root = right.T / singular
        cofactors = (root @ root.T) / np.outer(length, length)
        redundancy = 2 * int(seen.sum()) + int(self.prior.sum()) - design.shape[1]
        cost = self.cost(residuals, seen, values)
        sigma0 = float(np.sqrt(cost / redundancy)) if redundancy > 0 else float("nan")
        if not self.known_sigmas:
            cofactors = cofactors * sigma0**2
        covariance = np.zeros((len(self.names), len(self.names)))
        covariance[np.ix_(self.free, self.free)] = cofactors
        left = np.where(seen[:, None], residuals, np.nan)
        sigmas = np.sqrt(np.diag(covariance))
        return Resection(model, sigmas, covariance, left, sigma0, redundancy, iterations, _ratio(singular))


def _seen(residuals: FloatArray) -> BoolArray:
    seen: BoolArray = np.isfinite(residuals.sum(axis=1))
    return seen


def _ratio(singular: FloatArray) -> float:
    return float(singular[0] / singular[-1]) if singular[-1] > 0.0 else float("inf")
