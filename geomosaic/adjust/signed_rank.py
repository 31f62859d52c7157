"""Wilcoxon's signed-rank test in one direction; the statistics package takes longer to load than a fit to make."""

from __future__ import annotations

from math import erfc, sqrt

import numpy as np

from geomosaic.types import FloatArray

EXACT = 50
"""Differences up to which all signs are counted; the normal distribution serves beyond, and where lengths are equal."""


def signed_rank_probability(differences: FloatArray) -> float:
    """Probability by chance of differences (N,) that are so much above 0 (Wilcoxon 1945).

    Differences of 0 say nothing and are left out; 1 where none is left.
    """
    told = differences[differences != 0.0]
    count = len(told)
    if not count:
        return 1.0
    _, group, sizes = np.unique(np.abs(told), return_inverse=True, return_counts=True)
    ranks = (np.cumsum(sizes) - (sizes - 1) / 2.0)[group]
    above = float(ranks[told > 0.0].sum())
    if count <= EXACT and (sizes == 1).all():
        return _exact(count, round(above))
    variance = count * (count + 1) * (2 * count + 1) / 24.0 - float((sizes**3 - sizes).sum()) / 48.0
    return 0.5 * erfc((above - count * (count + 1) / 4.0) / sqrt(2.0 * variance)) if variance > 0.0 else 0.5


def _exact(count: int, above: int) -> float:
    """Share of all choices of signs whose positive ranks sum to `above` or more."""
    ways = np.zeros(count * (count + 1) // 2 + 1)
    ways[0] = 1.0
    for rank in range(1, count + 1):
        ways[rank:] += ways[:-rank].copy()
    return float(ways[above:].sum() / 2.0**count)
