"""Seams where two images look most alike: a watershed between the images' own ground (after Soille, 2006).

Each cell has a first and a second image, by the nearness of their centres. The ground that is clearly the first one's
is its marker. Between markers the cells are flooded in the order of how alike the two images are there, the least alike
first; where floods of two images meet, on the ridge of likeness, runs the seam. So it passes a leaning house or a moved
car on the side where both images agree, and of all ways the worst place on it is the least bad one.

P. Soille, *Morphological image compositing*, IEEE Transactions on Pattern Analysis and Machine Intelligence 28, 2006.
"""

from __future__ import annotations

import numpy as np

from geomosaic.types import AnyArray, BoolArray, FloatArray, IntArray

FREE = 0.6
"""Part of the way between two centres, to both sides of the middle together, in which a seam may run."""
SMALLEST = 30
"""Cells; smaller islands of one image within others are given away."""


def nearest_two(centres: FloatArray, places: FloatArray, covers: AnyArray) -> tuple[IntArray, IntArray, BoolArray]:
    """First and second image of cells, by the nearness of their centres, and whether a cell is clearly the first's.

    Parameters
    ----------
    centres : array (K, 2)
        Of the candidate images, in map units.
    places : array (N, 2)
        Of the cells.
    covers : bool array (K, N)
        Whether an image shows a cell.

    Returns
    -------
    first, second : int array (N,)
        Numbers among the candidates, -1 where there is none.
    marker : bool array (N,)
    """
    distance = np.hypot(*(places[None] - centres[:, None]).transpose(2, 0, 1))
    distance = np.where(covers, distance, np.inf)
    order = np.argsort(distance, axis=0, kind="stable")
    first = np.where(np.isfinite(distance.min(axis=0)), order[0], -1)
    if len(centres) < 2:
        return first, np.full_like(first, -1), first >= 0
    each = np.arange(len(places))
    d1, d2 = distance[order[0], each], distance[order[1], each]
    second = np.where(np.isfinite(d2), order[1], -1)
    apart = np.hypot(*(centres[order[0]] - centres[order[1]]).T)
    with np.errstate(invalid="ignore"):
        marker = (first >= 0) & ((second < 0) | (d2 - d1 > FREE * apart))
    return first, second, marker


def unlike(one: AnyArray, other: AnyArray, both: BoolArray) -> FloatArray:
    """How different two images of the same cells are: root of the summed squares over bands, the worst of 3 × 3 cells.

    Parameters
    ----------
    one, other : array (rows, cols, bands)
        Corrected values.
    both : bool array (rows, cols)
        Cells that both know; 0 elsewhere.
    """
    from scipy.ndimage import maximum_filter

    difference = np.sqrt(((one.astype(np.float64) - other) ** 2).sum(axis=-1))
    return np.asarray(maximum_filter(np.where(both, difference, 0.0), size=3, mode="nearest"))


def flood(first: IntArray, second: IntArray, marker: BoolArray, cost: FloatArray) -> IntArray:
    """Labels (rows, cols): the image that shows each cell, -1 where none does.

    Parameters
    ----------
    first : int array (rows, cols)
        The image that is nearest, -1 where none shows the cell.
    second : int array (rows, cols)
        The next one, -1 where there is none.
    marker : bool array (rows, cols)
        Cells that stay with the first.
    cost : array (rows, cols)
        How bad a seam is there.
    """
    from scipy.ndimage import watershed_ift

    known = first >= 0
    if not known.any():
        return first.copy()
    high = float(cost[known & ~marker].max(initial=0.0)) or 1.0
    # The seam is to run where images are alike: there the relief is highest, and floods meet last.
    relief = np.round(65535.0 * (1.0 - np.clip(cost / high, 0.0, 1.0))).astype(np.uint16)
    outside = int(first.max()) + 2
    seeds = np.where(marker, first + 1, np.where(known, 0, outside)).astype(np.int32)
    flooded = watershed_ift(relief, seeds, structure=np.ones((3, 3), dtype=np.int32))
    label = flooded.astype(first.dtype) - 1
    return np.where(known & (label == second), second, first)


def widened(label: IntArray, cells: int) -> IntArray:
    """Labels carried over so many cells into what has none: no sliver is left between cells and exact outlines."""
    from scipy.ndimage import distance_transform_edt

    if (label >= 0).all() or not (label >= 0).any():
        return label
    far, (rows, cols) = distance_transform_edt(label < 0, return_indices=True)
    return np.where(far <= cells, label[rows, cols], -1)


def without_islands(label: IntArray, smallest: int = SMALLEST) -> IntArray:
    """Give islands of fewer cells to the image that surrounds them most."""
    from scipy.ndimage import binary_dilation, find_objects
    from scipy.ndimage import label as parts_of

    label = label.copy()
    for value in np.unique(label[label >= 0]).tolist():
        parts, count = parts_of(label == value)
        if count < 2:
            continue
        sizes = np.bincount(parts.ravel(), minlength=count + 1)
        boxes = find_objects(parts)
        for part in range(1, count + 1):
            if sizes[part] >= smallest:
                continue
            rows, cols = boxes[part - 1]
            around = (slice(max(rows.start - 1, 0), rows.stop + 1), slice(max(cols.start - 1, 0), cols.stop + 1))
            own = parts[around] == part
            rim = label[around][binary_dilation(own) & ~own]
            rim = rim[rim >= 0]
            if len(rim):
                label[around][own] = np.bincount(rim).argmax()
    return label
