"""Gain and offset of each image and band, adjusted over the overlaps of a block.

Corrected values are g·v + o. Each overlap gives, by `standardised_major_axis`, one observation of a ratio of gains,
log gᵢ − log gⱼ = log (s_j / s_i), and with the gains known one of a difference of offsets,
oᵢ − oⱼ = gⱼ·m_j − gᵢ·m_i, where s and m are spread and mean of the overlap in each image. Both sets are adjusted over
the graph of overlaps by weighted least squares (a levelling network: observations are differences), with weak prior
observations log g = 0 and o = 0 of every image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.estimation.normal_equations import solve_normal_equations
from geomosaic.estimation.statistics import BIWEIGHT_LIMIT, MAD_TO_SIGMA, biweight
from geomosaic.radiometry.corrections import ToneCurve
from geomosaic.radiometry.overlaps import (
    MIN_SIGMA,
    Overlap,
    connected_groups,
    mean_sigma,
    neighbourhoods,
    normal_entries,
    right_hand_side,
)
from geomosaic.radiometry.radiometric_change import RadiometricChange
from geomosaic.types import AnyArray, FloatArray, IntArray

if TYPE_CHECKING:
    from geomosaic.radiometry.colour_model import ColourModel, Trial
    from geomosaic.radiometry.corrections import CorrectionField

# The priors settle what differences cannot: the geometric mean of the gains is 1 and the mean of the offsets 0 in every
# group of connected images, and an image without overlaps stays as it is.
# Standard deviation of the logarithm of a gain, and of an offset in mean grey values; weak beside any overlap.
PRIOR_SIGMA = 1.0
# Images beyond which the normal equations are kept sparse.
MAX_DENSE = 1000


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
    change : RadiometricChange, optional
        What the corrections do to the photos' own values; None where there are none.
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
    change: RadiometricChange | None = None


def solve_gain_offset(images: int, bands: int, overlaps: Sequence[Overlap], *, hold: bool = True) -> Balance:
    """Gains and offsets of all images, band by band; 1 and 0 for images without overlaps.

    Parameters
    ----------
    images, bands : int
    overlaps : sequence of Overlap
        Grey values of pairs of images, numbered from 0; clipped ones left out.
    hold : bool
        Bound the drift along strips, see `overlaps.neighbourhoods`.

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
    gain, offset = solve_relations(images, first, second, relations, hold=hold)
    before = rms_difference(used, np.ones_like(gain), np.zeros_like(offset))
    return Balance(gain, offset, before, rms_difference(used, gain, offset), len(used))


def solve_relations(
    images: int, first: IntArray, second: IntArray, relations: Sequence[MajorAxis], *, hold: bool = True
) -> tuple[FloatArray, FloatArray]:
    """Gains and offsets of all images from the relations of overlapping pairs: time and memory grow with the pairs.

    Parameters
    ----------
    images : int
    first, second : int array (overlaps,)
        Numbers of the images of each pair; at least one pair.
    relations : sequence of MajorAxis
        Of each pair.
    hold : bool
        Bound the drift along strips, see `overlaps.neighbourhoods`.

    Returns
    -------
    gain, offset : array (images, bands)

    Raises
    ------
    SolveError
        Values that are not finite.
    """
    graph, every = _OverlapGraph.of(images, first, second, hold=hold), MajorAxis.stacked(relations)
    bands = range(every.count.shape[1])
    solved = [_solve_band(graph, every, band) for band in bands]
    gain, offset = (np.stack(each, axis=1) for each in zip(*solved, strict=True))
    if not (np.isfinite(gain).all() and np.isfinite(offset).all()):
        raise SolveError("the colour balance has no solution", hint="run with `balance=False`")
    return gain, offset


def rms_difference(overlaps: Sequence[Overlap], gain: FloatArray, offset: FloatArray) -> FloatArray:
    """Root mean square difference over overlaps after a linear correction.

    Parameters
    ----------
    overlaps : sequence of Overlap
    gain, offset : array (images, bands)

    Returns
    -------
    array (bands,)
        Grey values; NaN without samples.
    """
    total, count = np.zeros(gain.shape[1]), 0
    for pair in overlaps:
        i, j = pair.first, pair.second
        a, b = pair.a.astype(np.float64), pair.b.astype(np.float64)
        total += ((gain[i] * a + offset[i] - gain[j] * b - offset[j]) ** 2).sum(axis=0)
        count += len(a)
    return np.sqrt(total / count) if count else np.full(len(total), np.nan)


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
        near = neighbourhoods(images, first, second) if hold else []
        return cls(images, first, second, near, connected_groups(images, first, second) if near else None)

    def held(self, strength: float) -> tuple[IntArray, IntArray, FloatArray]:
        """Entries that the means of neighbourhoods add to the normal matrix, with a weight."""
        if not strength or self.images <= MAX_DENSE:
            return normal_entries(self.near if strength else [], strength)
        rows, cols, values = self._summed
        return rows, cols, strength * values

    @cached_property
    def _summed(self) -> tuple[IntArray, IntArray, FloatArray]:
        """Entries of weight 1, summed by place: neighbourhoods overlap, and theirs are seven times as many."""
        from scipy.sparse import coo_matrix

        rows, cols, values = normal_entries(self.near, 1.0)
        summed = coo_matrix((values, (rows, cols)), shape=(self.images, self.images)).tocsr().tocoo()
        return summed.row, summed.col, summed.data


