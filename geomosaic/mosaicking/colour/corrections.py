"""Corrections of an image's values, of any kind: applied on a coarse grid, and followed by a gain and an offset."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geomosaic.geo.grid import Grid, Window
from geomosaic.radiometry.gain_offset import Balance
from geomosaic.radiometry.histogram_matching import ToneCurve
from geomosaic.radiometry.local_gains import CorrectionField
from geomosaic.resample.warp import Colour
from geomosaic.types import AnyArray, FloatArray

Correction = Colour | ToneCurve | CorrectionField


def corrections(solved: Balance) -> Sequence[Correction]:
    """Corrections of all images in a balance."""
    plain = [Colour(gain, offset) for gain, offset in zip(solved.gain, solved.offset, strict=True)]
    return solved.curves or plain


def with_gain_offset(correction: Correction, gain: float, offset: float) -> Correction:
    """Correction followed by gain · value + offset, in all bands."""
    if isinstance(correction, CorrectionField):
        bands = len(correction.dark)
        return correction.then(np.full(bands, gain), np.full(bands, offset))
    if isinstance(correction, ToneCurve):
        return replace(
            correction, knots=[(x, y * gain + offset) for x, y in correction.knots], slope=correction.slope * gain
        )
    return Colour(correction.gain * gain, correction.offset * gain + offset)


def corrected(correction: Correction, values: AnyArray, window: Window, coarse: Grid, output: Grid) -> FloatArray:
    """Corrected values of a window of a grid coarser than the output.

    Parameters
    ----------
    correction : Correction
    values : array (rows, cols, bands)
    window : Window
        Of the coarse grid.
    coarse, output : Grid
        With the same upper left corner; gains by place are laid out over the output.

    Returns
    -------
    array (rows, cols, bands)
    """
    if isinstance(correction, CorrectionField):
        factor = coarse.resolution[0] / output.resolution[0]
        cols = factor * np.arange(window.col + 0.5, window.stop_col, dtype=np.float64)
        rows = factor * np.arange(window.row + 0.5, window.stop_row, dtype=np.float64)
        return correction(values, cols, rows)
    return np.asarray(
        correction(values) if isinstance(correction, ToneCurve) else values * correction.gain + correction.offset
    )
