"""Which terms are warranted: those that make images agree where they were not asked.

Each overlap is cut into eight bands; the odd ones are held back while the even ones are solved, and the other way
round. A term is kept if it brings the held-back differences down by a given share. More parameters always fit better
what they were fitted to; that they predict better must be earned.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from geomosaic.radiometry.fields import Fields, solve_fields
from geomosaic.radiometry.normal_equations import Setting
from geomosaic.radiometry.overlap_samples import Views
from geomosaic.types import FloatArray

WARRANTED = 0.03
"""Share by which held-back differences must fall."""
LEAST_SAMPLES = 2000
"""Of all overlaps: fewer are no ground for a choice."""
ORDER = ("vignetting", "trend", "hotspot", "haze", "gamma", "dodging")
NEEDS = {"hotspot": "trend", "haze": "vignetting"}
"""Terms that show as another first."""
ROUNDS = 4
"""Steps of a trial, which need not be exact."""
BEYOND = 3.0
"""Robust deviations beyond which a difference counts no more: moving things and clouds."""


@dataclass(frozen=True)
class Trial:
    """A set of terms and how well it predicts.

    Attributes
    ----------
    terms : tuple of str
    left : float
        RMS of held-back differences of corrected values, in parts of their mean.
    kept : bool
    """

    terms: tuple[str, ...]
    left: float
    kept: bool


def solve_terms(
    views: Views, setting: Setting, gain: FloatArray, offset: FloatArray, linear: Collection[int] = ()
) -> Fields:
    """Solve what the setting's terms name, nets of dodging included."""
    fields = solve_fields(views, setting, gain, offset, linear)
    if "dodging" in setting.terms:
        from geomosaic.radiometry.local_gains import dodge

        return dodge(fields, views)
    return fields


def choose(
    views: Views, setting: Setting, gain: FloatArray, offset: FloatArray, linear: Collection[int] = ()
) -> tuple[frozenset[str], list[Trial]]:
    """Terms that are warranted, and all that were tried.

    A hotspot is only looked for where a trend is, and haze where light changes towards the corners. Images of too
    little overlap keep gain and offset.
    """
    kept: frozenset[str] = frozenset()
    if np.count_nonzero(views.known) < LEAST_SAMPLES:
        return kept, []
    halves = views.halves()
    limits = _limits(views, setting, gain, offset, linear)

    def score(terms: frozenset[str]) -> float:
        own = replace(setting, terms=terms, rounds=ROUNDS)
        total, count = np.zeros(views.a.shape[2]), 0
        for learnt, asked in (halves, halves[::-1]):
            off = _differences(solve_terms(views.only(learnt), own, gain, offset, linear), views.only(asked))
            total += (np.minimum(np.abs(off), limits) ** 2).sum(axis=0)
            count += len(off)
        return float(np.sqrt(np.mean(total / max(count, 1))))

    best = score(kept)
    trials = [Trial((), best, True)]
    for term in ORDER:
        if NEEDS.get(term, term) not in kept | {term}:
            continue
        left = score(kept | {term})
        good = left < (1 - WARRANTED) * best
        trials.append(Trial(tuple(t for t in ORDER if t in kept | {term}), left, good))
        if good:
            kept, best = kept | {term}, left
    return kept, trials


def _limits(
    views: Views, setting: Setting, gain: FloatArray, offset: FloatArray, linear: Collection[int]
) -> FloatArray:
    plain = solve_terms(views, replace(setting, terms=frozenset()), gain, offset, linear)
    return np.asarray(BEYOND * 1.4826 * np.median(np.abs(_differences(plain, views)), axis=0) + 1e-12)


def _differences(fields: Fields, views: Views) -> FloatArray:
    """Differences (N, bands) of corrected values, in parts of the mean value.

    They are told in values as they came: a correction that makes everything smaller makes noise smaller too, and is no
    better for it.
    """
    known, step = views.known, 1e-3 * fields.setting.reach
    one, other = (side[known] for side in fields.corrected(views))
    more = fields.corrected(replace(views, a=views.a + step, b=views.b + step))
    steep = np.sqrt((((more[0][known] - one) / step) ** 2 + ((more[1][known] - other) / step) ** 2) / 2)
    level = np.abs(views.a + views.b)[known].mean(axis=0) / 2
    return np.asarray((one - other) / np.maximum(steep, 1e-9) / np.maximum(level, 1e-12))
