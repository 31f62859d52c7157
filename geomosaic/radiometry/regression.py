"""Standardised major axis of two views: their linear relation with noise in both, robust against outliers.

Least squares of one view on the other takes the other for exact, so noise pulls its slope towards zero (regression
dilution). The **standardised major axis** (reduced major axis, geometric mean regression) treats both alike: its slope
is the ratio of the spreads, s_b / s_a. Its logarithm has the variance (1 − ρ²) / (n − 2) from sampling
(D. I. Warton et al., Bivariate line-fitting methods for allometry, Biol. Rev. 81, 2006). Where the noise of the views
is not in proportion to their spreads the slope is off, but never by more than the factor ρ either way: the true line
lies between the two regressions (R. Frisch, 1934). A uniform distribution over ± log ρ has the variance (log ρ)² / 3.

Means, spreads and correlation are weighted with Tukey's biweight of the standardised difference of the views, so that
cars, leaning houses and clipped values, which one view shows and the other does not, have no weight. The same weights
serve both views; exchanging them changes nothing but the sign.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.types import AnyArray, FloatArray

MAX_ITERATIONS = 20
CONVERGED = 1e-4
"""Relative change of the spreads at which the iteration ends: far below their sampling error."""
BIWEIGHT_LIMIT = 4.685
"""Robust standard deviations beyond which a sample has no weight: 95 % efficient on normal noise."""
MAD_TO_SIGMA = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True)
class MajorAxis:
    """Robust means, spreads and correlation of two views a and b of the same ground; all arrays are (bands,).

    Attributes
    ----------
    mean_a, mean_b : array
        Robust means, in grey values.
    spread_a, spread_b : array
        Robust standard deviations, in grey values.
    correlation : array
        Between the views; 0 where a view shows one tone only.
    count : array
        Effective number of samples under the weights.
    """

    mean_a: FloatArray
    mean_b: FloatArray
    spread_a: FloatArray
    spread_b: FloatArray
    correlation: FloatArray
    count: FloatArray

    @property
    def log_ratio(self) -> FloatArray:
        """Logarithm of spread b over spread a; 0 where it is unknown."""
        known = self.correlation > 0
        ratio = np.divide(self.spread_b, self.spread_a, out=np.ones_like(self.spread_a), where=known)
        return np.asarray(np.log(ratio))

    @property
    def log_ratio_variance(self) -> FloatArray:
        """Variance of `log_ratio`; infinite where it is unknown."""
        known = self.correlation > 0
        rho = np.where(known, np.minimum(self.correlation, 1.0), 1.0)
        variance = (1 - rho**2) / np.maximum(self.count - 2, 1) + np.log(rho) ** 2 / 3
        return np.where(known, variance, np.inf)


def standardised_major_axis(a: AnyArray, b: AnyArray) -> MajorAxis:
    """Standardised major axis of two views, by iteratively reweighted moments.

    Parameters
    ----------
    a, b : array (N, bands)
        Values of the same places, finite; N at least 1.

    Returns
    -------
    MajorAxis
    """
    views = np.stack([a, b]).astype(np.float64)
    mean = np.median(views, axis=1)
    spread = MAD_TO_SIGMA * np.median(np.abs(views - mean[:, None]), axis=1)
    # Where more than half of the samples have one tone, the median deviation is 0, though the rest may vary.
    spread = np.where(spread > 0, spread, views.std(axis=1))
    least = 1e-9 * np.abs(views).max(axis=(0, 1)) + 1e-300
    one_tone = (spread <= least).any(axis=0)
    done, weight = np.zeros(one_tone.shape, dtype=bool), np.ones(views.shape[1:])
    for _ in range(MAX_ITERATIONS):
        unit = (views - mean[:, None]) / np.where(one_tone, 1.0, np.maximum(spread, least))[:, None]
        difference = unit[1] - unit[0]
        limit = BIWEIGHT_LIMIT * np.maximum(MAD_TO_SIGMA * np.median(np.abs(difference), axis=0), 1e-9)
        limit = np.where(one_tone, np.maximum(limit, least), limit)
        # A band that has converged stays as it is while others iterate: each gives what it would give alone.
        weight = np.where(done, weight, np.maximum(1 - (difference / limit) ** 2, 0.0) ** 2)
        total, before = weight.sum(axis=0), spread
        mean = np.where(done, mean, (weight * views).sum(axis=1) / total)
        centred = views - mean[:, None]
        spread = np.where(done, spread, np.sqrt((weight * centred**2).sum(axis=1) / total))
        one_tone = (spread <= least).any(axis=0)
        done = done | (np.abs(spread - before) <= CONVERGED * spread + least).all(axis=0)
        if done.all():
            break
    product = (weight * centred[0] * centred[1]).sum(axis=0) / total
    scale = np.where(one_tone, 1.0, spread[0] * spread[1])
    correlation = np.where(one_tone, 0.0, product / scale)
    return MajorAxis(mean[0], mean[1], spread[0], spread[1], correlation, total**2 / (weight**2).sum(axis=0))
