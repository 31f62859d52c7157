"""Features of an image: places that are found again in other images, and descriptors of what is about them.

SIFT (Lowe, 2004) as OpenCV has it, with the square root of its descriptors (RootSIFT: Arandjelović and Zisserman,
2012), of which the strongest are kept cell by cell, so that they are spread over the image.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomosaic.types import AnyArray, BoolArray, ByteArray, FloatArray, IntArray

# Cells along the longer side of an image, of which each gives its strongest features in turn.
CELLS = 24
# Contrast of the weakest features (Lowe takes 0.04): meadows, sand and old film have little.
LEAST_CONTRAST = 0.01
# Pixels along the shorter side of an image below which nothing is looked for.
LEAST_SIZE = 8
# What a root descriptor of length one is multiplied by to be stored in eight bits; larger elements are rare.
UNIT = 512.0


@dataclass(frozen=True, eq=False)
class Features:
    """Features of an image, N of them.

    Attributes
    ----------
    colrow : array (N, 2)
        Pixels, corner-based.
    scale : array (N,)
        Diameter of what is described, pixels.
    angle : array (N,)
        Its direction in radians, from the right downwards.
    descriptors : uint8 array (N, 128)
    """

    colrow: FloatArray
    scale: FloatArray
    angle: FloatArray
    descriptors: ByteArray

    def __len__(self) -> int:
        return len(self.colrow)

    def select(self, which: BoolArray | IntArray) -> Features:
        """Some of them."""
        return Features(self.colrow[which], self.scale[which], self.angle[which], self.descriptors[which])

    def scaled(self, factor: float) -> Features:
        """The same in an image of another size."""
        return Features(self.colrow * factor, self.scale * factor, self.angle, self.descriptors)

    @cached_property
    def place(self) -> IntArray:
        """Number of the place (N,) of each: features with several directions share one."""
        _, place = np.unique(self.colrow, axis=0, return_inverse=True)
        return place.ravel()

    @cached_property
    def frames(self) -> FloatArray:
        """Similarity transformations (N, 2, 2) from a unit patch to the image: scale and direction."""
        c, s = self.scale * np.cos(self.angle), self.scale * np.sin(self.angle)
        return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)


def detect(grey: AnyArray, most: int, mask: BoolArray | None = None) -> Features:
    """Features of an image.

    Parameters
    ----------
    grey : uint8 array (rows, cols)
    most : int
        Number of features that are kept.
    mask : bool array (rows, cols), optional
        True where features are wanted.

    Returns
    -------
    Features
        In order of strength, cells in turn.
    """
    import cv2

    empty = Features(np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros((0, 128), dtype=np.uint8))
    # OpenCV fails where its pyramid has no level.
    if min(grey.shape) < LEAST_SIZE:
        return empty
    sift = cv2.SIFT.create(nfeatures=0, contrastThreshold=LEAST_CONTRAST)
    points = sift.detect(grey, None if mask is None else np.ascontiguousarray(mask, dtype=np.uint8))
    # OpenCV counts from the centre of the first pixel.
    colrow = np.array([point.pt for point in points], dtype=np.float64).reshape(-1, 2) + 0.5
    response = np.array([point.response for point in points], dtype=np.float64)
    kept = spread(colrow, response, max(grey.shape) / CELLS, most)
    described, values = sift.compute(grey, [points[k] for k in kept.tolist()])
    if not len(described):
        return empty
    return Features(
        np.array([point.pt for point in described], dtype=np.float64) + 0.5,
        np.array([point.size for point in described], dtype=np.float64),
        np.radians([point.angle for point in described]),
        root_descriptors(values),
    )


def spread(colrow: FloatArray, strength: FloatArray, cell: float, most: int) -> IntArray:
    """Strongest places of square cells: the first of each cell, then the second, and so on.

    Parameters
    ----------
    colrow : array (N, 2)
    strength : array (N,)
    cell : float
        Side of a cell in pixels.
    most : int
        Number of places that are kept.

    Returns
    -------
    int array (K,)
        Their indices.
    """
    if not len(colrow):
        return np.zeros(0, dtype=np.int64)
    cells = np.floor(colrow / cell).astype(np.int64)
    number = cells[:, 1] * (cells[:, 0].max() + 1) + cells[:, 0]
    order = np.lexsort((-strength, number))
    starts = np.flatnonzero(np.diff(number[order], prepend=-1))
    rank = np.arange(len(order)) - np.repeat(starts, np.diff(np.append(starts, len(order))))
    chosen: IntArray = order[np.lexsort((-strength[order], rank))][:most]
    return chosen


def root_descriptors(values: AnyArray) -> ByteArray:
    """Root of SIFT descriptors (N, 128), in eight bits."""
    total = np.maximum(values.sum(axis=1, keepdims=True), 1e-9)
    rooted: ByteArray = np.minimum(np.rint(UNIT * np.sqrt(values / total)), 255.0).astype(np.uint8)
    return rooted
