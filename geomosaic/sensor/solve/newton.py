"""Derivatives of the image, in closed form or by differences, and damped Newton iterations for many pairs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from geomosaic.geo.crs import in_degrees
from geomosaic.sensor.plugin import HasGroundJacobian, HasJacobian, SensorModel
from geomosaic.types import BoolArray, FloatArray, IntArray


def jacobian(model: SensorModel, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Derivatives of (col, row) at ground points.

    Parameters
    ----------
    model : SensorModel
    xyz : array (N, 3)
        Ground points in `model.crs`.

    Returns
    -------
    by_parameters : array (N, 2, P)
        Pixels per unit of each parameter.
    by_ground : array (N, 2, 3)
        Pixels per unit of `model.crs`. Both are NaN at points the model cannot see.
    """
    points = np.asarray(xyz, dtype=np.float64)
    if isinstance(model, HasJacobian):
        return model.jacobian(points)
    return difference_jacobian(model, points)


def ground_jacobian(model: SensorModel, xyz: FloatArray) -> FloatArray:
    """Derivatives (N, 2, 3) of (col, row) by ground coordinates; see `jacobian`.

    Parameters
    ----------
    model : SensorModel
    xyz : array (N, 3)
        Ground points in `model.crs`.
    """
    points = np.asarray(xyz, dtype=np.float64)
    return model.ground_jacobian(points) if isinstance(model, HasGroundJacobian) else jacobian(model, points)[1]


