"""One linear correction per image and band, from what overlapping images show of the same ground.

Corrected values are g·v + o. Each overlap gives, by `relation.relate`, one observation of a ratio of gains,
log gᵢ − log gⱼ = log (s_j / s_i), and with the gains known one of a difference of offsets, oᵢ − oⱼ = gⱼ·m_j − gᵢ·m_i,
where s and m are spread and mean of the overlap in each image. Both sets are adjusted over the graph of overlaps by
weighted least squares (a levelling network: observations are differences), with weak prior observations log g = 0 and
o = 0 of every image. The priors settle what differences cannot: the geometric mean of the gains is 1 and the mean of
the offsets 0 in every group of connected images, and an image without overlaps stays as it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.radiometry.curve import Curve
from geomosaic.radiometry.relation import Relation, relate
from geomosaic.types import AnyArray, FloatArray

PRIOR_SIGMA = 1.0
"""Of the logarithm of a gain, and of an offset in mean grey values: a hint where overlaps say nothing, no more."""
LEAST_SIGMA = 0.003
"""Of an observation, in the same units: one line per image is no exact model (vignetting, view angle)."""
MOST_DENSE = 1000
"""Images beyond which the normal equations are kept sparse."""


@dataclass(frozen=True)
class Overlap:
    """The same ground in two images.

    Attributes
    ----------
    first, second : int
        Numbers of the images.
    a, b : array (N, bands)
        Values in the first and in the second.
    """

    first: int
    second: int
    a: AnyArray
    b: AnyArray


@dataclass(frozen=True)
class Balance:
    """The solution.

    Attributes
    ----------
    gain, offset : array (images, bands)
    before, after : array (bands,)
        Root mean square difference over all overlaps without and with the correction; NaN without overlaps.
    overlaps : int
        Pairs of images used.
    curves : tuple of Curve, optional
        Of the images, where histograms were matched: they are what is applied then.
    """

    gain: FloatArray
    offset: FloatArray
    before: FloatArray
    after: FloatArray
    overlaps: int
    curves: tuple[Curve, ...] | None = None


def solve(images: int, bands: int, overlaps: Sequence[Overlap]) -> Balance:
    """Solve gains and offsets of all images, band by band.

    An image without overlaps keeps gain 1 and offset 0. Clipped values are to be left out beforehand: they look too
    much like the ground to be told from it.

    Raises
    ------
    SolveError
        Values that are not finite.
    """
    used = [overlap for overlap in overlaps if len(overlap.a)]
    gain, offset = np.ones((images, bands)), np.zeros((images, bands))
    if not used:
        return Balance(gain, offset, np.full(bands, np.nan), np.full(bands, np.nan), 0)
    first, second = np.array([(pair.first, pair.second) for pair in used]).T
    relations = [relate(pair.a, pair.b) for pair in used]
    for band in range(bands):
        gain[:, band], offset[:, band] = _solve_band(images, first, second, relations, band)
    if not (np.isfinite(gain).all() and np.isfinite(offset).all()):
        raise SolveError("the colour balance has no solution", mend="run with --no-balance")
    before, after, count = np.zeros(bands), np.zeros(bands), 0
    for pair in used:
        a, b = pair.a.astype(np.float64), pair.b.astype(np.float64)
        before += ((a - b) ** 2).sum(axis=0)
        i, j = pair.first, pair.second
        after += ((gain[i] * a + offset[i] - gain[j] * b - offset[j]) ** 2).sum(axis=0)
        count += len(a)
    return Balance(gain, offset, np.sqrt(before / count), np.sqrt(after / count), len(used))


def _solve_band(
    images: int, first: AnyArray, second: AnyArray, relations: Sequence[Relation], band: int
) -> tuple[FloatArray, FloatArray]:
    def column(name: str) -> FloatArray:
        return np.array([getattr(relation, name)[band] for relation in relations])

    ratio, variance = column("log_ratio"), column("log_ratio_variance")
    gain = np.exp(_level(images, first, second, ratio, variance + LEAST_SIGMA**2))
    mean_a, mean_b = gain[first] * column("mean_a"), gain[second] * column("mean_b")
    spread = gain[first] * column("spread_a") * gain[second] * column("spread_b")
    noise = 2 * spread * (1 - column("correlation")) / column("count")
    unit = max(1e-12, float(np.mean((np.abs(mean_a) + np.abs(mean_b)) / 2)))
    variance = noise / unit**2 + LEAST_SIGMA**2
    return gain, unit * _level(images, first, second, (mean_b - mean_a) / unit, variance)


def _level(images: int, first: AnyArray, second: AnyArray, difference: FloatArray, variance: FloatArray) -> FloatArray:
    """Least-squares values x of all images from observed differences x[first] − x[second] and the prior x = 0.

    The normal matrix is the weighted Laplacian of the graph plus the prior's weight on its diagonal. Rows of a
    Laplacian sum to 0, so the values of every connected group do too.
    """
    weight = PRIOR_SIGMA**2 / variance
    pull = np.bincount(first, weight * difference, images) - np.bincount(second, weight * difference, images)
    diagonal = 1.0 + np.bincount(first, weight, images) + np.bincount(second, weight, images)
    each = np.arange(images)
    rows, cols = np.concatenate([first, second, each]), np.concatenate([second, first, each])
    values = np.concatenate([-weight, -weight, diagonal])
    if images <= MOST_DENSE:
        dense = np.zeros((images, images))
        np.add.at(dense, (rows, cols), values)
        return np.asarray(np.linalg.solve(dense, pull))
    from scipy.sparse import coo_matrix
    from scipy.sparse.linalg import spsolve

    return np.asarray(spsolve(coo_matrix((values, (rows, cols)), shape=(images, images)).tocsc(), pull))
