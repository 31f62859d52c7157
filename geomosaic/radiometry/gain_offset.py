"""Gain and offset of each image and band, adjusted over the overlaps of a block.

Corrected values are g·v + o. Each overlap gives, by `regression.standardised_major_axis`, one observation of a ratio of
gains, log gᵢ − log gⱼ = log (s_j / s_i), and with the gains known one of a difference of offsets,
oᵢ − oⱼ = gⱼ·m_j − gᵢ·m_i, where s and m are spread and mean of the overlap in each image. Both sets are adjusted over
the graph of overlaps by weighted least squares (a levelling network: observations are differences), with weak prior
observations log g = 0 and o = 0 of every image. The priors settle what differences cannot: the geometric mean of the
gains is 1 and the mean of the offsets 0 in every group of connected images, and an image without overlaps stays as it
is. In groups of many images the mean correction of each neighbourhood is observed as well, so that errors do not add up
from photo to photo: see `drift`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.radiometry import bases as drift
from geomosaic.radiometry.fields import MajorAxis, standardised_major_axis
from geomosaic.radiometry.histogram_matching import ToneCurve
from geomosaic.radiometry.overlap_samples import Overlap
from geomosaic.types import FloatArray, IntArray

if TYPE_CHECKING:
    from geomosaic.radiometry.fields import ColourModel
    from geomosaic.radiometry.local_gains import CorrectionField
    from geomosaic.radiometry.model_selection import Trial

PRIOR_SIGMA = 1.0
"""Standard deviation of the logarithm of a gain, and of an offset in mean grey values; weak beside any overlap."""
MIN_SIGMA = 0.003
"""Smallest standard deviation of an observation, in the same units: the model leaves out vignetting and view angle."""
MAX_DENSE = 1000
"""Images beyond which the normal equations are kept sparse."""


@dataclass(frozen=True)
class Balance:
    """Corrections of all images, and the differences over their overlaps.

    Attributes
    ----------
    gain, offset : array (images, bands)
    before, after : array (bands,)
        Root mean square difference over all overlaps without and with the correction; NaN without overlaps.
    overlaps : int
        Pairs of images used.
    curves : tuple of ToneCurve or CorrectionField, optional
        Corrections of the images where they are more than gain and offset; these are applied then.
    fields : ColourModel, optional
        Parameters of the model behind the curves.
    trials : tuple of Trial
        Sets of terms that were tried.
    notes : tuple of str
        Assumptions and exceptions, in words.
    """

    gain: FloatArray
    offset: FloatArray
    before: FloatArray
    after: FloatArray
    overlaps: int
    curves: tuple[ToneCurve, ...] | tuple[CorrectionField, ...] | None = None
    fields: ColourModel | None = None
    trials: tuple[Trial, ...] = ()
    notes: tuple[str, ...] = ()


def solve_gain_offset(images: int, bands: int, overlaps: Sequence[Overlap], *, hold: bool = True) -> Balance:
    """Gains and offsets of all images, band by band.

    An image without overlaps keeps gain 1 and offset 0. Clipped values are to be left out beforehand: they look like
    ground of that value, and cannot be told from it.

    Parameters
    ----------
    images, bands : int
    overlaps : sequence of Overlap
        Grey values of pairs of images, numbered from 0.
    hold : bool
        Bound the drift along strips, see `drift`.

    Returns
    -------
    Balance

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
    relations = [standardised_major_axis(pair.a, pair.b) for pair in used]
    graph = _OverlapGraph.of(images, first, second, hold=hold)
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
class _OverlapGraph:
    """Graph of overlapping images, and the neighbourhoods over which drift is bounded."""

    images: int
    first: IntArray
    second: IntArray
    near: list[IntArray]
    group: IntArray | None

    @classmethod
    def of(cls, images: int, first: IntArray, second: IntArray, *, hold: bool) -> _OverlapGraph:
        near = drift.neighbourhoods(images, first, second) if hold else []
        return cls(images, first, second, near, drift.connected_groups(images, first, second) if near else None)


def _solve_band(graph: _OverlapGraph, relations: Sequence[MajorAxis], band: int) -> tuple[FloatArray, FloatArray]:
    def column(name: str) -> FloatArray:
        return np.array([getattr(relation, name)[band] for relation in relations])

    first, second = graph.first, graph.second
    ratio, variance = column("log_ratio"), column("log_ratio_variance")
    level = _adjusted(graph, ratio, variance + MIN_SIGMA**2)
    # How firmly drift is bounded depends on how much exposures vary, which a solution without the bound shows.
    sigma = drift.mean_sigma(graph.near, level) if graph.near else None
    if sigma is not None:
        level = _adjusted(graph, ratio, variance + MIN_SIGMA**2, sigma)
    gain = np.exp(level)
    mean_a, mean_b = gain[first] * column("mean_a"), gain[second] * column("mean_b")
    spread = gain[first] * column("spread_a") * gain[second] * column("spread_b")
    # Variance of the mean difference of two views of equal spread s and correlation ρ: 2·s²·(1 − ρ) / n.
    noise = 2 * spread * (1 - column("correlation")) / column("count")
    unit = max(1e-12, float(np.mean((np.abs(mean_a) + np.abs(mean_b)) / 2)))
    variance = noise / unit**2 + MIN_SIGMA**2
    target = None
    if graph.near:  # gains change the level of each image; over neighbourhoods, offsets restore it
        sums = np.bincount(first, mean_a, graph.images) + np.bincount(second, mean_b, graph.images)
        count = np.bincount(first, minlength=graph.images) + np.bincount(second, minlength=graph.images)
        raised = (1 - 1 / gain) * sums / np.maximum(count, 1) / unit
        assert graph.group is not None
        target = (np.bincount(graph.group, raised) / np.bincount(graph.group))[graph.group] - raised
    return gain, unit * _adjusted(graph, (mean_b - mean_a) / unit, variance, sigma, target)


def _adjusted(
    graph: _OverlapGraph,
    difference: FloatArray,
    variance: FloatArray,
    sigma: float | None = None,
    target: FloatArray | None = None,
) -> FloatArray:
    """Least-squares values x of all images from observed differences x[first] − x[second] and the prior x = 0.

    The normal matrix is the weighted Laplacian of the graph plus the prior's weight on its diagonal. Rows of a
    Laplacian sum to 0, so the values of every connected group do too; where drift is bounded they are made to. The mean
    of a neighbourhood is observed as that of `target`, 0 unless given, with the standard deviation `sigma`.
    """
    images, first, second = graph.images, graph.first, graph.second
    weight = PRIOR_SIGMA**2 / variance
    push = weight * difference
    pull = np.asarray(np.bincount(first, push, images) - np.bincount(second, push, images), dtype=np.float64)
    diagonal = 1.0 + np.bincount(first, weight, images) + np.bincount(second, weight, images)
    each = np.arange(images)
    strength = 0.0 if sigma is None else PRIOR_SIGMA**2 / sigma**2
    held = drift.normal_entries(graph.near if strength else [], strength)
    if target is not None:
        pull = pull + drift.right_hand_side(graph.near, target, strength)
    rows = np.concatenate([first, second, each, held[0]])
    cols = np.concatenate([second, first, each, held[1]])
    values = np.concatenate([-weight, -weight, diagonal, held[2]])
    if images <= MAX_DENSE:
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
