"""Acceptance of a colour balance: registered overlaps, better held-out parts of them, whole photos not less alike.

A solution always fits the overlaps better that it was fitted to. Two questions show whether it is one:

1. **Cross-validation.** Each overlap is cut into eight bands. Gains and offsets solved from every second band must
   bring the means of the others closer together. Means of bands, not single samples: noise, leaning houses and moved
   cars differ from sample to sample and no gain can help that, while a wrong exposure shifts them all.
2. **Levels of whole photos.** Exposures that differ make photos of different level, and gains that correct them make
   levels more alike. Gains that make them less alike can be right, as automatic exposure evens out what the ground is
   not; or they stand for light that falls across each photo, whose bright side meets the dark side of the next, and
   make a ramp over the block. Where the ground decides, gains stay as they are once terms for such light are solved
   with them; where light does, they go back (omitted-variable bias).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geomosaic.estimation.statistics import MAD_TO_SIGMA
from geomosaic.radiometry.gain_offset import solve_gain_offset
from geomosaic.radiometry.overlaps import Overlap
from geomosaic.types import AnyArray, FloatArray

# Bands of an overlap, every second of which is held out.
PARTS = 8
# Part of the differences that may be left: less of a change than a tenth is not worth changing values for.
CLEARLY_BETTER = 0.9
# Robust standard deviations at which differences are capped: a cloud in one photo must not decide.
OUTLIER_LIMIT = 3.0
# Standard deviation that gains add to the logarithms of the levels beyond which they are doubted. Ground differs from
# photo to photo: right gains of four sample photos add 0.06, a ramp over four aerial photos (NGI) 0.17.
MIN_SPREAD = 0.1


def registered_overlaps(overlaps: Sequence[Overlap]) -> tuple[list[Overlap], list[Overlap]]:
    """Overlaps that can tell gains, and those that cannot, as their views show different ground.

    Overlaps without texture to judge by are trusted, unless at least half of those that can be judged are
    misregistered: then the orientation is no good anywhere.

    Parameters
    ----------
    overlaps : sequence of Overlap

    Returns
    -------
    registered, misregistered : list of Overlap
    """
    failed = sum(1 for pair in overlaps if pair.registration.failed)
    decided = sum(1 for pair in overlaps if pair.registration.decided)
    distrusted = failed > 0 and 2 * failed >= decided
    bad = [pair.registration.failed or (distrusted and not pair.registration.decided) for pair in overlaps]
    return (
        [pair for pair, out in zip(overlaps, bad, strict=True) if not out],
        [pair for pair, out in zip(overlaps, bad, strict=True) if out],
    )


def held_out_ratio(images: int, bands: int, overlaps: Sequence[Overlap]) -> float:
    """Differences of held-out means with gains and offsets over those without.

    Parameters
    ----------
    images, bands : int
    overlaps : sequence of Overlap

    Returns
    -------
    float
        Ratio of the RMS, relative to the level of each band; 1 where there is nothing to tell or to correct.
    """
    used = [pair for pair in overlaps if len(pair.a) >= PARTS]
    parts = [np.arange(len(pair.a)) * PARTS // len(pair.a) for pair in used]
    before: list[FloatArray] = []
    after: list[FloatArray] = []
    for odd in (0, 1):
        learnt = [_only(pair, part % 2 != odd) for pair, part in zip(used, parts, strict=True)]
        solved = solve_gain_offset(images, bands, learnt)
        for pair, part in zip(used, parts, strict=True):
            i, j = pair.first, pair.second
            level = np.maximum(np.abs(pair.a + pair.b).mean(axis=0, dtype=np.float64) / 2, 1e-12)
            for k in range(odd, PARTS, 2):
                a, b = (view[part == k].mean(axis=0, dtype=np.float64) for view in (pair.a, pair.b))
                before.append((a - b) / level)
                after.append((solved.gain[i] * a + solved.offset[i] - solved.gain[j] * b - solved.offset[j]) / level)
    if not before:
        return 1.0
    plain, left = np.abs(np.array(before)), np.abs(np.array(after))
    limit = OUTLIER_LIMIT * MAD_TO_SIGMA * np.median(plain, axis=0)
    least = float((np.minimum(plain, limit) ** 2).mean())
    return 1.0 if least <= 0 else float(np.sqrt((np.minimum(left, limit) ** 2).mean() / least))


def _only(pair: Overlap, chosen: AnyArray) -> Overlap:
    return replace(pair, a=pair.a[chosen], b=pair.b[chosen], cells=None if pair.cells is None else pair.cells[chosen])


def added_spread(level: FloatArray, shown: FloatArray) -> float:
    """Standard deviation that corrections add to the logarithms of the levels of whole photos.

    Parameters
    ----------
    level, shown : array (images, bands)
        Median of each photo before and after; NaN where unknown.

    Returns
    -------
    float
        Root of the variance after less that before, of the band where it is largest; 0 where levels get more alike.
    """
    known = np.isfinite(level).all(axis=1) & (level > 0).all(axis=1) & (shown > 0).all(axis=1)
    if np.count_nonzero(known) < 2:
        return 0.0
    added = np.log(shown[known]).var(axis=0) - np.log(level[known]).var(axis=0)
    return float(np.sqrt(max(added.max(initial=0.0), 0.0)))
