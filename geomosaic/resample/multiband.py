"""Images near seams as differences from one image, in the parts of a window that they need.

Every image but one, the base, is described by its difference from the base, D = image − base. Where the images' own
shares meet, the mosaic is

    mosaic = own image + (blend of the differences − own difference)

which is the usual weighted mean of the images, or the usual sum of Laplacian bands (Burt and Adelson, 1983), since
both are linear. Written like this, equal images give no correction at all, to the bit; missing pixels need no care
but that differences are known only where both images show the ground; and where the images show different things - a
car that has moved, a house that leans the other way - the difference is no measure of colour: it is taken as unknown,
and what the surroundings say is used, so that nothing of the other image shines through.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.ndimage import find_objects

from geomosaic.resample.pyramid import ascend, descend, expand, filled, join, minus, reduce
from geomosaic.resample.warp import value_range
from geomosaic.types import AnyArray, BoolArray, IntArray


@dataclass(frozen=True)
class Part:
    """Part of a window, on multiples of the size of the coarsest cells of a pyramid.

    Attributes
    ----------
    rows, cols : slice
        Of the window.
    """

    rows: slice
    cols: slice

    @classmethod
    def whole(cls, shape: tuple[int, ...]) -> Part:
        """Part that is all of a window of this shape (rows, cols)."""
        return cls(slice(0, shape[0]), slice(0, shape[1]))

    @property
    def size(self) -> int:
        """Pixels."""
        return int((self.rows.stop - self.rows.start) * (self.cols.stop - self.cols.start))

    def level(self, level: int) -> tuple[slice, slice]:
        """Rows and columns of a level of the pyramid."""
        rows, cols = (slice(along.start >> level, along.stop >> level) for along in (self.rows, self.cols))
        return rows, cols


def parts_of(label: IntArray, images: int, margin: int, levels: int) -> list[Part | None]:
    """Parts of a window that the images of a label array need: where each is shown, and a margin around.

    Parameters
    ----------
    label : int array (rows, cols)
        Image of each pixel, −1 where none; rows and columns are multiples of 2 ** `levels`.
    images : int
        Number of images.
    margin : int
        Pixels.
    levels : int
        Of the pyramid that the parts are cut from.

    Returns
    -------
    list of Part or None
        None for an image that is shown nowhere.
    """
    found: list[Part | None] = []
    for box in find_objects(label + 1, images):
        if box is None:
            found.append(None)
            continue
        ends = [
            (max(0, along.start - margin) >> levels, -(-min(most, along.stop + margin) >> levels))
            for along, most in zip(box, label.shape, strict=True)
        ]
        found.append(Part(*(slice(first << levels, last << levels) for first, last in ends)))
    return found


def _both_of(one: slice, other: slice) -> slice:
    """Common part of two slices; empty if there is none."""
    start = max(one.start, other.start)
    return slice(start, max(start, min(one.stop, other.stop)))


def _within(outer: slice, inner: slice) -> slice:
    """Slice counted from the start of one that holds it."""
    return slice(inner.start - outer.start, inner.stop - outer.start)


# Levels over which unknown differences are taken from their surroundings: about 32 pixels.
REACH = 5
ROUNDS = 2
# Differences so many times as large as the noise count half.
TOLERATED = 3.0


@dataclass(frozen=True)
class View:
    """What one image shows of a window.

    Attributes
    ----------
    values : array (rows, cols, bands)
    valid : bool array (rows, cols)
    """

    values: AnyArray
    valid: BoolArray


@dataclass(frozen=True)
class BandDifferences:
    """Differences of an image from the base, in the part of a window where they are needed.

    Attributes
    ----------
    values : array (bands, rows, cols)
        Of `part`.
    part : Part
    """

    values: AnyArray
    part: Part


def differences(
    views: Sequence[View], label: IntArray, noise: float | None, parts: Sequence[Part | None]
) -> list[BandDifferences | None]:
    """Difference of each image from a common base, known everywhere.

    Parameters
    ----------
    views : sequence of View
        Rows and columns are multiples of 2 ** `REACH`.
    label : int array (rows, cols)
        Position in `views` of the image that each pixel belongs to; −1 where none.
    noise : float, optional
        Usual difference of two images of the same ground, in values; unless given, all differences count fully.
    parts : sequence of Part or None
        Of the window, for each image: what of its differences is kept.

    Returns
    -------
    list of BandDifferences or None
        None for the base, for images that meet no other, and where there is no part.
    """
    # The base is the image with the largest share. An image that does not meet it is compared with those that do.
    count = np.bincount(label[label >= 0].ravel(), minlength=len(views))
    base = int(np.argmax(count))
    known = views[base].valid.copy()
    ground = views[base].values.astype(_exact(views[base].values.dtype))
    if not known.all():  # whatever stands there, it may be no number
        ground[~known] = 0
    found: list[BandDifferences | None] = [None] * len(views)
    left = [i for i in range(len(views)) if i != base]
    while left:
        shared = [np.count_nonzero(known & views[i].valid) for i in left]
        if not max(shared):
            break
        # The image that shares most with what is known comes next: its difference is the best determined.
        i = left.pop(int(np.argmax(shared)))
        view, both, part = views[i], known & views[i].valid, parts[i]
        new = view.valid & ~known
        serves = bool(left) and bool(new.any())  # as ground that the next image may be compared with
        if part is None and not serves:
            continue
        # Bands lie one after the other from here on: a weight then serves them all at no cost.
        raw = minus(view.values, ground, both)
        certain = both[None].astype(np.float32)
        if noise is not None:
            certain = _robust_certainty(raw, certain, noise)
        apart = raw if (certain == 1).all() else filled(raw, certain, REACH)
        if part is not None:
            found[i] = BandDifferences(np.ascontiguousarray(apart[:, part.rows, part.cols]), part)
        if serves:
            ground[new] = view.values[new] - apart[:, new].T
            known |= new
    return found


def _robust_certainty(apart: AnyArray, certain: AnyArray, noise: float) -> AnyArray:
    """Certainty, 0 to 1, of differences (bands, rows, cols): little where they stand out from their surroundings."""
    # Measured at half the resolution: a difference stands out by its distance from the mean difference within about 32
    # pixels, root mean square over bands and some pixels around. The mean is taken again with the new certainties.
    small, weight = reduce(apart * certain), reduce(certain)
    small = small / np.maximum(weight, np.float32(1e-6))
    trusted = weight
    # Equal images have no noise, and the limit is divided by.
    limit = np.float32(max(TOLERATED * noise, 1e-6) ** 2)
    for _ in range(ROUNDS):
        mean = _mean(small, trusted)
        square = ((small - mean) ** 2).mean(axis=0, keepdims=True, dtype=np.float32) * np.minimum(weight, 1)
        square = ascend(reduce(reduce(square)), 2)
        trusted = weight / (np.float32(1.0) + (square / limit) ** 2)
    share = trusted / np.maximum(weight, np.float32(1e-6))
    return certain * expand(np.minimum(share, np.float32(1.0)))


def _mean(values: AnyArray, weight: AnyArray) -> AnyArray:
    """Weighted mean over about 16 samples around."""
    levels = REACH - 1
    total, sums = descend(values * weight, levels)[-1], descend(weight, levels)[-1]
    return ascend(total / np.maximum(sums, np.float32(1e-6)), levels)


def in_bands(apart: Sequence[BandDifferences | None], label: IntArray, levels: int) -> AnyArray | None:
    """Blend of the differences in bands of frequency: each across the seam as wide as its own wavelength.

    Parameters
    ----------
    apart : sequence of BandDifferences or None
        What is beyond its part must be too far from the image's own pixels to count, see `spread`.
    label : int array (rows, cols)
    levels : int
        The coarsest band is blended over about 2 ^ (levels + 1) pixels.

    Returns
    -------
    float32 array (bands, rows, cols), or None where no image differs
    """
    sums: list[AnyArray] = []
    for i, own in enumerate(apart):
        if own is None:
            continue
        gauss = descend(own.values, levels)
        shares = descend((label[own.part.rows, own.part.cols] == i)[None].astype(np.float32), levels)
        for level in range(levels + 1):
            band = gauss[level] if level == levels else gauss[level] - expand(gauss[level + 1])
            # Shares as smooth as the band is coarse: that makes the transition as wide as its wavelength.
            band *= shares[level]
            if len(sums) <= level:
                sums.append(np.zeros((len(band), *(length >> level for length in label.shape)), dtype=np.float32))
            sums[level][:, *own.part.level(level)] += band
    if not sums:
        return None
    out = sums[-1]
    for band in sums[-2::-1]:
        out = expand(out)
        out += band
    return out


def by_weights(apart: Sequence[BandDifferences | None], weights: Sequence[AnyArray]) -> AnyArray | None:
    """Blend of the differences by weights.

    Parameters
    ----------
    apart : sequence of BandDifferences or None
        Each of the whole window.
    weights : sequence of array (rows, cols)
        One an image; they sum to one.

    Returns
    -------
    array (bands, rows, cols), or None where no image differs
    """
    out: AnyArray | None = None
    for own, weight in zip(apart, weights, strict=True):
        if own is not None:
            part = own.values * weight[None]
            out = part if out is None else out + part
    return out


def spread(levels: int) -> int:
    """Reach of `in_bands`: the taps down and up, all levels together.

    Parameters
    ----------
    levels : int

    Returns
    -------
    int
        Pixels over which an image's differences are spread.
    """
    return 4 << levels


def corrected(
    views: Sequence[View],
    apart: Sequence[BandDifferences | None],
    blend: AnyArray | None,
    label: IntArray,
    inside: tuple[slice, slice],
    out: AnyArray,
) -> None:
    """Mosaic of a window: own value and correction of each pixel, rounded.

    Parameters
    ----------
    views : sequence of View
        Of the window.
    apart : sequence of BandDifferences or None
        Differences of the images from the base.
    blend : array (bands, rows, cols) or None
        Blend of the differences; None where there are none.
    label : int array (rows, cols)
        Position in `views` of the image that each pixel belongs to; −1 where none.
    inside : (slice, slice)
        Rows and columns of the window that are wanted.
    out : array (rows, cols, bands)
        Of `inside`, filled; zero where no image is.
    """
    out[label[inside] < 0] = 0
    for i, (view, own) in enumerate(zip(views, apart, strict=True)):
        rows, cols = inside
        difference = None
        if own is not None:
            rows, cols = _both_of(rows, own.part.rows), _both_of(cols, own.part.cols)
            difference = own.values[:, _within(own.part.rows, rows), _within(own.part.cols, cols)]
        join(
            view.values[rows, cols], difference, None if blend is None else blend[:, rows, cols],
            label[rows, cols], i, value_range(str(out.dtype)), out[_within(inside[0], rows), _within(inside[1], cols)],
        )  # fmt: skip


def _exact(kind: np.dtype[Any]) -> type[np.floating[Any]]:
    """Floating point type that holds the samples of a type."""
    return np.float32 if kind.itemsize < 4 or kind == np.float32 else np.float64
