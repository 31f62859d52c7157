"""Features of an image: places that are found again in other images, and descriptors of what is about them.

SIFT (Lowe, 2004) as OpenCV has it, with the square root of its descriptors (RootSIFT: Arandjelović and Zisserman,
2012), of which the strongest are kept cell by cell, so that they are spread over the image.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from geomosaic.geo.grid import Window
from geomosaic.types import AnyArray, BoolArray, ByteArray, FloatArray, IntArray

# Cells along the longer side of an image, of which each gives its strongest features in turn.
CELLS = 24
# Contrast of the weakest features (Lowe takes 0.04): meadows, sand and old film have little.
LEAST_CONTRAST = 0.01
# Pixels along the shorter side of an image below which nothing is looked for.
LEAST_SIZE = 8
# Bytes that SIFT takes for each pixel of an image.
BYTES_PER_PIXEL = 220
# Pixels of an image up to which it is examined whole. Larger ones are cut into tiles of this side, at multiples of a
# step at which all levels of the pyramid but the coarsest have their pixels where those of the whole have them, with a
# margin in which most descriptors lie.
WHOLE, TILE, STEP, MARGIN = 3_100_000, 1280, 64, 128
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

    def without_descriptors(self) -> Features:
        """The same places, which cannot be compared any more."""
        return replace(self, descriptors=self.descriptors[:, :0].copy())

    @cached_property
    def place(self) -> IntArray:
        """Number of the place (N,) of each: features with several directions share one."""
        _, place = np.unique(self.colrow, axis=0, return_inverse=True)
        return place.ravel()

    @cached_property
    def first_of_places(self) -> IntArray:
        """First feature (P,) of each place."""
        # Of several directions at one place any serves: scales and places are the same.
        return np.unique(self.place, return_index=True)[1]

    def frames(self, rows: IntArray) -> FloatArray:
        """Similarity transformations (K, 2, 2) from a unit patch to the image, of some features (K,).

        Parameters
        ----------
        rows : int array (K,)
        """
        c, s = (self.scale[rows] * turn(self.angle[rows]) for turn in (np.cos, np.sin))
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
    rows, cols = grey.shape

    def read(window: Window) -> tuple[AnyArray, BoolArray | None]:
        part = window.slices_in(Window(0, 0, cols, rows))
        return grey[part], None if mask is None else mask[part]

    return detect_by_tiles(read, (cols, rows), most)


def detect_by_tiles(
    read: Callable[[Window], tuple[AnyArray, BoolArray | None]], size: tuple[int, int], most: int
) -> Features:
    """Features of an image that is read by windows.

    Parameters
    ----------
    read : callable
        Of a window, its grey values as uint8 array (rows, cols), and where features are wanted or None.
    size : tuple of int
        Width and height.
    most : int
        Number of features that are kept.

    Returns
    -------
    Features
        In order of strength, cells in turn.
    """
    import cv2

    # OpenCV fails where its pyramid has no level.
    tiles = _tiles(size) if min(size) >= LEAST_SIZE else []
    sift = cv2.SIFT.create(nfeatures=0, contrastThreshold=LEAST_CONTRAST)
    points, tile_of, places = [], [], []
    for number, (core, around) in enumerate(tiles):
        grey, mask = read(around)
        found = sift.detect(grey, None if mask is None else np.ascontiguousarray(mask, dtype=np.uint8))
        # OpenCV counts from the centre of the first pixel.
        at = np.array([point.pt for point in found], dtype=np.float64).reshape(-1, 2) + 0.5 + (around.col, around.row)
        own = (at >= (core.col, core.row)).all(axis=1) & (at < (core.stop_col, core.stop_row)).all(axis=1)
        points += [found[k] for k in np.flatnonzero(own).tolist()]
        tile_of += [number] * int(own.sum())
        places.append(at[own])
    if not points:
        return Features(np.zeros((0, 2)), np.zeros(0), np.zeros(0), np.zeros((0, 128), dtype=np.uint8))
    response = np.array([point.response for point in points], dtype=np.float64)
    kept = spread(np.concatenate(places), response, max(size) / CELLS, most)
    owner = np.array(tile_of)[kept]
    parts, orders = [], []
    for number in np.unique(owner).tolist():
        around = tiles[number][1]
        order = np.flatnonzero(owner == number)
        mine = [points[k] for k in kept[order].tolist()]
        # The place in the order of strength goes with the point, since OpenCV may drop some.
        for rank, point in zip(order.tolist(), mine, strict=True):
            point.class_id = rank
        described, values = sift.compute(read(around)[0], mine)
        if len(described):
            parts.append(_described(described, values, (around.col, around.row)))
            orders += [point.class_id for point in described]
    whole = Features(
        np.concatenate([part.colrow for part in parts]), np.concatenate([part.scale for part in parts]),
        np.concatenate([part.angle for part in parts]), np.concatenate([part.descriptors for part in parts]),
    )  # fmt: skip
    return whole.select(np.argsort(orders, kind="stable"))


def _described(points: Sequence[Any], values: AnyArray, corner: tuple[int, int]) -> Features:
    """Features of OpenCV's points in a part of an image, and their descriptors."""
    return Features(
        np.array([point.pt for point in points], dtype=np.float64) + 0.5 + corner,
        np.array([point.size for point in points], dtype=np.float64),
        np.radians([point.angle for point in points]),
        _root_descriptors(values),
    )


def _tiles(size: tuple[int, int]) -> list[tuple[Window, Window]]:
    """Windows that share an image, each with the window about it that is examined."""
    whole = Window(0, 0, *size)
    if size[0] * size[1] <= WHOLE:
        return [(whole, whole)]
    width, height = (STEP * -(-side // (-(-side // TILE) * STEP)) for side in size)
    return [
        (core, Window(core.col - MARGIN, core.row - MARGIN, core.width + 2 * MARGIN, core.height + 2 * MARGIN)
         .intersection(whole))
        for core in whole.split(width, height)
    ]  # fmt: skip


def largest_tile(size: tuple[int, int]) -> int:
    """Pixels of the largest part of an image that is examined at once.

    Parameters
    ----------
    size : tuple of int
        Width and height.
    """
    return max(around.width * around.height for _, around in _tiles(size))


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
    return order[np.lexsort((-strength[order], rank))][:most]


def _root_descriptors(values: AnyArray) -> ByteArray:
    """Root of SIFT descriptors (N, 128), which are not negative, in eight bits."""
    total = np.maximum(values.sum(axis=1, keepdims=True), 1e-9)
    rooted: ByteArray = np.minimum(np.rint(UNIT * np.sqrt(values / total)), 255.0).astype(np.uint8)
    return rooted
