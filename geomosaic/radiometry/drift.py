"""Drift of colour along strips, bounded by the mean correction of neighbouring images.

Overlaps observe differences. A small bias in each, say of light that falls off to one side, adds up along a strip:
after fifty photos of half a per cent each the last is a quarter off, and no overlap shows it. What is known besides is
that exposures vary from photo to photo, and a camera does not drift: **the mean correction of neighbouring images is
zero**, first of their gains, then of the level of their values: each neighbourhood keeps the mean of its own images.
Neighbours are those within as few steps from overlap to overlap as bring `NEIGHBOURS` images together; in a smaller
block this adds no information, and changes nothing.

The weight depends on how much exposures vary, s, the spread of single corrections about the mean of their neighbours
(as a logarithm): a mean of eleven that vary by a fifth is known less well than one of a camera with a fixed exposure.

Bound: the drift is a quantity x along the strip with x'' = x / L², L = `SIGMA_RATIO`·s / (standard deviation of the
step from one photo to the next, 0.003 at best). A bias b of each step makes a drift of no more than b·L, however long
the strip: 8 b for exposures that vary by a tenth, besides what their means vary by themselves; b for constant ones.
"""

from __future__ import annotations

import numpy as np

from geomosaic.types import FloatArray, IntArray

NEIGHBOURS = 11
"""Images whose mean correction is observed as 0."""
SIGMA_RATIO = 0.25
"""Standard deviation of that mean over the spread of single corrections; the mean of eleven has about this."""
MIN_SPREAD, MAX_SPREAD = 0.01, 0.3
"""Limits of the estimated spread of single corrections."""
MAX_PER_STEP = 40
"""Neighbours added at one step between overlaps; of more, every second, third ..."""


def neighbourhoods(images: int, first: IntArray, second: IntArray) -> list[IntArray]:
    """Neighbourhoods of the images that have more of their group beyond; none in small groups.

    Parameters
    ----------
    images : int
    first, second : int array (overlaps,)
        Numbers of the overlapping images.

    Returns
    -------
    list of int array
        Numbers of the images, sorted.
    """
    partners: list[set[int]] = [set() for _ in range(images)]
    for i, j in zip(first.tolist(), second.tolist(), strict=True):
        partners[i].add(j)
        partners[j].add(i)
    found = []
    for start in range(images):
        near, edge = {start}, {start}
        while edge and len(near) < NEIGHBOURS:
            ring = sorted(set().union(*(partners[i] for i in edge)) - near)
            edge = set(ring[:: -(-len(ring) // MAX_PER_STEP)]) if ring else set()
            near |= edge
            # The mean of a whole group is settled by the prior already: a neighbourhood must have others beyond it.
        if len(near) > 1 and set().union(*(partners[i] for i in near)) - near:
            found.append(np.array(sorted(near)))
    return found


def mean_sigma(near: list[IntArray], level: FloatArray) -> float:
    """Standard deviation with which the mean correction of a neighbourhood is observed.

    `SIGMA_RATIO` times the spread of single corrections about the mean of their neighbours, from the median absolute
    deviation.

    Parameters
    ----------
    near : list of int array
        Neighbourhoods, at least one.
    level : array (images,)
        Corrections solved without these observations, as logarithms of gains.

    Returns
    -------
    float
    """
    departures = np.concatenate([level[group] - level[group].mean() for group in near])
    spread = 1.4826 * float(np.median(np.abs(departures)))
    return SIGMA_RATIO * min(max(spread, MIN_SPREAD), MAX_SPREAD)


def normal_entries(near: list[IntArray], weight: float) -> tuple[IntArray, IntArray, FloatArray]:
    """Entries that observed means of 0 add to a normal matrix.

    Parameters
    ----------
    near : list of int array
        Neighbourhoods: numbers of the images.
    weight : float
        Inverse variance of the mean of one neighbourhood.

    Returns
    -------
    rows, cols : int array (entries,)
        Numbers of the images; pairs repeat, and their values are to be added.
    values : array (entries,)
    """
    if not near:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0)
    rows = np.concatenate([np.repeat(group, len(group)) for group in near])
    cols = np.concatenate([np.tile(group, len(group)) for group in near])
    values = np.concatenate(
        [np.full(len(group) ** 2, _observation_weight(group, weight) / len(group)) for group in near]
    )
    return rows, cols, values


def right_hand_side(near: list[IntArray], target: FloatArray, weight: float) -> FloatArray:
    """Right-hand side of observed means that are not 0.

    Parameters
    ----------
    near : list of int array
        Neighbourhoods, as in `normal_entries`.
    target : array (images,)
        The mean of x over each neighbourhood is observed to be that of `target`.
    weight : float
        Inverse variance, as in `normal_entries`.

    Returns
    -------
    array (images,)
    """
    pull = np.zeros(len(target))
    for group in near:
        pull[group] += _observation_weight(group, weight) * target[group].mean()
    return pull


def _observation_weight(group: IntArray, weight: float) -> float:
    """Weight for one image of a neighbourhood.

    Large neighbourhoods overlap each other more, so they repeat an observation, and drift less.
    """
    return weight / len(group) * min(1.0, NEIGHBOURS / len(group)) ** 3


def connected_groups(images: int, first: IntArray, second: IntArray) -> IntArray:
    """Connected components of the graph of overlaps.

    Parameters
    ----------
    images : int
    first, second : int array (overlaps,)
        Numbers of the overlapping images.

    Returns
    -------
    int array (images,)
        Number of each image's group, from 0.
    """
    group = np.arange(images)
    while True:
        # Each image takes the smallest number among its partners', then that of the image it now points to: pointer
        # doubling, so that a strip of n images needs about log n rounds instead of n.
        least = group.copy()
        np.minimum.at(least, first, group[second])
        np.minimum.at(least, second, group[first])
        least = least[least]
        if np.array_equal(least, group):
            return np.asarray(np.unique(group, return_inverse=True)[1])
        group = least
