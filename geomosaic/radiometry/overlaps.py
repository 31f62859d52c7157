"""Gather what pairs of images show of the same ground: few samples of each pair, no image kept longer than needed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.geo.grid import Window
from geomosaic.types import AnyArray, ByteArray

LEAST_CELLS = 25
"""An overlap of fewer cells says nothing."""
MOST_CELLS = 500
"""Cells that are kept of an overlap: sampling then leaves (1 − ρ²)^½ · 4.5 % of a ratio of gains open."""
_GOLDEN = (5**0.5 - 1) / 2


@dataclass(frozen=True)
class Overlap:
    """The same ground in two images.

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
    """One image on the coarse grid that all share.

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
    """Overlaps of thumbnails that come one by one, in any order.

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
        """Thumbnails that wait for a partner."""
        return len(self._kept)

    @property
    def found(self) -> list[Overlap]:
        """All pairs so far, by their numbers."""
        return sorted(self._found, key=lambda pair: (pair.first, pair.second))

    def add(self, index: int, piece: Thumbnail) -> None:
        """Compare a thumbnail with those that came before, and forget those that have met all their partners."""
        common = np.minimum(self._high, self._high[index]) - np.maximum(self._low, self._low[index])
        partners = (common > 0).all(axis=1)
        partners[index] = False
        self._came[index] = True
        self._kept[index] = piece
        self._missing[index] = np.count_nonzero(partners & ~self._came)
        for other in np.flatnonzero(partners & self._came).tolist():
            first, second = min(index, other), max(index, other)
            pair = compare(first, second, self._kept[first], self._kept[second], self._clipped)
            if pair is not None:
                self._found.append(pair)
            self._missing[other] -= 1
            if not self._missing[other]:
                del self._kept[other]
        if not self._missing[index]:
            del self._kept[index]


def compare(
    first: int, second: int, one: Thumbnail, other: Thumbnail, clipped: tuple[float, float] | None = None
) -> Overlap | None:
    """Values that both have, at most `MOST_CELLS` of them; None where there are too few."""
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
    if len(rows) < LEAST_CELLS:
        return None
    chosen = spread_out(len(rows))
    rows, cols = rows[chosen], cols[chosen]
    a, b = (values[rows, cols] for values in views)
    return Overlap(first, second, a, b, np.stack([cols + common.col, rows + common.row], axis=1))


def spread_out(count: int) -> AnyArray:
    """Indices of at most `MOST_CELLS` of `count` items, evenly and in no rhythm.

    A plain stride could fall in step with the columns, and see one side of each image only. Multiples of the golden
    ratio modulo 1 are as even, and in step with nothing.
    """
    if count <= MOST_CELLS:
        return np.arange(count)
    return np.unique((np.arange(MOST_CELLS) * _GOLDEN % 1.0 * count).astype(np.int64))
