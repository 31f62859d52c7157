"""Derivatives of the image by parameters and by ground, in closed form or by differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from geomosaic.geo.crs import in_degrees
from geomosaic.sensor.model import HasJacobian, SensorModel
from geomosaic.types import FloatArray


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
