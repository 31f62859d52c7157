"""Leave-one-out errors of a fit to control points, in closed form where the model allows it, else by refits."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

import numpy as np

from geomosaic.errors import GeomosaicError
from geomosaic.estimation.equations import Equations
from geomosaic.estimation.problem import Unknowns
from geomosaic.estimation.statistics import Cofactors
from geomosaic.orientation.single.problem import ControlProblem
from geomosaic.sensor.model import SensorModel
from geomosaic.sensor.solve.derivatives import jacobian
from geomosaic.types import BoolArray, FloatArray, IntArray


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


def is_linear(model: SensorModel, xyz: FloatArray) -> bool:
    """Whether the image is linear in the free parameters, from the Jacobian at other values of them.

    Parameters
    ----------
    model : SensorModel
    xyz : array (N, 3)
        Places in the CRS of the model.
    """
    parameters = model.parameters
    free = parameters.sigmas > 0.0
    # Steps of unlike size and sign, so that changes of the Jacobian do not cancel.
    turns = np.where(np.arange(len(parameters)) % 2, 3.0, -2.0) * free
    other = model.with_values(parameters.values + turns * parameters.steps)
    change = jacobian(other, xyz)[0] - jacobian(model, xyz)[0]
    return bool(np.abs(change * parameters.steps)[:, :, free].max(initial=0.0) < 1e-9)


MOST_REFITS = 200
"""Points without a closed form that are all refitted."""
SAMPLE = 100
"""Points that are refitted where there are more."""
FEW = 40
"""Points up to which a model that is not linear is refitted; beyond, one of them bends it too little to matter."""


@runtime_checkable
class HasOmission(Protocol):
    """Optional power of a model that passes through its points: their leave-one-out errors in closed form."""

    def omission(self) -> FloatArray | None:
        """Measured minus computed (col, row) (N, 2) of each point under the model of all others, in the order of the
        points it was built from, pixels; None where the model, of another kind, has no closed form.
        """


def leave_one_out(problem: ControlProblem, model: SensorModel, residuals: FloatArray, found: Cofactors) -> FloatArray:
    """Errors of points under fits to all the others.

    In closed form, (I − H_ii)⁻¹ v_i, where the model is linear in its parameters, or more than 40 points hold its
    linearisation; by refits where it is not, and where a point has no residual because the fit passes through it and
    the model has no closed form of its own. Of more than 200 such points 100, evenly drawn, are refitted.

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
    own = model.omission() if isinstance(model, HasOmission) else None
    if own is not None:
        return own
    errors = found.leave_one_out(residuals)
    closed: BoolArray = np.isfinite(errors.sum(axis=1))
    # The closed form holds the linearisation; with few points one of them moves it.
    if not is_linear(model, problem.xyz) and len(problem) <= FEW:
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
