"""Features of the images and not of the ground: data strips, clocks, fiducial marks, scratches, a propeller.

They stay at one place of the image while the ground moves on, so that many images of one size have like features at one
place. Of images that all show one view (a camera on a mast, scenes in one map) everything stays, all over the image:
nothing is left out there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import cKDTree

from geomosaic.matching.descriptors import FARTHEST
from geomosaic.matching.features import Features
from geomosaic.types import AnyArray, BoolArray, FloatArray, IntArray

# Images of one size from which on they are compared, share of them that show a feature of the images, and at least.
LEAST_IMAGES, SHARE, LEAST = 4, 0.25, 3
# Images with a feature at one place that are compared with it.
COMPARED = 24
# Features that are compared with those about them at once, and the cells, in reaches, in whose order they are taken.
CHUNK, CHUNK_CELLS = 1024, 8.0
# Cells along each side of an image, and the share of those inside from which on all of it shows one view.
CELLS, ALL_OVER = 5, 0.5


def fixed_features(features: Sequence[Features], sizes: IntArray, reach: FloatArray) -> list[BoolArray]:
    """Features that stay at one place over many images.

    Parameters
    ----------
    features : sequence of Features (M,)
    sizes : int array (M, 2)
        Width and height of the images.
    reach : array (M,)
        Pixels within which the place of a feature is the same.

    Returns
    -------
    list of bool array (N,)
        One for each image.
    """
    fixed = [np.zeros(len(each), dtype=bool) for each in features]
    _, group = np.unique(sizes, axis=0, return_inverse=True)
    for number in range(int(group.max(initial=-1)) + 1):
        mine = np.flatnonzero(group.ravel() == number)
        if len(mine) >= LEAST_IMAGES:
            own = [features[k] for k in mine.tolist()]
            found = _of_one_size(own, float(reach[mine].max()))
            for k, flags, each in zip(mine.tolist(), found, own, strict=True):
                if not _all_over(each.colrow[flags], sizes[k]):
                    fixed[k] = flags
    return fixed


def stationary(one: FloatArray, other: FloatArray, reach: float) -> BoolArray:
    """Matches (N,) of places (N, 2) that stay where they are while most of their pair move: they are of the images.

    What changes a little from image to image (hands of a clock, the edge of a data strip) is no feature that stays.

    Parameters
    ----------
    one, other : array (N, 2)
        Places (col, row) of the matches in both images, pixels.
    reach : float
        Pixels within which a place is the same.

    Returns
    -------
    bool array (N,)
    """
    still: BoolArray = np.linalg.norm(other - one, axis=1) < reach
    return still if 2 * still.sum() < len(still) else np.zeros(len(still), dtype=bool)


def _of_one_size(features: Sequence[Features], reach: float) -> list[BoolArray]:
    """Features that stay at one place over the images, all of one size."""
    # First by place alone, which is quick: few places have features in a quarter of the images by chance.
    needed = max(LEAST, int(np.ceil(SHARE * (len(features) - 1))))
    colrow = np.concatenate([each.colrow for each in features])
    sizes = np.array([len(each) for each in features])
    image = np.repeat(np.arange(len(features)), sizes)
    crowded = _crowded(colrow, image, reach, needed + 1)
    rows = np.flatnonzero(crowded)
    found = np.zeros(len(colrow), dtype=bool)
    if len(rows) > needed:
        # Numbers within the images: descriptors of all features together would be as much again as all images hold.
        own = rows - np.repeat(np.cumsum(sizes) - sizes, sizes)[rows]
        tree, count = cKDTree(colrow[rows]), min(COMPARED + 1, len(rows))
        # Of many more than are compared the share counts.
        enough = min(needed, int(np.ceil(SHARE * COMPARED)))
        # From place to place, so that those of one part are compared with few others.
        cell = np.floor(colrow[rows] / (CHUNK_CELLS * reach))
        for part in np.array_split(np.lexsort((cell[:, 0], cell[:, 1])), -(-len(rows) // CHUNK)):
            _, near = tree.query(colrow[rows[part]], k=count, distance_upper_bound=reach)
            there = near < len(rows)
            other = np.where(there, near, part[:, None])
            involved, short = np.unique(np.column_stack([part, other]), return_inverse=True)
            values = _descriptors_of(features, image[rows[involved]], own[involved])
            short = short.reshape(len(part), -1)
            difference = values[short[:, :1]] - values[short[:, 1:]]
            apart = np.einsum("nkd,nkd->nk", difference, difference)
            alike = there & (apart < FARTHEST) & (image[rows[other]] != image[rows[part]][:, None])
            seen = np.sort(np.where(alike, image[rows[other]], -1), axis=1)
            images = ((np.diff(seen, axis=1, prepend=-1) > 0) & (seen >= 0)).sum(axis=1)
            found[rows[part]] = images >= enough
    return np.split(found, np.cumsum(sizes)[:-1])


def _descriptors_of(features: Sequence[Features], image: IntArray, own: IntArray) -> AnyArray:
    """Descriptors (N, 128) of features, after the number of the image and within it (N,) of each."""
    values = np.empty((len(image), 128), dtype=np.int32)
    order = np.argsort(image, kind="stable")
    for rows in np.split(order, np.flatnonzero(np.diff(image[order])) + 1):
        values[rows] = features[int(image[rows[0]])].descriptors[own[rows]]
    return values


def _crowded(colrow: FloatArray, image: IntArray, reach: float, needed: int) -> BoolArray:
    """Places (N,) about which so many images have features, counted in cells of `reach` with their neighbours."""
    cell = np.floor(colrow / reach).astype(np.int64) + 1
    wide = int(cell[:, 0].max(initial=0)) + 2
    number = cell[:, 1] * wide + cell[:, 0]
    once = np.unique(np.column_stack([number, image]), axis=0)[:, 0]
    count = np.bincount(once, minlength=int(number.max(initial=0)) + 2 * wide + 2)
    around = sum(count[number + down * wide + across] for down in (-1, 0, 1) for across in (-1, 0, 1))
    return np.asarray(around) >= needed


def _all_over(colrow: FloatArray, size: IntArray) -> bool:
    """Whether places (N, 2) lie all over the inside of an image."""
    cell = np.unique(np.floor(CELLS * colrow / size).astype(np.int64), axis=0)
    inside = ((cell > 0) & (cell < CELLS - 1)).all(axis=1)
    return bool(inside.sum() >= ALL_OVER * (CELLS - 2) ** 2)
