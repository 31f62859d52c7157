"""Closed-form derivatives of a sensor model held against extrapolated differences of its image."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np

from geomosaic.geo.crs import in_degrees
from geomosaic.sensor.plugin import HasInterior, Parameters, SensorModel
from geomosaic.sensor.solve.newton import pixel_step
from geomosaic.types import FloatArray

# Pixels of the differences. Narrower ones lose to rounding, as Earth-centred coordinates are rounded to a nanometre:
# 1e-7 of a pixel of a centimetre. Wider ones lose to curvature, and two rounds of extrapolation leave its sixth order.
WIDTHS = (8.0, 4.0, 2.0, 1.0)
# Relative uncertainty of a difference from which on it judges nothing: it lies across a kink.
BLUNT = 1e-5
# Least effect of a step in pixels; a column that is smaller is measured against this.
LEAST = 0.01


def parameter_errors(model: SensorModel, ground: FloatArray, closed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Errors of derivatives by the parameters; see `_errors`.

    Parameters
    ----------
    model : SensorModel
    ground : array (N, 3)
        Visible points in `model.crs`.
    closed : array (N, 2, P)
        Derivatives to be judged, pixels per unit.

    Returns
    -------
    errors, uncertainties : array (N, P)
    """
    return _by_values(lambda values: model.with_values(values), model.parameters, ground, closed)


def interior_errors(model: HasInterior, ground: FloatArray, closed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Errors of derivatives by the interior orientation; see `_errors`.

    Parameters
    ----------
    model : HasInterior
        A sensor model.
    ground : array (N, 3)
        Visible points in its CRS.
    closed : array (N, 2, Q)
        Derivatives to be judged, pixels per unit.

    Returns
    -------
    errors, uncertainties : array (N, Q)
    """
    interior = model.interior
    return _by_values(lambda values: model.with_interior(interior.with_values(values)), interior, ground, closed)


def ground_errors(model: SensorModel, ground: FloatArray, closed: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Errors of derivatives by the ground; see `_errors`.

    Parameters
    ----------
    model : SensorModel
    ground : array (N, 3)
        Visible points in `model.crs`.
    closed : array (N, 2, 3)
        Derivatives to be judged, pixels per unit.

    Returns
    -------
    errors, uncertainties : array (N, 3)
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

        columns.append(_errors(moved, step, closed[:, :, axis]))
    return _stacked(columns)


def _by_values(
    changed: Callable[[FloatArray], object], parameters: Parameters, ground: FloatArray, closed: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Errors (N, P) and uncertainties (N, P) of derivatives by parameters that give a changed model."""
    columns = []
    for index, step in enumerate(parameters.steps):

        def moved(by: float, index: int = index) -> tuple[FloatArray, FloatArray]:
            values = parameters.values.copy()
            values[index] += by
            model = changed(values)
            assert isinstance(model, SensorModel)
            return model.ground_to_image(ground), np.full(len(ground), values[index])

        columns.append(_errors(moved, step, closed[:, :, index]))
    return _stacked(columns)


def _stacked(columns: list[tuple[FloatArray, FloatArray]]) -> tuple[FloatArray, FloatArray]:
    errors, uncertainties = (np.column_stack(part) for part in zip(*columns, strict=True))
    return errors, uncertainties


def _errors(
    moved: Callable[[float], tuple[FloatArray, FloatArray]], step: float, closed: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Errors of one column (N, 2), and uncertainties of the differences, as shares of its largest value, (N,) each.

    Central differences over three widths, extrapolated to none (Romberg); what extrapolations differ by is uncertain.
    """
    central = []
    for width in WIDTHS:
        (high, above), (low, below) = moved(0.5 * width * step), moved(-0.5 * width * step)
        # Over the difference of the numbers as they are stored, which rounding may have changed.
        central.append((high - low) / (above - below)[:, None])
    wide, middle, narrow = ((4.0 * b - a) / 3.0 for a, b in pairwise(central))
    # The narrowest is the least disturbed by tables, through which a curve bends from node to node. Three of them,
    # as two may agree by chance.
    uncertain = np.maximum(np.abs(middle - wide), np.abs(narrow - middle)).max(axis=1)
    scale = max(float(np.abs(narrow).max()), LEAST / step)
    return np.abs(closed - narrow).max(axis=1) / scale, uncertain / scale


def wrong_columns(errors: FloatArray, uncertainties: FloatArray, tolerance: float) -> FloatArray:
    """Largest error of each column that is beyond the tolerance, beside what the differences may be off; else 0.

    Parameters
    ----------
    errors, uncertainties : array (N, P)
    tolerance : float
        Relative.

    Returns
    -------
    array (P,)
        NaN where fewer than half of the differences could judge.
    """
    sharp = uncertainties <= BLUNT
    beyond = np.where(sharp & ~(errors <= tolerance + uncertainties), errors, 0.0).max(axis=0)
    return np.where(2 * sharp.sum(axis=0) < len(errors), np.nan, beyond)
