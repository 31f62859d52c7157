"""What a tile becomes in a file: compressed values, its mask, and its half for the next overview."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from geomosaic.raster.tiles import codec
from geomosaic.raster.tiles.blank import filled
from geomosaic.raster.tiles.codec import BLOCK
from geomosaic.raster.tiles.pyramid import Half, Tile, halve


@dataclass(frozen=True, eq=False)
class Pieces:
    """A tile made ready to be put in its place.

    Attributes
    ----------
    level, index : int
        As in `pyramid.Tile`.
    data : bytes-like
        As they stand in the file.
    zero : bool
        Whether these are all 0 and take no room in the file.
    mask : bytes
        Of the internal mask; empty where none is kept.
    half : Half, optional
        None where the tile has no valid pixel, and on the last level.
    """

    level: int
    index: int
    data: bytes | memoryview
    zero: bool
    mask: bytes
    half: Half | None


@dataclass(frozen=True, eq=False)
class TileMaker:
    """Makes the pieces of tiles; pure, for any thread.

    Attributes
    ----------
    profile : mapping
        Of a GeoTIFF of one tile, see `codec.tile_profile`.
    raw : bool
        Whether nothing is compressed.
    nodata : float, optional
    classes : bool
        See `codec.encode_tile`.
    overviews : str
        How tiles are halved.
    masked : bool
        Whether masks are kept.
    last : int
        Level of which no half is wanted.
    """

    profile: Mapping[str, Any]
    raw: bool
    nodata: float | None
    classes: bool
    overviews: str
    masked: bool
    last: int

    def pieces(self, tile: Tile, blank: bool) -> Pieces:
        """Fill (unless `blank` says that it is), compress and halve a tile."""
        values, valid = np.ascontiguousarray(tile.values), tile.valid
        if not blank:
            values = filled(values, valid, self.nodata)
        mask = codec.encode_mask(valid) if self.masked else b""
        half = halve(values, valid, self.overviews) if tile.level < self.last else None
        if self.raw:
            middle = values[BLOCK // 2, BLOCK // 2]
            zero = not (middle.any() or values.any())  # the middle spares the rest, nearly everywhere
            return Pieces(tile.level, tile.index, values.data.cast("B"), zero, mask, half)
        data = codec.encode_tile(values, self.profile, classes=self.classes)
        return Pieces(tile.level, tile.index, data, False, mask, half)

    def nothing(self, level: int, index: int) -> Pieces:
        """Pieces of a tile without a valid pixel: all of them are alike, and made once."""
        one = self._nothing
        return Pieces(level, index, one.data, one.zero, one.mask, None)

    @cached_property
    def _nothing(self) -> Pieces:
        values = np.zeros((BLOCK, BLOCK, self.profile["count"]), dtype=self.profile["dtype"])
        return self.pieces(Tile(self.last, 0, values, np.zeros((BLOCK, BLOCK), dtype=np.uint8)), blank=False)
