"""Selection of colour terms by cross-validation: those that predict held-back samples better.

Each overlap is cut into eight bands; the odd ones are held back while the even ones are solved, and the other way
round. A term is kept if it reduces the held-back differences by a given part. More parameters always fit the samples
better that they were fitted to; whether they predict better has to be shown.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from geomosaic.radiometry.fields import ColourModel, solve_fields
from geomosaic.radiometry.normal_equations import ColourSetting
from geomosaic.radiometry.overlap_samples import PairedSamples
from geomosaic.types import FloatArray

MIN_IMPROVEMENT = 0.03
"""Part by which a term must reduce the held-back differences."""
MIN_SAMPLES = 2000
"""Samples of all overlaps without which no term is tried."""
ORDER = ("vignetting", "trend", "hotspot", "haze", "gamma", "dodging")
PREREQUISITES = {"hotspot": "trend", "haze": "vignetting"}
"""Terms that are only tried after another was kept, which explains part of the same effect."""
ITERATIONS = 4
"""Gauss-Newton steps of a trial, which need not converge."""
OUTLIER_LIMIT = 3.0
"""Robust standard deviations at which differences are capped: moving objects and clouds."""


@dataclass(frozen=True)
class Trial:
    """Set of terms and how well it predicts.

    Attributes
    ----------
    terms : tuple of str
    left : float
        RMS of held-back differences of corrected values, relative to their mean.
    kept : bool
    """

    terms: tuple[str, ...]
    left: float
    kept: bool


def solve_terms(
    views: PairedSamples, setting: ColourSetting, gain: FloatArray, offset: FloatArray, linear: Collection[int] = ()
) -> ColourModel:
    """Colour model with the terms of a setting, dodging included.

    Parameters
    ----------
    views, setting, gain, offset, linear
        As in `fields.solve_fields`.

    Returns
    -------
    ColourModel
    """
    fields = solve_fields(views, setting, gain, offset, linear)
    if "dodging" in setting.terms:
        from geomosaic.radiometry.local_gains import solve_dodging

        return solve_dodging(fields, views)
    return fields


def select_terms(
    views: PairedSamples, setting: ColourSetting, gain: FloatArray, offset: FloatArray, linear: Collection[int] = ()
) -> tuple[frozenset[str], list[Trial]]:
    """Terms that improve the prediction of held-back samples, and all trials.

    A hotspot is only tried where a trend was kept, and haze where light changes towards the corners. Images of too
    little overlap keep gain and offset.

    Parameters
    ----------
    views, setting, gain, offset, linear
        As in `fields.solve_fields`.

    Returns
    -------
    kept : frozenset of str
        Of `bases.TERMS`; empty where gain and offset are enough, or there are fewer than `MIN_SAMPLES` samples.
    trials : list of Trial
        In the order of `ORDER`, the model without further terms first.
    """
    kept: frozenset[str] = frozenset()
    if np.count_nonzero(views.known) < MIN_SAMPLES:
        return kept, []
    halves = views.halves()
    limits = _limits(views, setting, gain, offset, linear)

    def score(terms: frozenset[str]) -> float:
        own = replace(setting, terms=terms, rounds=ITERATIONS)
        total, count = np.zeros(views.a.shape[2]), 0
        for learnt, asked in (halves, halves[::-1]):
            off = _differences(solve_terms(views.only(learnt), own, gain, offset, linear), views.only(asked))
            # Capped, not left out: a term must not look better by turning more samples into outliers.
            total += (np.minimum(np.abs(off), limits) ** 2).sum(axis=0)
            count += len(off)
        return float(np.sqrt(np.mean(total / max(count, 1))))

    best = score(kept)
    trials = [Trial((), best, True)]
    for term in ORDER:
        if PREREQUISITES.get(term, term) not in kept | {term}:
            continue
        left = score(kept | {term})
        good = left < (1 - MIN_IMPROVEMENT) * best
        trials.append(Trial(tuple(t for t in ORDER if t in kept | {term}), left, good))
        if good:
            kept, best = kept | {term}, left
    return kept, trials


def _limits(
    views: PairedSamples, setting: ColourSetting, gain: FloatArray, offset: FloatArray, linear: Collection[int]
) -> FloatArray:
    """Largest difference (bands,) that counts in full, from the model of gain and offset."""
    plain = solve_terms(views, replace(setting, terms=frozenset()), gain, offset, linear)
    return np.asarray(OUTLIER_LIMIT * 1.4826 * np.median(np.abs(_differences(plain, views)), axis=0) + 1e-12)


def _differences(fields: ColourModel, views: PairedSamples) -> FloatArray:
    """Differences (N, bands) of corrected values, relative to the mean value.

    Divided by the slope of the correction: one that makes all values smaller makes noise smaller too, and is no better
    for it.
    """
    known, step = views.known, 1e-3 * fields.setting.reach
    one, other = (side[known] for side in fields.corrected(views))
    # By differences: the model has no formula for its slope once dodging is in.
    more = fields.corrected(replace(views, a=views.a + step, b=views.b + step))
    slope = np.sqrt((((more[0][known] - one) / step) ** 2 + ((more[1][known] - other) / step) ** 2) / 2)
    level = np.abs(views.a + views.b)[known].mean(axis=0) / 2
    return np.asarray((one - other) / np.maximum(slope, 1e-9) / np.maximum(level, 1e-12))
