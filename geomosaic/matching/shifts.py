"""Shifts of the same ground between two images on one grid, tile by tile.

Whole pixels come from the peak of the normalised cross-correlation, fractions from least-squares matching (Förstner
1982; Gruen 1985) with two shifts, gain and offset.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.types import AnyArray, BoolArray, FloatArray

_SHIFT_ITERATIONS = 12
# Step in pixels at which the iteration ends.
_SHIFT_CONVERGED = 1e-3


@dataclass(frozen=True)
class Shifts:
    """Shifts of tiles between two images.

    Attributes
    ----------
    places : array (N, 2)
        (col, row) of the tiles' centres.
    shifts : array (N, 2)
        (col, row) of the second image's content minus the first's, in pixels; NaN where nothing matched.
    correlation : array (N,)
        Of the matched tiles, 0 to 1.
    """

    places: FloatArray
    shifts: FloatArray
    correlation: FloatArray

    @property
    def matched(self) -> BoolArray:
        """Whether a tile (N,) matched."""
        found: BoolArray = np.all(np.isfinite(self.shifts), axis=1)
        return found

    @property
    def rms(self) -> float:
        """Root mean square length of the shifts in pixels."""
        found = self.shifts[self.matched]
        return float(np.sqrt((found**2).sum(axis=1).mean())) if len(found) else float("nan")

    @property
    def robust_rms(self) -> float:
        """RMS length from the median length: what the RMS would be without gross mismatches."""
        # For normal errors in both axes the length's median is 1.1774 σ, its RMS 1.4142 σ.
        found = self.shifts[self.matched]
        return float(np.median(np.hypot(*found.T)) * 1.4142 / 1.1774) if len(found) else float("nan")


def shifts(
    first: AnyArray, second: AnyArray, valid: BoolArray, tile: int = 64, reach: int = 8, least_correlation: float = 0.7
) -> Shifts:
    """Shifts of `second` against `first` in tiles.

    Parameters
    ----------
    first, second : array (rows, cols)
        Grey values on the same grid.
    valid : bool array (rows, cols)
        Pixels that both have; tiles with others are left out.
    tile : int
        Side of a tile in pixels.
    reach : int
        Largest shift searched for, in pixels.
    least_correlation : float
        Tiles that match worse are NaN.
    """
    places, found, quality = [], [], []
    # Two pixels more than the search, for gradients and the interpolation of fractions.
    margin = reach + 2
    rows, cols = first.shape
    for top in range(margin, rows - tile - margin + 1, tile):
        for left in range(margin, cols - tile - margin + 1, tile):
            outer = slice(top - margin, top + tile + margin), slice(left - margin, left + tile + margin)
            if not valid[outer].all():
                continue
            shift, correlation = _tile(first[outer].astype(float), second[outer].astype(float), margin, reach)
            places.append((left + tile / 2, top + tile / 2))
            found.append(shift if correlation >= least_correlation else (np.nan, np.nan))
            quality.append(correlation)
    return Shifts(np.array(places).reshape(-1, 2), np.array(found).reshape(-1, 2), np.array(quality))


def _tile(a: FloatArray, b: FloatArray, margin: int, reach: int) -> tuple[tuple[float, float], float]:
    from scipy.ndimage import shift as moved
    from scipy.ndimage import spline_filter

    inner = slice(margin, -margin), slice(margin, -margin)
    template = a[inner]
    if template.std() < 1e-9:
        return (np.nan, np.nan), 0.0
    dx, dy = _whole_shift(template, b, margin, reach)
    gy, gx = (np.asarray(slope) for slope in np.gradient(a))
    # The design is the template's, once for all iterations; only the other image is resampled.
    columns = np.column_stack([gx[inner].ravel(), gy[inner].ravel(), template.ravel(), np.ones(template.size)])
    solver, coefficients = np.linalg.pinv(columns), spline_filter(b, order=3, mode="nearest")
    x, y = float(dx), float(dy)
    correlation = 0.0
    for _ in range(_SHIFT_ITERATIONS):
        there = moved(coefficients, (-y, -x), order=3, mode="nearest", prefilter=False)[inner]
        correlation = float(np.corrcoef(there.ravel(), template.ravel())[0, 1]) if there.std() > 1e-9 else 0.0
        solution = solver @ there.ravel()
        gain = solution[2] if abs(solution[2]) > 1e-6 else 1.0
        step = (-float(solution[0] / gain), -float(solution[1] / gain))
        x, y = x + step[0], y + step[1]
        # The peak is right to a pixel: what moves farther has slid to other content.
        if max(abs(x - dx), abs(y - dy)) > 2.0:
            return (np.nan, np.nan), 0.0
        if np.hypot(*step) < _SHIFT_CONVERGED:
            break
    return (x, y), correlation


def _whole_shift(template: FloatArray, b: FloatArray, margin: int, reach: int) -> tuple[int, int]:
    """Shift in whole pixels with the largest normalised cross-correlation."""
    t = template - template.mean()
    size = template.size
    window = b[margin - reach : b.shape[0] - margin + reach, margin - reach : b.shape[1] - margin + reach]
    window = window - window.mean()
    cross, box = _slid(window, t), np.ones_like(t)
    mean = _slid(window, box) / size
    power = _slid(window**2, box) / size - mean**2
    score = cross / np.sqrt(np.maximum(power, 1e-12))
    row, col = np.unravel_index(int(np.argmax(score)), score.shape)
    return int(col) - reach, int(row) - reach


def _slid(window: FloatArray, template: FloatArray) -> FloatArray:
    """Sums of products at all places of a template within a window, by Fourier transforms of the window's size."""
    # Places where the transform wraps around are left out. (SciPy has this too, but its import takes a second or more.)
    shape = window.shape
    product = np.fft.rfft2(window) * np.conj(np.fft.rfft2(template, shape))
    whole = np.fft.irfft2(product, shape)
    return np.asarray(whole[: shape[0] - template.shape[0] + 1, : shape[1] - template.shape[1] + 1])
