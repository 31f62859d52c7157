"""Overlap similarity: correlation of small copies of photos where their orientations say that they overlap."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.block.block import OrientedImage
from geomosaic.errors import GeomosaicError
from geomosaic.geo.transform import Transform
from geomosaic.raster.preview import preview
from geomosaic.sensor.solve.inverse import image_to_ground
from geomosaic.surface.model import Surface
from geomosaic.types import BoolArray, FloatArray

SIDE = 240
"""Longer side of the small copies, pixels."""
EVERY = 5
"""Pixels of a small copy between places that are compared."""
REACH = 2
"""Pixels of a small copy by which the pictures may lie off each other."""
AROUND = 4
"""Pixels of a small copy on each side of one that it is compared with to see what stands out."""
FEWEST = 120
"""Places that must be seen in both."""


@dataclass(frozen=True)
class ReducedImage:
    """Reduced image, each pixel less the mean of its surroundings.

    Attributes
    ----------
    detail : array (rows, cols)
        Grey minus its local mean, over its local deviation; 0 where nothing is known.
    valid : array (rows, cols)
    """

    detail: FloatArray
    valid: BoolArray


def reduced_image(path: str) -> ReducedImage:
    """Reduced copy of an image, its grey values normalised by local mean and deviation.

    Parameters
    ----------
    path : str

    Returns
    -------
    ReducedImage
        At most `SIDE` pixels along the longer side.
    """
    rgb, valid = preview(path, SIDE)
    grey = rgb.mean(axis=2, dtype=np.float64)
    mean = _box_mean(grey)
    spread = np.sqrt(np.maximum(_box_mean(grey * grey) - mean * mean, 1.0))
    return ReducedImage((grey - mean) / spread, valid != 0)


def _box_mean(values: FloatArray) -> FloatArray:
    """Mean of 9 x 9 pixels about each pixel; edges repeat."""
    sums = np.pad(values, ((AROUND + 1, AROUND), (AROUND + 1, AROUND)), mode="edge")
    sums[0], sums[:, 0] = 0.0, 0.0
    sums = sums.cumsum(axis=0).cumsum(axis=1)
    n = 2 * AROUND + 1
    mean: FloatArray = (sums[n:, n:] - sums[:-n, n:] - sums[n:, :-n] + sums[:-n, :-n]) / n**2
    return mean


def correlation_of_pair(
    first: OrientedImage, second: OrientedImage, copies: tuple[ReducedImage, ReducedImage], surface: Surface
) -> float:
    """Correlation of the details of two images where both show the same ground.

    Places of a lattice in the first image go to the surface and from there into the second. The largest correlation
    over small shifts is taken, since orientations may be rough.

    Parameters
    ----------
    first, second : OrientedImage
    copies : (ReducedImage, ReducedImage)
        Their reduced copies.
    surface : Surface

    Returns
    -------
    float
        0 to 1; 0 where fewer than `FEWEST` places are shown by both.
    """
    here, there = copies
    rows, cols = here.detail.shape
    c, r = (v.ravel() for v in np.meshgrid(np.arange(EVERY, cols, EVERY), np.arange(EVERY, rows, EVERY)))
    scale = np.array(first.model.size) / (cols, rows)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            ground = image_to_ground(first.model, (np.column_stack([c, r]) + 0.5) * scale, surface)
            seen = second.model.ground_to_image(Transform(surface.crs, second.model.crs)(ground))
    except GeomosaicError:
        return 0.0
    place = seen / (np.array(second.model.size) / there.detail.shape[::-1]) - 0.5
    limit = np.array(there.detail.shape[::-1]) - 1 - REACH
    good = np.isfinite(place).all(axis=1) & (place >= REACH).all(axis=1) & (place <= limit).all(axis=1)
    good &= here.valid[r, c]
    if np.count_nonzero(good) < FEWEST:
        return 0.0
    values, at = here.detail[r[good], c[good]], np.rint(place[good]).astype(np.int64)
    best = 0.0
    for down in range(-REACH, REACH + 1):
        for right in range(-REACH, REACH + 1):
            col, row = at[:, 0] + right, at[:, 1] + down
            known = there.valid[row, col]
            if np.count_nonzero(known) >= FEWEST:
                best = max(best, _correlation(values[known], there.detail[row[known], col[known]]))
    return best


def neighbours(places: FloatArray, pairs: int) -> list[tuple[int, int]]:
    """Pairs of nearest photos, spread over the block.

    Parameters
    ----------
    places : array (N, 2)
        Positions in one map CRS; NaN for those not known.
    pairs : int
        At most so many.

    Returns
    -------
    list of (int, int)
        Indices of each pair, the lower first.
    """
    found: dict[tuple[int, int], None] = {}
    for first in np.unique(np.linspace(0, len(places) - 1, pairs).round().astype(int)):
        distance = np.hypot(*(places - places[first]).T)
        distance[first] = np.inf
        second = int(np.argmin(distance))
        if np.isfinite(distance[second]):
            found[min(int(first), second), max(int(first), second)] = None
    return list(found)


def together(scenes: Sequence[OrientedImage], copies: Sequence[ReducedImage], surface: Surface) -> float:
    """Median correlation of pairs of images.

    Parameters
    ----------
    scenes : sequence of OrientedImage
        The first pairs with the second, the third with the fourth, and so on.
    copies : sequence of ReducedImage
        In the order of the scenes.
    surface : Surface

    Returns
    -------
    float
        0 to 1; 0 without pairs.
    """
    each = [
        correlation_of_pair(scenes[i], scenes[i + 1], (copies[i], copies[i + 1]), surface)
        for i in range(0, len(scenes) - 1, 2)
    ]
    return float(np.median(each)) if each else 0.0


def _correlation(a: FloatArray, b: FloatArray) -> float:
    a, b = a - a.mean(), b - b.mean()
    both = float(np.sqrt((a @ a) * (b @ b)))
    return float(a @ b) / both if both > 0.0 else 0.0
