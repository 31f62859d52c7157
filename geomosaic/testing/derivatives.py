"""Closed-form derivatives of a sensor model held against extrapolated differences of its image."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from geomosaic.geo.crs import in_degrees
from geomosaic.sensor.plugin import HasInterior, Parameters, SensorModel
from geomosaic.sensor.solve.newton import pixel_step
from geomosaic.types import FloatArray

# Widths of the differences in pixels. Smooth images are judged best by the wide ones, as Earth-centred coordinates are
# rounded to a nanometre, 1e-7 of a pixel of a centimetre. Where tables bend from node to node, only differences between
# two nodes tell the slope: wider ones take the mean of many (2e-7 off for an aircraft that rocks, five poses a row).
WIDTHS = ((32.0, 16.0, 8.0, 4.0), (4.0, 2.0, 1.0, 0.5), (0.25, 0.125, 0.0625, 0.03125))
# Least effect of a step in pixels; a column that is smaller is measured against this.
LEAST = 0.01


def parameter_errors(model: SensorModel, ground: FloatArray, closed: FloatArray, tolerance: float) -> FloatArray:
    """Largest error of the derivatives by each parameter, as a share of the largest of its column.

    Parameters
    ----------
    model : SensorModel
    ground : array (N, 3)
        Visible points in `model.crs`.
    closed : array (N, 2, P)
        Derivatives to be judged, pixels per unit.
    tolerance : float
        Relative, of them and of the differences.

    Returns
    -------
    array (P,)
        0 where all are within the tolerance; NaN where no differences are that certain for half of the points.
    """
    return _by_values(lambda values: model.with_values(values), model.parameters, ground, closed, tolerance)


def interior_errors(model: HasInterior, ground: FloatArray, closed: FloatArray, tolerance: float) -> FloatArray:
    """Largest error of the derivatives by each parameter of the interior, as a share of the largest of its column.

    Parameters
    ----------
    model : HasInterior
        A sensor model.
    ground : array (N, 3)
        Visible points in its CRS.
    closed : array (N, 2, Q)
        Derivatives to be judged, pixels per unit.
    tolerance : float
        Relative, of them and of the differences.

    Returns
    -------
    array (Q,)
        0 where all are within the tolerance; NaN where no differences are that certain for half of the points.
    """
    interior = model.interior
    return _by_values(
        lambda values: model.with_interior(interior.with_values(values)), interior, ground, closed, tolerance
    )


def ground_errors(model: SensorModel, ground: FloatArray, closed: FloatArray, tolerance: float) -> FloatArray:
    """Largest error of the derivatives by each ground coordinate, as a share of the largest of its column.

    Parameters
    ----------
    model : SensorModel
    ground : array (N, 3)
        Visible points in `model.crs`.
    closed : array (N, 2, 3)
        Derivatives to be judged, pixels per unit.
    tolerance : float
        Relative, of them and of the differences.

    Returns
    -------
    array (3,)
        0 where all are within the tolerance; NaN where no differences are that certain for half of the points.
    """
    degrees = in_degrees(model.crs)
    across = pixel_step(model.ground_to_image, np.asarray(model.seed, dtype=np.float64), 1e-5 if degrees else 1.0)
    # One pixel in height too where x and y are degrees: a metre is about 1e-5 of them.
    steps = np.array([across, across, 1e5 * across if degrees else across])
    columns = []
    for axis, step in enumerate(steps):

        def moved(by: float, axis: int = axis) -> tuple[FloatArray, FloatArray]:
            points = np.array(ground, dtype=np.float64)
            points[:, axis] += by
            return model.ground_to_image(points), points[:, axis]

        columns.append(_largest_error(moved, step, closed[:, :, axis], tolerance))
    return np.array(columns)


def _by_values(
    changed: Callable[[FloatArray], object],
    parameters: Parameters,
    ground: FloatArray,
    closed: FloatArray,
    tolerance: float,
) -> FloatArray:
    """Largest errors (P,) of derivatives by parameters that give a changed model."""
    columns = []
    for index, step in enumerate(parameters.steps):

        def moved(by: float, index: int = index) -> tuple[FloatArray, FloatArray]:
            values = parameters.values.copy()
            values[index] += by
            model = changed(values)
            assert isinstance(model, SensorModel)
            return model.ground_to_image(ground), np.full(len(ground), values[index])

        columns.append(_largest_error(moved, step, closed[:, :, index], tolerance))
    return np.array(columns)


def _largest_error(
    moved: Callable[[float], tuple[FloatArray, FloatArray]], step: float, closed: FloatArray, tolerance: float
) -> float:
    """Largest relative error of one column (N, 2), 0 if within the tolerance; NaN where differences cannot judge."""
    least = np.full(len(closed), np.inf)
    for widths in WIDTHS:
        error, uncertain = _errors(moved, step, closed, widths)
        # A difference judges what it is itself certain of; NaN, of a closed form too, stays.
        least = np.where(uncertain <= tolerance, np.minimum(least, error), least)
        if (least <= tolerance).all():
            return 0.0
    judged = ~np.isinf(least)
    if 2 * judged.sum() < len(closed):
        return float("nan")
    return float(np.where(judged & ~(least <= tolerance), least, 0.0).max())


def _errors(
    moved: Callable[[float], tuple[FloatArray, FloatArray]],
    step: float,
    closed: FloatArray,
    widths: tuple[float, ...],
) -> tuple[FloatArray, FloatArray]:
    """Errors of one column (N, 2), and uncertainties of the differences, as shares of its largest value, (N,) each.

    Central differences extrapolated to no width (Romberg); what extrapolations differ by is uncertain.
    """
    central = []
    for width in widths:
        (high, above), (low, below) = moved(0.5 * width * step), moved(-0.5 * width * step)
        # Over the difference of the numbers as they are stored, which rounding may have changed.
        central.append((high - low) / (above - below)[:, None])
    wide, middle, narrow = ((4.0 * b - a) / 3.0 for a, b in pairwise(central))
    # Three of them, as two may agree by chance.
    uncertain = np.maximum(np.abs(middle - wide), np.abs(narrow - middle)).max(axis=1)
    scale = max(float(np.nanmax(np.abs(middle), initial=0.0)), LEAST / step)
    return np.abs(closed - middle).max(axis=1) / scale, uncertain / scale
