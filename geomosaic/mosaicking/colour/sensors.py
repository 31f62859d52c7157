"""Colours of images of several sensors: which overlaps can be compared, and the brightness of panchromatic images.

A gain and an offset bring two images to one colour where they show the ground alike but for the exposure. Bands of
other wavelengths, or another season, show it otherwise: what fits one field makes the next worse. Between images of
different declared blocks that is measured, by the correlation of each band over the overlap. A panchromatic image has
no colour to compare. One gain and one offset for all its bands bring it to the mean of the others', and it stays grey.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomosaic.errors import listed
from geomosaic.mosaicking.precedence import is_grey
from geomosaic.radiometry.corrections import CorrectionField
from geomosaic.radiometry.gain_offset import Balance
from geomosaic.radiometry.overlaps import Overlap
from geomosaic.render.photos import Photos
from geomosaic.types import AnyArray

# Correlation of a band, below which a line explains less than half of what differs from place to place.
LEAST_CORRELATION = 0.7


@dataclass(frozen=True)
class ComparedOverlaps:
    """Overlaps by what they can tell of colours.

    Attributes
    ----------
    pairs : list of Overlap
        Those that colours are solved from.
    grey : list of Overlap
        Those of a panchromatic image with one of several bands.
    notes : list of str
        Pairs that show the ground too differently, in words.
    """

    pairs: list[Overlap]
    grey: list[Overlap]
    notes: list[str]


def compared_overlaps(photos: Photos, overlaps: Sequence[Overlap]) -> ComparedOverlaps:
    """Overlaps that can be compared in colour, those with panchromatic images, and notes of the rest.

    Parameters
    ----------
    photos : Photos
    overlaps : sequence of Overlap

    Returns
    -------
    ComparedOverlaps
    """
    scenes = photos.scenes
    pairs, grey, apart = [], [], []
    for pair in overlaps:
        one, other = scenes[pair.first], scenes[pair.second]
        if is_grey(one) != is_grey(other):
            grey.append(pair)
            continue
        # Without texture, such as water, noise alone makes a correlation low: such an overlap counts as registered.
        trusted = one.group == other.group or not pair.registration.decided
        least = 1.0 if trusted else min(_correlations(pair.a, pair.b))
        if least >= LEAST_CORRELATION:
            pairs.append(pair)
        else:
            apart.append(f"{one.name} and {other.name} ({least:.2f})")
    notes = []
    if apart:
        notes.append(
            "too different for one colour balance, by the least correlation of a band over the overlap (other bands, "
            f"season or light; or misplaced): {listed(apart, 5, '; ')}"
        )
    return ComparedOverlaps(pairs, grey, notes)


def _correlations(a: AnyArray, b: AnyArray) -> list[float]:
    """Correlation of each band (bands,) of samples (N, bands); 1 where one of both is even."""
    found = []
    for x, y in zip(np.asarray(a, dtype=np.float64).T, np.asarray(b, dtype=np.float64).T, strict=True):
        spread = x.std() * y.std()
        found.append(1.0 if spread == 0.0 else float(((x - x.mean()) * (y - y.mean())).mean() / spread))
    return found


def with_grey_matched(photos: Photos, solved: Balance, grey: Sequence[Overlap]) -> Balance:
    """Balance in which one gain and one offset bring each panchromatic image to the mean of the others' bands.

    Parameters
    ----------
    photos : Photos
    solved : Balance
        Of the images of several bands.
    grey : sequence of Overlap
        Of a panchromatic image with one of several bands.

    Returns
    -------
    Balance
        The same one where there are no such overlaps.
    """
    samples: dict[int, list[tuple[AnyArray, AnyArray]]] = {}
    for pair in grey:
        first = is_grey(photos.scenes[pair.first])
        index, other = (pair.first, pair.second) if first else (pair.second, pair.first)
        own, theirs = (pair.a, pair.b) if first else (pair.b, pair.a)
        shown = (solved.gain[other] * theirs + solved.offset[other]).mean(axis=1)
        samples.setdefault(index, []).append((np.asarray(own[:, 0], dtype=np.float64), shown))
    gain, offset, notes = solved.gain.copy(), solved.offset.copy(), list(solved.notes)
    curves = [curve for curve in solved.curves or () if isinstance(curve, CorrectionField)]
    for index, parts in sorted(samples.items()):
        own, shown = (np.concatenate(each) for each in zip(*parts, strict=True))
        name, alike = photos.scenes[index].name, _correlations(own[:, None], shown[:, None])[0]
        if alike < LEAST_CORRELATION or own.std() == 0.0:
            notes.append(f"{name}: its grey values stay, they correlate by {alike:.2f} with the others' mean")
            continue
        # Equal means and spreads: a regression would lower the contrast.
        factor = float(f"{shown.std() / own.std():.6g}")
        shift = float(f"{shown.mean() - factor * own.mean():.6g}")
        gain[index], offset[index] = factor, shift
        if curves:
            curves[index] = curves[index].then(np.full(gain.shape[1], factor), np.full(gain.shape[1], shift))
        notes.append(
            f"{name}: grey values times {factor:.3g} and {shift:+.3g}, to the mean of the others' bands (correlation "
            f"{alike:.2f})"
        )
    changed = replace(solved, gain=gain, offset=offset, notes=tuple(notes))
    return replace(changed, curves=tuple(curves)) if curves else changed
