"""Tiles of half the resolution from tiles, one after the other, for overviews."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from geomosaic.raster.cog.codec import BLOCK
from geomosaic.types import AnyArray, ByteArray

HALF = BLOCK // 2


@dataclass(frozen=True, eq=False)
class Tile:
    """A whole tile of one level.

    Attributes
    ----------
    level : int, 0 is full resolution
    index : int, row by row
    values : array (BLOCK, BLOCK, bands)
    valid : uint8 array (BLOCK, BLOCK) of 1 and 0, or None, 0 outside the image too; None where all are 1
    """

    level: int
    index: int
    values: AnyArray
    valid: ByteArray | None


@dataclass(frozen=True)
class Level:
    """Size of one level of an image: itself or an overview.

    Attributes
    ----------
    width, height : int, pixels
    """

    width: int
    height: int

    @property
    def across(self) -> int:
        """Tiles in a row."""
        return -(-self.width // BLOCK)

    @property
    def down(self) -> int:
        """Tiles in a column."""
        return -(-self.height // BLOCK)


def levels(width: int, height: int) -> list[Level]:
    """Sizes of an image and its overviews, down to the one that fits a tile.

    Parameters
    ----------
    width, height : int, pixels of the full size

    Returns
    -------
    list of Level, the full size first, each next one half as large, rounded up
    """
    sizes = [Level(width, height)]
    while max(sizes[-1].width, sizes[-1].height) > BLOCK:
        sizes.append(Level(-(-sizes[-1].width // 2), -(-sizes[-1].height // 2)))
    return sizes


def halve(values: AnyArray, valid: ByteArray | None, how: str) -> tuple[AnyArray, ByteArray | None]:
    """Reduce an array (2R, 2C, bands) to (R, C, bands).

    Parameters
    ----------
    values : array (2R, 2C, bands)
    valid : uint8 array (2R, 2C), optional
    how : str
        'average': mean of the valid ones of four pixels, ties to even, so that no level is brighter than the one
        above; 'rms': root of the mean of their squares, which of amplitudes is their mean in power; 'nearest': the
        upper left of four.

    Returns
    -------
    values : array (R, C, bands)
    valid : uint8 array (R, C), optional
        Valid where any of the four (average, rms) or the upper left (nearest) is
    """
    if how == "nearest":
        return values[0::2, 0::2].copy(), None if valid is None else valid[0::2, 0::2].copy()
    if how == "rms":
        squares, valid = halve(np.square(values, dtype=np.float64), valid, "average")
        return _rounded(np.sqrt(squares), values.dtype), valid
    if values.dtype.kind in "ui" and values.dtype.itemsize <= 2:
        return _halve_whole(values, valid)
    if valid is not None:
        values = np.where(valid[:, :, None] != 0, values, values.dtype.type(0))
    total = _of_four(values, np.float64)
    if valid is None:
        return _rounded(total * 0.25, values.dtype), None
    count = _of_four(valid)
    means = _rounded(total / np.maximum(count, 1)[:, :, None], values.dtype)
    return means, (count > 0).view(np.uint8)


# By number of the pixels that are valid; a third of a whole number is never near a tie, the others are exact.
_SHARES = np.array([0.0, 1.0, 1 / 2, 1 / 3, 1 / 4], dtype=np.float32)


def _halve_whole(values: AnyArray, valid: ByteArray | None) -> tuple[AnyArray, ByteArray | None]:
    """Means of whole numbers of up to 16 bits, whose sums need twice as many at most, and floats of 32."""
    wide = np.int16 if values.dtype.itemsize == 1 else np.int32
    if valid is None:
        total = _of_four(values, wide)
        # Ties to even: 1 is added where the quotient is even, 2 where it is odd, before the last two bits go.
        odd = (total >> 2) & 1
        total += odd
        total += 1
        total >>= 2
        return total.astype(values.dtype), None
    count, known = _of_four(valid), valid.astype(values.dtype, copy=False)
    share, means = _SHARES[count], np.empty((*count.shape, values.shape[2]), dtype=values.dtype)
    for band in range(values.shape[2]):  # arrays whose last axis is short take several times as long
        mean = _of_four(values[:, :, band] * known, wide).astype(np.float32)
        mean *= share
        means[:, :, band] = np.rint(mean, out=mean)
    return means, (count > 0).view(np.uint8)


def _of_four(values: AnyArray, wide: type[np.generic] | None = None) -> AnyArray:
    """Sums of four pixels each of an array (2R, 2C) or (2R, 2C, bands), of another type where one is given."""
    # Whole rows first: they lie together in memory.
    rows = values[0::2].astype(wide or values.dtype)
    rows += values[1::2]
    total: AnyArray = np.empty((rows.shape[0], rows.shape[1] // 2, *rows.shape[2:]), dtype=rows.dtype)
    for band in np.ndindex(rows.shape[2:]):  # one, where there is no axis of bands
        np.add(rows[:, 0::2, *band], rows[:, 1::2, *band], out=total[:, :, *band])
    return total


def _rounded(means: AnyArray, dtype: np.dtype[np.generic]) -> AnyArray:
    return (means if dtype.kind == "f" else np.rint(means)).astype(dtype)


@dataclass(frozen=True)
class Kept:
    """A tile that is as it was in an earlier file."""

    level: int
    index: int


@dataclass(frozen=True)
class Blank:
    """A tile without a valid pixel."""

    level: int
    index: int


Half = tuple[AnyArray, ByteArray | None]


@dataclass
class _Open:
    """A tile under construction: number of parts, parts to come, those with pixels, those kept unread."""

    # Parts stay apart until the last one is there: whole tiles would take the place of parts that are still to come,
    # for every tile of a row.
    count: int
    left: int
    parts: dict[int, Half]
    kept: list[int]


class Parents:
    """Tiles of the next levels under construction from the halves of four tiles each.

    Parameters
    ----------
    sizes : list of Level
    bands, dtype : of the raster
    again : callable, gives (level, index) of a kept tile's half, where a tile beside it has changed
    """

    def __init__(
        self, sizes: list[Level], bands: int, dtype: np.dtype[np.generic], again: Callable[[int, int], Half]
    ) -> None:
        self._sizes, self._bands, self._dtype, self._again = sizes, bands, dtype, again
        self._open: dict[tuple[int, int], _Open] = {}

    def add(self, level: int, index: int, half: Half | None) -> Tile | Kept | Blank | None:
        """Put the half of a tile in its place, None where nothing is valid; returns the parent with its last part.

        Parameters
        ----------
        level : int
        index : int
            Number of the tile in the level.
        half : Half or None
        """
        parent = self._parent(level, index)
        if half is not None:
            parent.parts[index] = half
        return self._arrived(level, index)

    def keep(self, level: int, index: int) -> Tile | Kept | Blank | None:
        """Note that a tile is as it was; so is the parent, where all its parts are."""
        self._parent(level, index).kept.append(index)
        return self._arrived(level, index)

    def _key(self, level: int, index: int) -> tuple[int, int]:
        row, col = divmod(index, self._sizes[level].across)
        return level + 1, (row // 2) * self._sizes[level + 1].across + col // 2

    def _parent(self, level: int, index: int) -> _Open:
        key, size = self._key(level, index), self._sizes[level]
        if key not in self._open:
            row, col = divmod(index, size.across)
            children = min(2, size.down - row // 2 * 2) * min(2, size.across - col // 2 * 2)
            self._open[key] = _Open(children, children, {}, [])
        return self._open[key]

    def _arrived(self, level: int, index: int) -> Tile | Kept | Blank | None:
        key = self._key(level, index)
        parent = self._open[key]
        parent.left -= 1
        if parent.left:
            return None
        del self._open[key]
        if len(parent.kept) == parent.count:
            return Kept(*key)
        if not parent.parts and not parent.kept:
            return Blank(*key)
        return self._joined(key, level, parent.parts | {child: self._again(level, child) for child in parent.kept})

    def _joined(self, key: tuple[int, int], level: int, parts: dict[int, Half]) -> Tile:
        values = np.zeros((BLOCK, BLOCK, self._bands), dtype=self._dtype)
        valid = np.zeros((BLOCK, BLOCK), dtype=np.uint8)
        for index, (part, part_valid) in parts.items():
            row, col = divmod(index, self._sizes[level].across)
            place = np.s_[row % 2 * HALF : row % 2 * HALF + HALF, col % 2 * HALF : col % 2 * HALF + HALF]
            values[place] = part
            valid[place] = 1 if part_valid is None else part_valid
        return Tile(*key, values, None if valid.all() else valid)
