"""Overlap samples: values of the same ground in pairs of images, as few as suffice."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomosaic.geo.grid import Window
from geomosaic.types import AnyArray, BoolArray, ByteArray, FloatArray, IntArray

MIN_CELLS = 25
"""Cells of the smallest overlap that is used."""
MAX_CELLS = 500
"""Cells kept of an overlap: the sampling error of a ratio of gains is then (1 − ρ²)^½ · 4.5 %."""
_GOLDEN = (5**0.5 - 1) / 2


@dataclass(frozen=True)
class Overlap:
    """Samples of the same ground in two images.

    Attributes
    ----------
    first, second : int
        Numbers of the images.
    a, b : array (N, bands)
        Values in the first and in the second.
    cells : int array (N, 2), optional
        Column and row of each sample in the coarse grid that all images share.
    """

    first: int
    second: int
    a: AnyArray
    b: AnyArray
    cells: AnyArray | None = None


@dataclass(frozen=True)
class Thumbnail:
    """Image on the coarse grid that all share.

    Attributes
    ----------
    window : Window
        Of the coarse grid.
    values : float32 array (rows, cols, bands)
    valid : uint8 array (rows, cols)
    """

    window: Window
    values: AnyArray
    valid: ByteArray


class Overlaps:
    """Overlaps of thumbnails that arrive one by one, in any order.

    Each thumbnail is dropped when its last partner has come, so that memory is that of a few strips.

    Parameters
    ----------
    windows : sequence of Window
        Of all thumbnails to come.
    clipped : (float, float), optional
        Ends of the range of values; cells at them are left out.
    """

    def __init__(self, windows: Sequence[Window], clipped: tuple[float, float] | None = None) -> None:
        self._low = np.array([(w.col, w.row) for w in windows]).reshape(-1, 2)
        self._high = np.array([(w.stop_col, w.stop_row) for w in windows]).reshape(-1, 2)
        self._clipped = clipped
        self._kept: dict[int, Thumbnail] = {}
        self._came = np.zeros(len(windows), dtype=bool)
        self._missing = np.zeros(len(windows), dtype=np.int64)
        self._found: list[Overlap] = []

    @property
    def kept(self) -> int:
        """Number of thumbnails that wait for a partner."""
        return len(self._kept)

    @property
    def found(self) -> list[Overlap]:
        """All overlaps so far, by their numbers."""
        return sorted(self._found, key=lambda pair: (pair.first, pair.second))

    def add(self, index: int, piece: Thumbnail) -> None:
        """Overlaps of a thumbnail with those that came before."""
        common = np.minimum(self._high, self._high[index]) - np.maximum(self._low, self._low[index])
        partners = (common > 0).all(axis=1)
        partners[index] = False
        self._came[index] = True
        self._kept[index] = piece
        # Counted down as partners come; at 0 the thumbnail is dropped.
        self._missing[index] = np.count_nonzero(partners & ~self._came)
        for other in np.flatnonzero(partners & self._came).tolist():
            first, second = min(index, other), max(index, other)
            pair = overlap_of(first, second, self._kept[first], self._kept[second], self._clipped)
            if pair is not None:
                self._found.append(pair)
            self._missing[other] -= 1
            if not self._missing[other]:
                del self._kept[other]
        if not self._missing[index]:
            del self._kept[index]


def overlap_of(
    first: int, second: int, one: Thumbnail, other: Thumbnail, clipped: tuple[float, float] | None = None
) -> Overlap | None:
    """Samples of the cells that are valid in both thumbnails, at most `MAX_CELLS`.

    Parameters
    ----------
    first, second : int
        Numbers of the images.
    one, other : Thumbnail
        Of the first and of the second image.
    clipped : (float, float), optional
        Ends of the range of values; cells at them are left out.

    Returns
    -------
    Overlap or None
        None where fewer than `MIN_CELLS` cells are left.
    """
    common = one.window.intersection(other.window)
    if common.empty:
        return None
    views, seen = [], np.ones((common.height, common.width), dtype=bool)
    for piece in (one, other):
        here = common.slices_in(piece.window)
        values = piece.values[here]
        seen &= piece.valid[here] > 0
        if clipped is not None:
            seen &= (values > clipped[0] + 0.5).all(axis=2) & (values < clipped[1] - 0.5).all(axis=2)
        views.append(values)
    rows, cols = np.nonzero(seen)
    if len(rows) < MIN_CELLS:
        return None
    chosen = golden_ratio_sample(len(rows))
    rows, cols = rows[chosen], cols[chosen]
    a, b = (values[rows, cols] for values in views)
    return Overlap(first, second, a, b, np.stack([cols + common.col, rows + common.row], axis=1))


def golden_ratio_sample(count: int) -> AnyArray:
    """Indices of at most `MAX_CELLS` of a number of items, evenly spread without a period.

    A plain stride could be in phase with the columns, and sample one side of each image only. Multiples of the golden
    ratio modulo 1 are as even, and in phase with nothing.

    Parameters
    ----------
    count : int
        Number of items.

    Returns
    -------
    int array (N,)
        Rising; all items where there are no more than `MAX_CELLS`.
    """
    if count <= MAX_CELLS:
        return np.arange(count)
    return np.unique((np.arange(MAX_CELLS) * _GOLDEN % 1.0 * count).astype(np.int64))


MAX_SAMPLES = 40_000
"""Samples of all overlaps together: shared fields need no more, and time stays bounded."""
SamplePositions = Callable[[int, AnyArray], tuple[FloatArray, FloatArray]]
"""Image and cells (N, 2) of the coarse grid → positions in the image and on the ground, each (N, 2); see `bases`."""


@dataclass(frozen=True)
class PairedSamples:
    """Samples of the same ground in pairs of images; P pairs of at most K samples, the rest is padding.

    Attributes
    ----------
    first, second : int array (P,)
        Numbers of the images.
    a, b : array (P, K, bands)
        Values, finite.
    known : bool array (P, K)
        False for padding.
    image_a, view_a, image_b, view_b : array (P, K, 2)
        Positions in each image and on the ground, see `bases`.
    """

    first: IntArray
    second: IntArray
    a: FloatArray
    b: FloatArray
    known: BoolArray
    image_a: FloatArray
    view_a: FloatArray
    image_b: FloatArray
    view_b: FloatArray

    def only(self, known: BoolArray) -> PairedSamples:
        """Subset of the samples."""
        return replace(self, known=self.known & known)

    def halves(self) -> tuple[BoolArray, BoolArray]:
        """Two halves of the samples, each in four bands that alternate across every overlap."""
        count = np.maximum(self.known.sum(axis=1), 1)[:, None]
        odd = (np.arange(self.known.shape[1]) * 8 // count) % 2 == 1
        return ~odd & self.known, odd & self.known


def paired_samples(
    overlaps: Sequence[Overlap], places: SamplePositions, most: int = MAX_SAMPLES
) -> PairedSamples | None:
    """Samples of all overlaps with their positions.

    Positions are computed once per image. Of an overlap that has more than its part of `most` samples, every second,
    third ... is used.

    Parameters
    ----------
    overlaps : sequence of Overlap
    places : SamplePositions
    most : int
        Largest number of samples of all overlaps together.

    Returns
    -------
    PairedSamples or None
        None where no overlap has positions.
    """
    used = [pair for pair in overlaps if len(pair.a) and pair.cells is not None]
    if not used:
        return None
    each = max(MIN_CELLS, most // len(used))
    chosen = [np.arange(0, len(pair.a), -(-len(pair.a) // each)) for pair in used]
    shape, bands = (len(used), max(len(own) for own in chosen)), used[0].a.shape[1]
    # Padding is 1: its logarithms exist, and `known` keeps it from counting.
    a, b, known = np.ones((*shape, bands)), np.ones((*shape, bands)), np.zeros(shape, dtype=bool)
    place = np.zeros((4, *shape, 2))
    of_image: dict[int, list[tuple[int, int]]] = {}
    for p, (pair, own) in enumerate(zip(used, chosen, strict=True)):
        a[p, : len(own)], b[p, : len(own)], known[p, : len(own)] = pair.a[own], pair.b[own], True
        of_image.setdefault(pair.first, []).append((p, 0))
        of_image.setdefault(pair.second, []).append((p, 2))
    for image, where in of_image.items():
        cells = np.concatenate([_cells(used[p], chosen[p]) for p, _ in where])
        found = places(image, cells)
        at = 0
        for p, side in where:
            count = len(chosen[p])
            for k in range(2):
                place[side + k, p, :count] = found[k][at : at + count]
            at += count
    known &= np.isfinite(place).all(axis=(0, 3)) & np.isfinite(a).all(axis=2) & np.isfinite(b).all(axis=2)
    place = np.where(known[None, :, :, None], place, 0.0)
    a, b = (np.where(known[..., None], values, 1.0) for values in (a, b))
    first, second = np.array([(pair.first, pair.second) for pair in used], dtype=np.int64).T
    return PairedSamples(first, second, a, b, known, place[0], place[1], place[2], place[3])


def _cells(pair: Overlap, chosen: AnyArray) -> AnyArray:
    assert pair.cells is not None  # those without were left out
    return pair.cells[chosen]
