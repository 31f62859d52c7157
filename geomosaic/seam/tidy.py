"""Labels of cells put in order: no gaps at the rim, no islands of a few cells."""

from __future__ import annotations

import numpy as np

from geomosaic.types import IntArray

SMALLEST = 30
"""Cells; smaller islands of one image within others are given away."""


def widened(label: IntArray, cells: int) -> IntArray:
    """Labels carried over so many cells into what has none: no sliver is left between cells and exact outlines."""
    from scipy.ndimage import distance_transform_edt

    if (label >= 0).all() or not (label >= 0).any():
        return label
    far, (rows, cols) = distance_transform_edt(label < 0, return_indices=True)
    return np.where(far <= cells, label[rows, cols], -1)


def without_islands(label: IntArray, smallest: int = SMALLEST) -> IntArray:
    """Give islands of fewer cells to the image that surrounds them most."""
    from scipy.ndimage import find_objects

    label = label.copy()
    for value, box in enumerate(find_objects(label + 1)):
        if box is None:
            continue
        rows, cols = box
        own = slice(max(rows.start - 1, 0), rows.stop + 1), slice(max(cols.start - 1, 0), cols.stop + 1)
        _give_away(label[own], value, smallest)
    return label


def _give_away(label: IntArray, value: int, smallest: int) -> None:
    from scipy.ndimage import binary_dilation, find_objects
    from scipy.ndimage import label as parts_of

    parts, count = parts_of(label == value)
    sizes = np.bincount(parts.ravel(), minlength=count + 1)
    if count < 2 or sizes[1:].min() >= smallest:
        return
    boxes = find_objects(parts)
    for part in np.flatnonzero(sizes < smallest).tolist():
        if part == 0:
            continue
        rows, cols = boxes[part - 1]
        around = slice(max(rows.start - 1, 0), rows.stop + 1), slice(max(cols.start - 1, 0), cols.stop + 1)
        own = parts[around] == part
        rim = label[around][binary_dilation(own) & ~own]
        rim = rim[rim >= 0]
        if len(rim):
            label[around][own] = np.bincount(rim).argmax()


def without_spurs(label: IntArray, rounds: int = 3) -> IntArray:
    """Give cells with hardly a neighbour of their own to the image that most neighbours have: spurs a cell wide go."""
    label = label.copy()
    for _ in range(rounds):
        wide = np.pad(label, 1, mode="edge")
        shape = label.shape
        around = [wide[r : r + shape[0], c : c + shape[1]] for r in range(3) for c in range(3) if (r, c) != (1, 1)]
        same = np.zeros(shape, dtype=np.int8)
        for other in around:
            same += other == label
        weak = np.nonzero((same <= 2) & (label >= 0))
        if not len(weak[0]):
            break
        others = np.stack([other[weak] for other in around])
        votes = (others[:, None] == others[None]).sum(axis=0) * (others >= 0)
        best = others[votes.argmax(axis=0), np.arange(others.shape[1])]
        label[weak] = np.where(best >= 0, best, label[weak])
    return label
