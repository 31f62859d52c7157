"""The corrections of an image's values, whatever their kind: applied on a coarse grid, and continued."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geomosaic.geo.grid import Grid, Window
from geomosaic.radiometry.gain_offset import Balance
from geomosaic.radiometry.histogram_matching import Curve
from geomosaic.radiometry.local_gains import Shade
from geomosaic.resample.warp import Colour
from geomosaic.types import AnyArray, FloatArray

Correction = Colour | Curve | Shade


def corrections(solved: Balance) -> Sequence[Correction]:
    """What a balance does to each image."""
    plain = [Colour(gain, offset) for gain, offset in zip(solved.gain, solved.offset, strict=True)]
    return solved.curves or plain


def then(own: Correction, gain: float, offset: float) -> Correction:
    """Gain · corrected + offset, in all bands."""
    if isinstance(own, Shade):
        bands = len(own.dark)
        return own.then(np.full(bands, gain), np.full(bands, offset))
    if isinstance(own, Curve):
        return replace(own, knots=[(x, y * gain + offset) for x, y in own.knots], slope=own.slope * gain)
    return Colour(own.gain * gain, own.offset * gain + offset)


def corrected(own: Correction, values: AnyArray, window: Window, coarse: Grid, output: Grid) -> FloatArray:
    """Correct values (rows, cols, bands) of a window of a grid coarser than the output."""
    if isinstance(own, Shade):
        factor = coarse.resolution[0] / output.resolution[0]
        cols = factor * np.arange(window.col + 0.5, window.stop_col, dtype=np.float64)
        rows = factor * np.arange(window.row + 0.5, window.stop_row, dtype=np.float64)
        return own(values, cols, rows)
    return np.asarray(own(values) if isinstance(own, Curve) else values * own.gain + own.offset)
