"""Registration of overlaps: local correlation of two views of the same ground, corrected for noise.

A gain can be told from what two photos show of one place, not from what they show of two. Where the orientation is off
by more than the ground's own detail is wide, the views do not correlate, and their means and spreads differ by what the
ground happens to be. Correlation alone does not tell that: over water or snow it is low because there is nothing but
noise. What noise takes from a correlation is known, though: noise of neighbouring cells is independent, texture of the
ground is not, so the autocovariance of each view at lags of one and two cells gives the variance of its texture (the
nugget effect of geostatistics). The correlation divided by the root of both shares of texture is **corrected for
attenuation** (C. Spearman, The proof and measurement of association between two things, Am. J. Psychol. 15, 1904):
about 1 for registered views however noisy, about 0 for displaced ones. Where neither view has significant texture there
is nothing to judge by, and nothing to misregister.

Light that changes across photos is broad and may have opposite slopes in two views: a quadratic surface and local means
are taken off before.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.estimation.statistics import MAD_TO_SIGMA
from geomosaic.types import AnyArray, BoolArray, FloatArray

# Corrected correlation below which views count as misregistered: photos that are oriented well have 0.7 to 1 with
# houses that lean and shadows that move, photos whose orientation is off by metres −0.2 to 0.2.
MIN_CORRELATION = 0.5
# Cells along the window of local means: a tenth of a footprint, several times the lags that are compared.
WINDOW = 9
# Robust standard deviations at which local differences are clipped: a cloud's edge must not outweigh all the rest.
CLIP = 3.0
# Standard errors above which an autocorrelation is texture.
SIGNIFICANT = 3.0
# Cells by which views are shifted in search of the place where they are alike.
LARGEST_SHIFT = 16


@dataclass(frozen=True)
class Registration:
    """Registration of two views of an overlap.

    Attributes
    ----------
    correlation : float
        Local correlation, corrected for attenuation by noise; NaN where the views have no texture to judge by.
    shift : (int, int)
        Columns and rows from the first view to the place in the second that is most like it, where that is clearly
        more like it than the same place; (0, 0) otherwise.
    """

    correlation: float
    shift: tuple[int, int] = (0, 0)

    @property
    def decided(self) -> bool:
        """Whether the views have texture to judge by."""
        return bool(np.isfinite(self.correlation))

    @property
    def failed(self) -> bool:
        """Whether the views show different ground."""
        return self.correlation < MIN_CORRELATION


UNDECIDED = Registration(float("nan"))


def registration(a: AnyArray, b: AnyArray, seen: BoolArray) -> Registration:
    """Registration of two views on one grid.

    Parameters
    ----------
    a, b : array (rows, cols, bands)
        Values of the views; their means over the bands are compared.
    seen : bool array (rows, cols)
        Cells valid in both.

    Returns
    -------
    Registration
    """
    first, second = (_local(view.mean(axis=2, dtype=np.float64), seen) for view in (a, b))
    count = int(seen.sum())
    # Autocorrelation of white noise has this standard error; two directions are averaged.
    least = SIGNIFICANT / np.sqrt(2 * count)
    texture = [_texture_variance(view, seen, least) for view in (first, second)]
    if min(texture) <= 0:
        return UNDECIDED
    correlation = float((first * second).sum() / count / np.sqrt(texture[0] * texture[1]))
    if correlation >= MIN_CORRELATION:
        return Registration(correlation)
    return Registration(correlation, _shift(first, second, seen))


def _local(view: FloatArray, seen: BoolArray) -> FloatArray:
    """Differences (rows, cols) from a quadratic surface and from local means, clipped; 0 where not seen."""
    rows, cols = np.nonzero(seen)
    y, x = (2.0 * at / max(size - 1, 1) - 1 for at, size in zip((rows, cols), seen.shape, strict=True))
    surface = np.stack([np.ones(len(x)), x, y, x * x, x * y, y * y])
    values = view[rows, cols]
    # By normal equations: the functions are of order 1, and six of them are cheap.
    values = values - np.linalg.lstsq(surface @ surface.T, surface @ values, rcond=None)[0] @ surface
    out = np.zeros(seen.shape)
    out[rows, cols] = values
    values = values - _window_sums(out)[rows, cols] / _window_sums(seen.astype(np.float64))[rows, cols]
    # Rounding of one tone is no texture.
    values[np.abs(values) < 1e-9 * np.abs(view).max()] = 0.0
    limit = CLIP * MAD_TO_SIGMA * np.median(np.abs(values))
    out[rows, cols] = np.clip(values, -limit, limit) if limit > 0 else values
    return out


def _window_sums(values: FloatArray) -> FloatArray:
    """Sums (rows, cols) over windows of `WINDOW` × `WINDOW` cells, by a table of sums."""
    half = WINDOW // 2
    table = np.pad(values, ((half + 1, half), (half + 1, half))).cumsum(axis=0).cumsum(axis=1)
    rows = table[WINDOW:] - table[:-WINDOW]
    return np.asarray(rows[:, WINDOW:] - rows[:, :-WINDOW])


def _texture_variance(local: FloatArray, seen: BoolArray, least: float) -> float:
    """Variance of the texture without noise; 0 where its autocorrelation is not above `least` at both lags."""
    variance = float((local**2).sum()) / int(seen.sum())
    near, far = (_autocovariance(local, seen, lag) for lag in (1, 2))
    if variance <= 0 or min(near, far) <= least * variance:
        return 0.0
    # A Gaussian autocovariance, S·exp(−k·lag²), through both lags and continued to 0. Ground with sharper edges has
    # more texture than that, and its correlation is taken for better than it is: the safe side.
    return float(min(variance, near * (near / far) ** (1 / 3)))


def _autocovariance(local: FloatArray, seen: BoolArray, lag: int) -> float:
    """Mean product of cells that lie `lag` cells apart along rows or columns."""
    total = float((local[lag:] * local[:-lag]).sum() + (local[:, lag:] * local[:, :-lag]).sum())
    count = int((seen[lag:] & seen[:-lag]).sum() + (seen[:, lag:] & seen[:, :-lag]).sum())
    return total / max(count, 1)


def _shift(first: FloatArray, second: FloatArray, seen: BoolArray) -> tuple[int, int]:
    """Shift (cols, rows) of the largest cross-correlation, where that is significant; (0, 0) otherwise."""
    reach = min(LARGEST_SHIFT, min(seen.shape) // 2)
    shape = tuple(size + reach for size in seen.shape)
    spectra = [np.fft.rfft2(part, shape) for part in (first, second, seen.astype(np.float64))]
    product, common = (np.fft.irfft2(np.conj(x) * y, shape) for x, y in (spectra[:2], (spectra[2], spectra[2])))
    around = np.ix_(*(np.arange(-reach, reach + 1) % size for size in shape))
    norm = np.sqrt((first**2).sum() * (second**2).sum()) / np.count_nonzero(seen)
    # Shifts that leave less than half of the overlap say little, and their correlation varies much.
    enough = common[around] > np.count_nonzero(seen) / 2
    found = np.where(enough, product[around] / np.maximum(common[around], 1) / norm, -1.0)
    row, col = np.unravel_index(int(np.argmax(found)), found.shape)
    best, here = found[row, col], found[reach, reach]
    if best < max(MIN_CORRELATION, here + 0.2):
        return 0, 0
    return int(col) - reach, int(row) - reach