def _solve_band(graph: _OverlapGraph, relations: MajorAxis, band: int) -> tuple[FloatArray, FloatArray]:
    def column(name: str) -> FloatArray:
        values: FloatArray = getattr(relations, name)[:, band]
        return values

    first, second = graph.first, graph.second
    ratio, variance = column("log_ratio"), column("log_ratio_variance")
    level = _adjusted(graph, ratio, variance + MIN_SIGMA**2)
    # How firmly drift is bounded depends on how much exposures vary, which a solution without the bound shows.
    sigma = mean_sigma(graph.near, level) if graph.near else None
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

    The mean of a neighbourhood is observed as that of `target`, 0 unless given, with the standard deviation `sigma`.
    """
    # The normal matrix is the weighted Laplacian of the graph plus the prior's weight on its diagonal.
    images, first, second = graph.images, graph.first, graph.second
    weight = PRIOR_SIGMA**2 / variance
    observed = weight * difference
    right = np.asarray(np.bincount(first, observed, images) - np.bincount(second, observed, images), dtype=np.float64)
    diagonal = 1.0 + np.bincount(first, weight, images) + np.bincount(second, weight, images)
    each = np.arange(images)
    strength = 0.0 if sigma is None else PRIOR_SIGMA**2 / sigma**2
    held = graph.held(strength)
    if target is not None:
        right = right + right_hand_side(graph.near, target, strength)
    rows = np.concatenate([first, second, each, held[0]])
    cols = np.concatenate([second, first, each, held[1]])
    values = np.concatenate([-weight, -weight, diagonal, held[2]])
    level = solve_normal_equations(rows, cols, values, right, MAX_DENSE)
    # Rows of a Laplacian sum to 0, so the values of every connected group do too; where drift is bounded they are made
    # to.
    if graph.group is not None:
        level = level - (np.bincount(graph.group, level) / np.bincount(graph.group))[graph.group]
    return level


MAX_ITERATIONS = 20
# Relative change of the spreads at which the iteration ends: far below their sampling error.
AXIS_CONVERGED = 1e-4


@dataclass(frozen=True)
class MajorAxis:
    """Robust means, spreads and correlation of two views a and b of the same ground.

    All arrays are (bands,), or (pairs, bands) for many pairs of views.

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

    @classmethod
    def stacked(cls, pairs: Sequence[MajorAxis]) -> MajorAxis:
        """Relations of many pairs as one."""
        return cls(*(np.array([getattr(pair, own.name) for pair in pairs]) for own in fields(cls)))

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
        # The logarithm of a ratio of spreads has the variance (1 − ρ²) / (n − 2) from sampling (D. I. Warton et al.,
        # Bivariate line-fitting methods for allometry, Biol. Rev. 81, 2006). Where the noise of the views is not in
        # proportion to their spreads the slope is off, but never by more than the factor ρ either way: the true line
        # lies between the two regressions (R. Frisch, 1934). A uniform distribution over ± log ρ has (log ρ)² / 3.
        variance = (1 - rho**2) / np.maximum(self.count - 2, 1) + np.log(rho) ** 2 / 3
        return np.where(known, variance, np.inf)


def standardised_major_axis(a: AnyArray, b: AnyArray) -> MajorAxis:
    """Standardised major axis of two views: their linear relation with noise in both, robust against outliers.

    Parameters
    ----------
    a, b : array (N, bands)
        Values of the same places, finite; N at least 1.
    """
    # Its slope is the ratio of the spreads, s_b / s_a; exchanging the views changes nothing but its sign as a
    # logarithm.
    # Not least squares of one view on the other, which takes the other for exact, so that noise pulls its slope towards
    # zero (regression dilution). Weights are Tukey's biweight of the standardised difference of the views: cars,
    # leaning houses and clipped values, which one view shows and the other does not, have none. They serve both views.
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
        weight = np.where(done, weight, biweight(difference / limit))
        total, before = weight.sum(axis=0), spread
        mean = np.where(done, mean, (weight * views).sum(axis=1) / total)
        centred = views - mean[:, None]
        spread = np.where(done, spread, np.sqrt((weight * centred**2).sum(axis=1) / total))
        one_tone = (spread <= least).any(axis=0)
        done = done | (np.abs(spread - before) <= AXIS_CONVERGED * spread + least).all(axis=0)
        if done.all():
            break
    product = (weight * centred[0] * centred[1]).sum(axis=0) / total
    scale = np.where(one_tone, 1.0, spread[0] * spread[1])
    correlation = np.where(one_tone, 0.0, product / scale)
    return MajorAxis(mean[0], mean[1], spread[0], spread[1], correlation, total**2 / (weight**2).sum(axis=0))
