"""Leave-one-out errors, cofactors and redundancy numbers of a least-squares fit.

With weighted design A (2N, P), residuals v = (I − H) e, where H = A (AᵀA)⁻¹ Aᵀ, so the cofactors of the residuals are
Q_vv = I − H; its diagonal holds the redundancy numbers (Förstner 1979). Without point i its residual would be
(I − H_ii)⁻¹ v_i, H_ii being the point's 2 × 2 block (Cook and Weisberg 1982, for two observations at a time).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from geomosaic.errors import GeomosaicError, SolveError
from geomosaic.orientation.single.problem import Problem
from geomosaic.sensor.model import SensorModel
from geomosaic.sensor.solve.derivatives import jacobian
from geomosaic.types import BoolArray, FloatArray, IntArray

SINGULAR = 1e-12
HELD = 1e-7
"""Redundancy below which an observation is not checked by others."""


@dataclass(frozen=True, eq=False)
class Cofactors:
    """Cofactors at a fitted model.

    Attributes
    ----------
    parameters : array (P, P)
        Cofactors of the parameters; 0 for those held fixed.
    hat : array (N, 2, 2)
        Blocks H_ii of the weighted hat matrix.
    redundancy : int
        Observations, a-priori values of parameters among them, minus free parameters.
    """

    parameters: FloatArray
    hat: FloatArray
    redundancy: int

    @property
    def numbers(self) -> FloatArray:
        """Redundancy numbers (N, 2) of columns and rows, 0 (nothing checks it) to 1."""
        own: FloatArray = 1.0 - np.diagonal(self.hat, axis1=1, axis2=2)
        return np.where(own > HELD, own, 0.0)

    @property
    def checked(self) -> FloatArray:
        """Inverse blocks (I − H_ii)⁻¹ (N, 2, 2); NaN where other points do not check a point in both axes."""
        own = np.eye(2) - self.hat
        values, turns = np.linalg.eigh(own)
        held = values[:, 0] <= HELD
        inverse: FloatArray = np.einsum("nij,nj,nkj->nik", turns, 1.0 / np.where(held[:, None], 1.0, values), turns)
        inverse[held] = np.nan
        return inverse


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
    given = model.parameters.sigmas
    free = given > 0.0
    design = jacobian(model, xyz)[0][:, :, free] / sigma[:, None, None]
    count = design.shape[2]
    observed = np.isfinite(given[free])
    priors = np.eye(count)[observed] / given[free][observed][:, None]
    rows = np.vstack([design.reshape(-1, count), priors])
    if count == 0:
        return Cofactors(np.zeros((len(given), len(given))), np.zeros((len(xyz), 2, 2)), len(rows))
    length = np.linalg.norm(rows, axis=0)
    length = np.where(length > 0.0, length, 1.0)
    left, singular, turned = np.linalg.svd(rows / length, full_matrices=False)
    if len(rows) < count or not singular[-1] > SINGULAR * singular[0]:
        raise SolveError("the control points do not determine the parameters of the model", hint="add points")
    root = turned.T / singular
    whole = np.zeros((len(given), len(given)))
    whole[np.ix_(free, free)] = (root @ root.T) / np.outer(length, length)
    blocks = left[: 2 * len(xyz)].reshape(len(xyz), 2, count)
    return Cofactors(whole, np.einsum("nip,njp->nij", blocks, blocks), len(rows) - count)


def is_linear(model: SensorModel, xyz: FloatArray) -> bool:
    """Say whether the image is linear in the free parameters, from the Jacobian at other values of them."""
    parameters = model.parameters
    free = parameters.sigmas > 0.0
    turns = np.where(np.arange(len(parameters)) % 2, 3.0, -2.0) * free
    other = model.with_values(parameters.values + turns * parameters.steps)
    change = jacobian(other, xyz)[0] - jacobian(model, xyz)[0]
    return bool(np.abs(change * parameters.steps)[:, :, free].max(initial=0.0) < 1e-9)


MOST_REFITS = 200
SAMPLE = 100
FEW = 40
"""Points up to which a model that is not linear is refitted; beyond, one of them bends it too little to matter."""


@runtime_checkable
class HasOmission(Protocol):
    """Optional power of a model that passes through its points: their leave-one-out errors in closed form."""

    def omission(self) -> FloatArray | None:
        """Measured minus computed (col, row) (N, 2) of each point under the model of all others, in the order of the
        points it was built from, pixels; None where the model, of another kind, has no closed form.
        """


def leave_one_out(problem: Problem, model: SensorModel, residuals: FloatArray, found: Cofactors) -> FloatArray:
    """Errors of points under fits to all the others.

    In closed form, (I − H_ii)⁻¹ v_i, where the model is linear in its parameters, or more than 40 points hold its
    linearisation; by refits where it is not, and where a point has no residual because the fit passes through it and
    the model has no closed form of its own. Of more than 200 such points 100, evenly drawn, are refitted.

    Parameters
    ----------
    problem : Problem
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
    own = model.omission() if isinstance(model, HasOmission) else None
    if own is not None:
        return own
    inverse = found.checked
    errors: FloatArray = np.einsum("nij,nj->ni", inverse, residuals)
    closed: BoolArray = np.isfinite(errors.sum(axis=1))
    if not is_linear(model, problem.xyz) and len(problem) <= FEW:
        closed[:] = False
    left = np.flatnonzero(~closed)
    errors[left] = np.nan
    if len(left) > MOST_REFITS:
        left = left[np.linspace(0, len(left) - 1, SAMPLE).astype(np.int64)]
    for index in left:
        errors[index] = _without(problem, int(index))
    return errors


def _without(problem: Problem, index: int) -> FloatArray:
    others: IntArray = np.delete(np.arange(len(problem)), index)
    try:
        model = problem.model(others)
    except GeomosaicError:
        return np.full(2, np.nan)
    error: FloatArray = problem.colrow[index] - model.ground_to_image(problem.xyz[[index]])[0]
    return error
