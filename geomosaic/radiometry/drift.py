"""Hold back colour creep: corrections that add up from image to image are held back, those of single images are not.

Overlaps observe differences. A small bias in each, say of light that falls off to one side, adds up along a strip:
after fifty photos of half a per cent each the last is a quarter off, and no overlap shows it. What is known besides is
that exposures vary from photo to photo, and a camera does not drift: **the mean correction of neighbouring images is
none**, first of their gains, then of the level of their values: each neighbourhood keeps the mean of its own images.
Neighbours are those within as few steps from overlap to overlap as bring `NEIGHBOURS` images together; in a smaller
block this says nothing new, and changes nothing.

How firmly depends on how much exposures vary, s, the spread of single corrections about the mean of their neighbours
(as a logarithm): a mean of eleven that vary by a fifth is known less well than one of a camera with a fixed exposure.

Bound: the creep is a quantity x along the strip with x'' = x / L², L = `FIRM`·s / (standard deviation of the step from
one photo to the next, 0.003 at best). A bias b of each step makes a creep of no more than b·L, however long the strip:
for exposures that vary by a tenth 8 b, and what their means vary by themselves; b for steady ones.
"""

from __future__ import annotations

import numpy as np

from geomosaic.types import FloatArray, IntArray

NEIGHBOURS = 11
"""Images whose mean correction is held."""
FIRM = 0.25
"""Standard deviation of that mean over the spread of single corrections; the mean of eleven has about this."""
LEAST_SPREAD, MOST_SPREAD = 0.01, 0.3
"""Between which the spread is believed."""
MOST_NEIGHBOURS = 40
"""Of those, how many are taken at each step: every second, third ... of more."""


def neighbourhoods(images: int, first: IntArray, second: IntArray) -> list[IntArray]:
    """Numbers of the images near each image that has more of its group beyond; none of small groups."""
    partners: list[set[int]] = [set() for _ in range(images)]
    for i, j in zip(first.tolist(), second.tolist(), strict=True):
        partners[i].add(j)
        partners[j].add(i)
    found = []
    for start in range(images):
        near, edge = {start}, {start}
        while edge and len(near) < NEIGHBOURS:
            ring = sorted(set().union(*(partners[i] for i in edge)) - near)
            edge = set(ring[:: -(-len(ring) // MOST_NEIGHBOURS)]) if ring else set()
            near |= edge
        if len(near) > 1 and set().union(*(partners[i] for i in near)) - near:
            found.append(np.array(sorted(near)))
    return found


def sigma(near: list[IntArray], level: FloatArray) -> float:
    """Standard deviation with which means are held, from corrections (images,) that were not held."""
    departures = np.concatenate([level[group] - level[group].mean() for group in near])
    spread = 1.4826 * float(np.median(np.abs(departures)))
    return FIRM * min(max(spread, LEAST_SPREAD), MOST_SPREAD)


def entries(near: list[IntArray], weight: float) -> tuple[IntArray, IntArray, FloatArray]:
    """Rows, columns and values that mean corrections of 0 add to a normal matrix, each of a given weight."""
    if not near:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0)
    rows = np.concatenate([np.repeat(group, len(group)) for group in near])
    cols = np.concatenate([np.tile(group, len(group)) for group in near])
    values = np.concatenate([np.full(len(group) ** 2, _share(group, weight) / len(group)) for group in near])
    return rows, cols, values


def pulls(near: list[IntArray], target: FloatArray, weight: float) -> FloatArray:
    """Right-hand side (images,) of the same observations, where the mean of x is that of `target` (images,)."""
    pull = np.zeros(len(target))
    for group in near:
        pull[group] += _share(group, weight) * target[group].mean()
    return pull


def _share(group: IntArray, weight: float) -> float:
    """Of one image in it. Neighbourhoods of many images repeat each other and creep less; they count less."""
    return weight / len(group) * min(1.0, NEIGHBOURS / len(group)) ** 3


def groups(images: int, first: IntArray, second: IntArray) -> IntArray:
    """Number (images,) of the group of images that overlaps connect."""
    group = np.arange(images)
    while True:
        least = group.copy()
        np.minimum.at(least, first, group[second])
        np.minimum.at(least, second, group[first])
        least = least[least]
        if np.array_equal(least, group):
            return np.asarray(np.unique(group, return_inverse=True)[1])
        group = least