def difference_jacobian(model: SensorModel, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Derivatives of the image by parameters and by ground, by central differences over one pixel.

    Parameters
    ----------
    model : SensorModel
    xyz : array (N, 3)
        Ground points in `model.crs`.

    Returns
    -------
    by_parameters : array (N, 2, P)
        Pixels per unit of each parameter.
    by_ground : array (N, 2, 3)
        Pixels per unit of `model.crs`.
    """
    # The judge of closed forms: it uses none, whatever the model has. One pixel balances both errors of a difference:
    # curvature over a pixel is about 1e-8 of the derivative, and rounding of pixel coordinates about 1e-12 of it.
    points = np.asarray(xyz, dtype=np.float64)
    parameters = model.parameters
    by_parameters = np.empty((len(points), 2, len(parameters)))
    for index, step in enumerate(parameters.steps):
        high, low = parameters.values.copy(), parameters.values.copy()
        high[index] += 0.5 * step
        low[index] -= 0.5 * step
        change = model.with_values(high).ground_to_image(points) - model.with_values(low).ground_to_image(points)
        # Over the difference of the numbers as they are stored, not over the step, which rounding may have changed.
        by_parameters[:, :, index] = change / (high[index] - low[index])
    by_ground = np.empty((len(points), 2, 3))
    across = _ground_step(model)
    # One pixel in height too where x and y are degrees: a metre is about 1e-5 of them.
    upwards = 1e5 * across if in_degrees(model.crs) else across
    for axis, step in enumerate((across, across, upwards)):
        above, below = points.copy(), points.copy()
        above[:, axis] += 0.5 * step
        below[:, axis] -= 0.5 * step
        change = model.ground_to_image(above) - model.ground_to_image(below)
        by_ground[:, :, axis] = change / (above[:, axis] - below[:, axis])[:, None]
    return by_parameters, by_ground


def _ground_step(model: SensorModel) -> float:
    """Length on the ground that moves the image by about one pixel near the model's seed."""
    first = 1e-5 if in_degrees(model.crs) else 1.0
    return pixel_step(model.ground_to_image, np.asarray(model.seed, dtype=np.float64), first)


def pixel_step(evaluate: Callable[[FloatArray], FloatArray], centre: FloatArray, first: float) -> float:
    """Change of a coordinate that moves the image by about one pixel.

    Parameters
    ----------
    evaluate : callable
        Ground (M, D) to image (M, 2).
    centre : array (D,)
        A ground point the image shows.
    first : float
        First guess.
    """
    # Measured along all axes and taken from the one that moves the image most, because a line of sight may run along
    # one of them, and a planar model ignores heights.
    step = first
    for _ in range(4):
        image = evaluate(np.vstack([centre, centre + step * np.eye(len(centre))]))
        moved = np.linalg.norm(image[1:] - image[0], axis=1)
        moved = moved[np.isfinite(moved)]
        if not len(moved) or moved.max() == 0.0:
            step *= 1e-2  # the step may leave what the model can see
        # Within a factor of two is near enough: differences are flat about their best step.
        elif 0.5 < moved.max() < 2.0:
            break
        else:
            step /= float(moved.max())
    return step


# Newton steps at most: a few suffice as a rule; lines of sight near the horizon need more.
ROUNDS = 60
# Halvings of a step at most: the last one tries a 2000th of it.
HALVINGS = 12
# Residual in pixels at which a row stops: rounding of coordinates of some 10 000 pixels leaves about 1e-12.
GOAL = 1e-10
# Residual in pixels of a solution: what the contract of sensor models promises of the inverse.
ACCEPTED = 1e-6
# Residual in pixels that is good enough on the way to a solution.
ROUGHLY = 1e-2


def solve_pairs(
    evaluate: Callable[[FloatArray, IntArray], FloatArray],
    target: FloatArray,
    start: FloatArray,
    step: float,
) -> FloatArray:
    """Solutions xy of evaluate(xy) = target, for each row by itself.

    Parameters
    ----------
    evaluate : callable
        xy (M, 2) and the row numbers (M,) they belong to, to values (M, 2); NaN where undefined.
    target : array (N, 2)
        Wanted values (pixels).
    start : array (N, 2)
        First guesses.
    step : float
        Change of xy that moves the values by about one pixel, for the forward differences.

    Returns
    -------
    array (N, 2)
        NaN where no solution was found to `ROUGHLY`: the start is undefined, or there is none.

    Notes
    -----
    A step is halved while it makes the residual longer or leaves the domain, so a line of sight near the horizon or
    a point that would jump behind the camera still converges. Rows stop when their residual reaches rounding.
    """
    xy = np.array(start, dtype=np.float64)
    error = np.full(len(xy), np.inf)
    residual = np.full_like(xy, np.nan)
    rows = np.flatnonzero(np.isfinite(xy).all(axis=1) & np.isfinite(target).all(axis=1))
    if len(rows):
        residual[rows] = target[rows] - evaluate(xy[rows], rows)
        error[rows] = _length(residual[rows])
    # Rows whose start is undefined drop out at once: no direction can be had from NaN.
    rows = rows[np.isfinite(error[rows])]
    for _ in range(ROUNDS):
        rows = rows[error[rows] > GOAL]
        if not len(rows):
            break
        change = _newton_step(evaluate, xy[rows], rows, target[rows] - residual[rows], residual[rows], step)
        last = error[rows] <= ACCEPTED  # a step from here ends in rounding: no use in another
        improved = _damped(evaluate, target, xy, residual, error, rows, change)
        rows = rows[improved & ~last]
    xy[~(error <= ROUGHLY)] = np.nan
    return xy


def _newton_step(
    evaluate: Callable[[FloatArray, IntArray], FloatArray],
    xy: FloatArray,
    rows: IntArray,
    value: FloatArray,
    residual: FloatArray,
    step: float,
) -> FloatArray:
    """Newton steps (M, 2) by forward differences; NaN where singular."""
    columns = []
    for axis in range(2):
        moved = xy.copy()
        moved[:, axis] += step
        ahead = evaluate(moved, rows)
        lost = ~np.isfinite(ahead).all(axis=1)
        width = moved[:, axis] - xy[:, axis]
        if lost.any():  # at the edge of what can be seen: look the other way
            moved[lost, axis] = xy[lost, axis] - step
            ahead[lost] = evaluate(moved[lost], rows[lost])
            width = moved[:, axis] - xy[:, axis]
        columns.append((ahead - value) / width[:, None])
    (a, c), (b, d) = columns[0].T, columns[1].T
    with np.errstate(divide="ignore", invalid="ignore"):
        # Cramer's rule: for so many 2 x 2 systems a call of a solver for each costs far more than these products.
        determinant = a * d - b * c
        x = (d * residual[:, 0] - b * residual[:, 1]) / determinant
        y = (a * residual[:, 1] - c * residual[:, 0]) / determinant
    return np.column_stack([x, y])


def _damped(
    evaluate: Callable[[FloatArray, IntArray], FloatArray],
    target: FloatArray,
    xy: FloatArray,
    residual: FloatArray,
    error: FloatArray,
    rows: IntArray,
    change: FloatArray,
) -> BoolArray:
    """Rows that got better by the steps, which are taken in place, halved where needed."""
    improved = np.zeros(len(rows), dtype=bool)
    waiting = np.flatnonzero(np.isfinite(change).all(axis=1))
    factor = 1.0
    for _ in range(HALVINGS):
        if not len(waiting):
            break
        which = rows[waiting]
        trial = xy[which] + factor * change[waiting]
        left = target[which] - evaluate(trial, which)
        # NaN compares false, so a trial that leaves the domain counts as worse and is halved.
        length = _length(left)
        good = length < error[which]
        taken = which[good]
        xy[taken], residual[taken], error[taken] = trial[good], left[good], length[good]
        improved[waiting[good]] = True
        # Below a millionth of a pixel a failing step is rounding, not a wrong direction: no use in halving.
        waiting = waiting[~good & (error[which] > ACCEPTED)]
        factor *= 0.5
    return improved


def _length(residual: FloatArray) -> FloatArray:
    return np.hypot(residual[:, 0], residual[:, 1])
