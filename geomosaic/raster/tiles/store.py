"""Tiles of one level in a file, row by row, whatever the order in which they come."""

from __future__ import annotations

import struct
from typing import BinaryIO

from geomosaic.raster.tiles import tiff
from geomosaic.raster.tiles.tiff import Field

_SMALL = 1 << 16
"""Bytes of a tile that are rather copied than written in three pieces."""


class TileStore:
    """Appends tiles to a file in the order of their numbers.

    A tile that comes early waits in memory for its turn. Mask tiles, some tens of bytes each, stay in memory.

    Parameters
    ----------
    file : binary file
        Unbuffered; the store writes from `start` on.
    start : int
    count : int
        Number of tiles.
    framed : bool
        Put a tile's size (4 bytes) before it and its last 4 bytes once more behind it, as GDAL's COGs have them: a
        reader then needs no table of sizes, and sees if another program has changed the tile.
    """

    def __init__(self, file: BinaryIO, start: int, count: int, *, framed: bool = False) -> None:
        self.file, self.start, self.end, self.framed = file, start, start, framed
        self.offsets, self.counts = [0] * count, [0] * count
        self.masks: dict[int, bytes] = {}
        self._waiting: dict[int, bytes | None] = {}
        self._next = 0
        self._at = 0

    @property
    def complete(self) -> bool:
        """Whether every tile is there."""
        return self._next == len(self.offsets)

    def add(self, index: int, data: bytes | memoryview, *, zero: bool = False) -> None:
        """Add a tile; of one that is all zero bytes the file keeps a hole."""
        self.counts[index] = len(data)
        if index == self._next:
            self._append(index, None if zero else data)
            while self._next in self._waiting:
                self._append(self._next, self._waiting.pop(self._next))
        else:
            self._waiting[index] = None if zero else bytes(data)

    def _append(self, index: int, data: bytes | memoryview | None) -> None:
        size = self.counts[index]
        edge = 4 if self.framed else 0
        self.offsets[index] = self.end + edge
        if self._at != self.end:
            self.file.seek(self.end)
        if self.framed and data is not None and size <= _SMALL:
            write_all(self.file, b"".join((struct.pack("<I", size), data, data[-4:])))
        else:
            if self.framed:
                write_all(self.file, struct.pack("<I", size))
            if data is not None:
                write_all(self.file, data)
                if self.framed:
                    write_all(self.file, data[-4:])
        self.end += size + 2 * edge
        self._at = self.end if data is not None else -1
        self._next += 1

    def fields(self, base: int, *, big: bool) -> dict[int, Field]:
        """Return the tags that say where the tiles are, when `start` is at `base` of the final file."""
        kind, shift = 16 if big else 4, base - self.start
        return {
            tiff.TILE_OFFSETS: Field.of(kind, *(offset + shift for offset in self.offsets)),
            tiff.TILE_COUNTS: Field.of(kind, *self.counts),
        }

    def mask_fields(self, base: int, *, big: bool) -> dict[int, Field]:
        """Return the same for the mask's tiles, when they follow each other from `base` on."""
        kind, offsets = 16 if big else 4, []
        counts = [len(self.masks[index]) for index in range(len(self.offsets))]
        edge = 4 if self.framed else 0
        for count in counts:
            offsets.append(base + edge)
            base += count + 2 * edge
        return {tiff.TILE_OFFSETS: Field.of(kind, *offsets), tiff.TILE_COUNTS: Field.of(kind, *counts)}

    def mask_bytes(self) -> bytes:
        """All mask tiles."""
        tiles = [self.masks[index] for index in range(len(self.offsets))]
        if self.framed:
            tiles = [struct.pack("<I", len(tile)) + tile + tile[-4:] for tile in tiles]
        return b"".join(tiles)


def write_all(file: BinaryIO, data: bytes | memoryview) -> None:
    """Write all bytes or raise: an unbuffered file may take only a part."""
    left = memoryview(data)
    while len(left):
        left = left[file.write(left) :]
