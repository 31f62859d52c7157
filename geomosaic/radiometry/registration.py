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

Where crowns and roofs stand above the surface, an overlap may be registered on its lawns and roads and nowhere else.
Correlation in windows finds such parts; views displaced against each other say how much of that is chance.
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
# Corrected correlation from which on an overlap counts as a whole; below, only its registered part does.
WHOLE_CORRELATION = 0.7
# Cells along the window in which views of a registered part correlate by `MIN_CORRELATION`; cells by which views are
# displaced to see what chance does (local means leave no correlation so far apart), and the share of that at most.
PART_WINDOW, DISPLACED, CHANCE = 15, ((9, 0), (0, 9), (9, 9), (-9, 9)), 0.2
# Cells of the smallest registered part, and its share of the overlap: by chance, photos whose orientation is off by
# metres are alike in up to 12 % of an overlap.
LEAST_PART, LEAST_SHARE = 100, 0.15
# Largest number of rows and of columns that are compared, in the middle of an overlap: as many as that decide.
MIDDLE = 48
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
    share : float
        Of the cells, in whose surroundings the views show the same ground; 1 of an overlap that counts as a whole.
    """

    correlation: float
    shift: tuple[int, int] = (0, 0)
    share: float = 1.0

    @property
    def decided(self) -> bool:
        """Whether the views have texture to judge by."""
        return bool(np.isfinite(self.correlation))

    @property
    def failed(self) -> bool:
        """Whether the views show different ground everywhere."""
        return self.share == 1.0 and self.correlation < MIN_CORRELATION


UNDECIDED = Registration(float("nan"))


def registration(a: AnyArray, b: AnyArray, seen: BoolArray) -> Registration:
    """Registration of two views on one grid.

    Parameters
    ----------
    a, b : array (rows, cols, bands)
        Values of the views; their means over the bands are compared.
    seen : bool array (rows, cols)
        Cells valid in both.
    """
    rows, cols = np.nonzero(seen)
    box = _middle(rows), _middle(cols)
    seen = seen[box]
    count = int(seen.sum())
    if count < WINDOW:
        return UNDECIDED
    first, second = _local([a[box], b[box]], seen)
    # Autocorrelation of white noise has this standard error; two directions are averaged.
    least = SIGNIFICANT / np.sqrt(2 * count)
    texture = [_texture_variance(view, seen, least) for view in (first, second)]
    if min(texture) <= 0:
        return UNDECIDED
    correlation = float(np.vdot(first, second) / count / np.sqrt(texture[0] * texture[1]))
    if correlation >= MIN_CORRELATION:
        return Registration(correlation)
    return Registration(correlation, _shift(first, second, seen))


def registered_part(a: AnyArray, b: AnyArray, seen: BoolArray) -> BoolArray:
    """Cells around which two views on one grid show the same ground; none where that may be chance.

    Parameters
    ----------
    a, b : array (rows, cols, bands)
        Values of the views; their means over the bands are compared.
    seen : bool array (rows, cols)
        Cells valid in both.

    Returns
    -------
    bool array (rows, cols)
    """
    first, second = _local([a, b], seen)
    alike = _alike(first, second, seen)
    by_chance = 0.0
    for shift in DISPLACED:
        both = seen & np.roll(seen, shift, (0, 1))
        moved = np.roll(second, shift, (0, 1))
        share = _alike(np.where(both, first, 0.0), np.where(both, moved, 0.0), both).sum() / max(int(both.sum()), 1)
        by_chance = max(by_chance, float(share))
    count, of = int(alike.sum()), int(seen.sum())
    enough = count >= max(LEAST_PART, LEAST_SHARE * of) and by_chance * of <= CHANCE * count
    return alike if enough else np.zeros_like(alike)


def _alike(first: FloatArray, second: FloatArray, seen: BoolArray) -> BoolArray:
    """Cells in whose windows local differences (rows, cols) correlate, where most of a window is seen."""
    product, one, other = (
        _window_sums(values, PART_WINDOW) for values in (first * second, first * first, second * second)
    )
    most = _window_sums(seen.astype(np.float64), PART_WINDOW) > 0.5 * PART_WINDOW**2
    scale = np.sqrt(np.maximum(one, 0.0) * np.maximum(other, 0.0))
    found: BoolArray = seen & most & (scale > 0.0) & (product >= MIN_CORRELATION * scale)
    return found


def _middle(at: AnyArray) -> slice:
    """Middle of the rows or columns of the cells that both views show."""
    low, high = int(at.min()), int(at.max()) + 1
    spare = max(high - low - MIDDLE, 0) // 2
    return slice(low + spare, high - spare)


def _local(views: list[AnyArray], seen: BoolArray) -> list[FloatArray]:
    """Differences (rows, cols) of views from a quadratic surface and from local means, clipped; 0 where not seen."""
    rows, cols = np.nonzero(seen)
    y, x = (2.0 * at / max(size - 1, 1) - 1 for at, size in zip((rows, cols), seen.shape, strict=True))
    surface = np.stack([np.ones(len(x)), x, y, x * x, x * y, y * y])
    # The normal matrix of a few cells in a line is singular.
    inverse = np.linalg.pinv(surface @ surface.T)
    share = _window_sums(seen.astype(np.float64))[seen]
    found = []
    for view in views:
        values = sum((view[..., band][seen] for band in range(1, view.shape[2])), view[..., 0][seen].astype(np.float64))
        least = 1e-9 * np.abs(values).max()
        values = values - inverse @ (surface @ values) @ surface
        out = np.zeros(seen.shape)
        out[seen] = values
        values -= _window_sums(out)[seen] / share
        # Rounding of one tone is no texture.
        values[np.abs(values) < least] = 0.0
        limit = CLIP * MAD_TO_SIGMA * float(np.median(np.abs(values)))
        out[seen] = np.clip(values, -limit, limit) if limit > 0 else values
        found.append(out)
    return found


def _window_sums(values: FloatArray, side: int = WINDOW) -> FloatArray:
    """Sums (rows, cols) over windows of `side` × `side` cells, an odd number, by cumulative sums."""
    half = side // 2
    table = np.zeros((values.shape[0] + side, values.shape[1] + side))
    table[half + 1 : half + 1 + values.shape[0], half + 1 : half + 1 + values.shape[1]] = values
    down = np.cumsum(table, axis=0, out=table)
    down = down[side:] - down[:-side]
    across = np.cumsum(down, axis=1, out=down)
    return np.asarray(across[:, side:] - across[:, :-side])


def _texture_variance(local: FloatArray, seen: BoolArray, least: float) -> float:
    """Variance of the texture without noise; 0 where its autocorrelation is not above `least` at both lags."""
    variance = float(np.vdot(local, local)) / int(seen.sum())
    near, far = (_autocovariance(local, seen, lag) for lag in (1, 2))
    if variance <= 0 or min(near, far) <= least * variance:
        return 0.0
    # A Gaussian autocovariance, S·exp(−k·lag²), through both lags and continued to 0. Ground with sharper edges has
    # more texture than that, and its correlation is taken for better than it is: the safe side.
    return float(min(variance, near * (near / far) ** (1 / 3)))


def _autocovariance(local: FloatArray, seen: BoolArray, lag: int) -> float:
    """Mean product of cells that lie `lag` cells apart along rows or columns."""
    total = float(np.vdot(local[lag:], local[:-lag]) + np.vdot(local[:, lag:], local[:, :-lag]))
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
