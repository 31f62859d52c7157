"""Matches without those that are not of the ground: what stays at one place of the images while the ground moves on."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from geomosaic.matching.features import Features
from geomosaic.matching.fixed_features import fixed_features, unmoved
from geomosaic.matching.tracks import PairMatches
from geomosaic.matching.two_view import LEAST_MATCHES
from geomosaic.types import BoolArray, FloatArray, IntArray

# Matches of a pair by their numbers, from some features of both images; None where they show nothing in common.
Rematch = Callable[[int, int, Sequence[Features]], PairMatches | None]


def of_the_ground(
    pairs: Sequence[PairMatches | None],
    found: Sequence[Features],
    sizes: IntArray,
    reach: FloatArray,
    rematch: Rematch,
) -> list[PairMatches]:
    """Matches of pairs without those of data strips, clocks, marks and scratches.

    Parameters
    ----------
    pairs : sequence of PairMatches or None
    found : sequence of Features (M,)
    sizes : int array (M, 2)
        Width and height of each image.
    reach : array (M,)
        Pixels within which the place of a feature is found again.
    rematch : callable
        Matches of two images by their numbers, with the features that are left of all: where what stays is most of
        a pair, it has found the geometry of nothing.

    Returns
    -------
    list of PairMatches
        Those of which enough is left.
    """
    fixed = fixed_features(found, sizes, reach)
    free = [each if not out.any() else each.select(~out) for each, out in zip(found, fixed, strict=True)]
    first = [_first_of_places(each) for each in found]
    kept = []
    for pair in pairs:
        if pair is None:
            continue
        i, j = pair.first, pair.second
        one, other = (first[k][pair.places[:, side]] for side, k in enumerate((i, j)))
        out: BoolArray = fixed[i][one] | fixed[j][other]
        if 2 * out.sum() > len(out):
            again = rematch(i, j, free)
            if again is None:
                continue
            # Numbers of places among those that are left, as numbers among all.
            own = [found[k].place[np.flatnonzero(~fixed[k])][_first_of_places(free[k])] for k in (i, j)]
            pair = replace(again, places=np.stack([own[s][again.places[:, s]] for s in (0, 1)], axis=1))
            one, other = (first[k][pair.places[:, side]] for side, k in enumerate((i, j)))
            out = np.zeros(len(one), dtype=bool)
        if (sizes[i] == sizes[j]).all():
            rest = np.flatnonzero(~out)
            apart = found[i].colrow[one[rest]], found[j].colrow[other[rest]]
            out[rest] = unmoved(*apart, float(max(reach[i], reach[j])))
        if out.any():
            pair = replace(pair, places=pair.places[~out], cost=pair.cost[~out])
        if len(pair.places) >= LEAST_MATCHES:
            kept.append(pair)
    return kept


def _first_of_places(features: Features) -> IntArray:
    """First feature of each place."""
    first: IntArray = np.unique(features.place, return_index=True)[1]
    return first
