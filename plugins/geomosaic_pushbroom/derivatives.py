"""Derivatives of a scanner's image by implicit differentiation: the row is held while a parameter moves."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geomosaic.types import FloatArray

if TYPE_CHECKING:
    from geomosaic_pushbroom.model import PushbroomModel


def derivatives(model: PushbroomModel, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Derivatives of (col, row) by parameters (N, 2, P) and by ground coordinates (N, 2, 3), pixels per unit.

    With the column c and the misfit m as seen from a given row, m(p, row) = 0 defines the row, so

        d row / dp = −(∂m/∂p) / (∂m/∂row),     d col / dp = ∂c/∂p + ∂c/∂row · d row / dp

    The partial derivatives are central differences over one pixel, which need no search for rows.
    """
    rows = model.ground_to_image(xyz)[:, 1]
    by_row = _difference(model, model, xyz, xyz, rows + 0.5, rows - 0.5, 1.0)
    parameters = model.parameters
    by_values = np.empty((len(xyz), 2, len(parameters)))
    for index, step in enumerate(parameters.steps):
        high, low = parameters.values.copy(), parameters.values.copy()
        high[index] += 0.5 * step
        low[index] -= 0.5 * step
        change = _difference(
            model.with_values(high), model.with_values(low), xyz, xyz, rows, rows, high[index] - low[index]
        )
        by_values[:, :, index] = _total(change, by_row)
    by_ground = np.empty((len(xyz), 2, 3))
    step = abs(1.0 / max(float(np.abs(model.guess[1:4]).max()), 1e-9))  # about a pixel along the flight
    for axis in range(3):
        above, below = xyz.copy(), xyz.copy()
        above[:, axis] += 0.5 * step
        below[:, axis] -= 0.5 * step
        by_ground[:, :, axis] = _total(_difference(model, model, above, below, rows, rows, step), by_row)
    return by_values, by_ground


def _difference(
    high: PushbroomModel,
    low: PushbroomModel,
    above: FloatArray,
    below: FloatArray,
    late: FloatArray,
    early: FloatArray,
    width: float,
) -> tuple[FloatArray, FloatArray]:
    """Differences of column and misfit (N,) between two models, points and rows, over `width`."""
    (col_high, miss_high), (col_low, miss_low) = high.seen_from(above, late), low.seen_from(below, early)
    return (col_high - col_low) / width, (miss_high - miss_low) / width


def _total(change: tuple[FloatArray, FloatArray], by_row: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Derivatives of col and row (N, 2) from those at a held row."""
    row = -change[1] / by_row[1]
    return np.column_stack([change[0] + by_row[0] * row, row])
