"""One linear correction per image and band, from what overlapping images show of the same ground.

Corrected values are g·v + o. Each overlap gives, by `relation.relate`, one observation of a ratio of gains,
log gᵢ − log gⱼ = log (s_j / s_i), and with the gains known one of a difference of offsets, oᵢ − oⱼ = gⱼ·m_j − gᵢ·m_i,
where s and m are spread and mean of the overlap in each image. Both sets are adjusted over the graph of overlaps by
weighted least squares (a levelling network: observations are differences), with weak prior observations log g = 0 and
o = 0 of every image. The priors settle what differences cannot: the geometric mean of the gains is 1 and the mean of
the offsets 0 in every group of connected images, and an image without overlaps stays as it is. In groups of many images
the mean correction of each neighbourhood is observed as well, so that nothing adds up from photo to photo: see `drift`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.radiometry import drift
from geomosaic.radiometry.histogram_matching import Curve
from geomosaic.radiometry.overlap_samples import Overlap
from geomosaic.radiometry.regression import Relation, relate
from geomosaic.types import FloatArray, IntArray

if TYPE_CHECKING:
    from geomosaic.radiometry.fields import Fields
    from geomosaic.radiometry.local_gains import Shade
    from geomosaic.radiometry.model_selection import Trial

PRIOR_SIGMA = 1.0
"""Of the logarithm of a gain, and of an offset in mean grey values: a hint where overlaps say nothing, no more."""
LEAST_SIGMA = 0.003
"""Of an observation, in the same units: one line per image is no exact model (vignetting, view angle)."""
MOST_DENSE = 1000
"""Images beyond which the normal equations are kept sparse."""


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
    curves : tuple of Curve or Shade, optional
        Of the images, where histograms were matched or light has fields: they are what is applied then.
    fields : Fields, optional
        Where light has fields, their parameters.
    trials : tuple of Trial
        Sets of terms that were tried.
    notes : tuple of str
        What was taken for granted, in words.
    """

    gain: FloatArray
    offset: FloatArray
    before: FloatArray
    after: FloatArray
    overlaps: int
    curves: tuple[Curve, ...] | tuple[Shade, ...] | None = None
    fields: Fields | None = None
    trials: tuple[Trial, ...] = ()
    notes: tuple[str, ...] = ()


def solve(images: int, bands: int, overlaps: Sequence[Overlap], *, hold: bool = True) -> Balance:
    """Solve gains and offsets of all images, band by band.

    An image without overlaps keeps gain 1 and offset 0. Clipped values are to be left out beforehand: they look too
    much like the ground to be told from it.

    Parameters
    ----------
    images, bands : int
    overlaps : sequence of Overlap
        Grey values of pairs of images, numbered from 0.
    hold : bool
        Bound the drift along strips, see `drift`.

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
    graph = _Graph.of(images, first, second, hold=hold)
    for band in range(bands):
        gain[:, band], offset[:, band] = _solve_band(graph, relations, band)
    if not (np.isfinite(gain).all() and np.isfinite(offset).all()):
        raise SolveError("the colour balance has no solution", hint="run with `balance=False`")
    before, after, count = np.zeros(bands), np.zeros(bands), 0
    for pair in used:
        a, b = pair.a.astype(np.float64), pair.b.astype(np.float64)
        before += ((a - b) ** 2).sum(axis=0)
        i, j = pair.first, pair.second
        after += ((gain[i] * a + offset[i] - gain[j] * b - offset[j]) ** 2).sum(axis=0)
        count += len(a)
    return Balance(gain, offset, np.sqrt(before / count), np.sqrt(after / count), len(used))


@dataclass(frozen=True)
class _Graph:
    """Which images overlap, and where corrections could creep."""

    images: int
    first: IntArray
    second: IntArray
    near: list[IntArray]
    group: IntArray | None

    @classmethod
    def of(cls, images: int, first: IntArray, second: IntArray, *, hold: bool) -> _Graph:
        near = drift.neighbourhoods(images, first, second) if hold else []
        return cls(images, first, second, near, drift.groups(images, first, second) if near else None)


def _solve_band(graph: _Graph, relations: Sequence[Relation], band: int) -> tuple[FloatArray, FloatArray]:
    def column(name: str) -> FloatArray:
        return np.array([getattr(relation, name)[band] for relation in relations])

    first, second = graph.first, graph.second
    ratio, variance = column("log_ratio"), column("log_ratio_variance")
    level = _level(graph, ratio, variance + LEAST_SIGMA**2)
    sigma = drift.sigma(graph.near, level) if graph.near else None
    if sigma is not None:
        level = _level(graph, ratio, variance + LEAST_SIGMA**2, sigma)
    gain = np.exp(level)
    mean_a, mean_b = gain[first] * column("mean_a"), gain[second] * column("mean_b")
    spread = gain[first] * column("spread_a") * gain[second] * column("spread_b")
    noise = 2 * spread * (1 - column("correlation")) / column("count")
    unit = max(1e-12, float(np.mean((np.abs(mean_a) + np.abs(mean_b)) / 2)))
    variance = noise / unit**2 + LEAST_SIGMA**2
    target = None
    if graph.near:  # what gains do to the level of each image, offsets take back over neighbourhoods
        sums = np.bincount(first, mean_a, graph.images) + np.bincount(second, mean_b, graph.images)
        count = np.bincount(first, minlength=graph.images) + np.bincount(second, minlength=graph.images)
        raised = (1 - 1 / gain) * sums / np.maximum(count, 1) / unit
        assert graph.group is not None
        target = (np.bincount(graph.group, raised) / np.bincount(graph.group))[graph.group] - raised
    return gain, unit * _level(graph, (mean_b - mean_a) / unit, variance, sigma, target)


def _level(
    graph: _Graph,
    difference: FloatArray,
    variance: FloatArray,
    sigma: float | None = None,
    target: FloatArray | None = None,
) -> FloatArray:
    """Least-squares values x of all images from observed differences x[first] − x[second] and the prior x = 0.

    The normal matrix is the weighted Laplacian of the graph plus the prior's weight on its diagonal. Rows of a
    Laplacian sum to 0, so the values of every connected group do too; where neighbourhoods are held they are made to.
    The mean of a neighbourhood is held at that of `target`, 0 unless given, with the standard deviation `sigma`.
    """
    images, first, second = graph.images, graph.first, graph.second
    weight = PRIOR_SIGMA**2 / variance
    push = weight * difference
    pull = np.asarray(np.bincount(first, push, images) - np.bincount(second, push, images), dtype=np.float64)
    diagonal = 1.0 + np.bincount(first, weight, images) + np.bincount(second, weight, images)
    each = np.arange(images)
    strength = 0.0 if sigma is None else PRIOR_SIGMA**2 / sigma**2
    held = drift.entries(graph.near if strength else [], strength)
    if target is not None:
        pull = pull + drift.pulls(graph.near, target, strength)
    rows = np.concatenate([first, second, each, held[0]])
    cols = np.concatenate([second, first, each, held[1]])
    values = np.concatenate([-weight, -weight, diagonal, held[2]])
    if images <= MOST_DENSE:
        dense = np.zeros((images, images))
        np.add.at(dense, (rows, cols), values)
        level = np.asarray(np.linalg.solve(dense, pull))
    else:
        from scipy.sparse import coo_matrix
        from scipy.sparse.linalg import spsolve

        level = np.asarray(spsolve(coo_matrix((values, (rows, cols)), shape=(images, images)).tocsc(), pull))
    if graph.group is not None:
        level = level - (np.bincount(graph.group, level) / np.bincount(graph.group))[graph.group]
    return level
