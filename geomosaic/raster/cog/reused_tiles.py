"""Tiles of a GeoTIFF that this program has written, as they stand in the file."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path
from types import TracebackType

import numpy as np

from geomosaic.geo.grid import Window
from geomosaic.raster.cog import codec, tiff
from geomosaic.raster.cog.codec import BLOCK
from geomosaic.raster.cog.overviews import Level
from geomosaic.raster.cog.tiff import Directory
from geomosaic.raster.validity import combine, missing_by_value
from geomosaic.types import AnyArray, ByteArray, PathLike


class EarlierTiles:
    """The compressed tiles of a file, level by level, to be copied or decoded.

    Parameters
    ----------
    path : path
        A tiled TIFF with tiles of `BLOCK`; a COG's overviews and masks are found by their kind.

    Raises
    ------
    ValueError
        It is no such file.
    OSError
        It cannot be read.
    """

    def __init__(self, path: PathLike) -> None:
        self._file = Path(path).open("rb")  # noqa: SIM115 - closed by `close`
        try:
            found = tiff.read_directories(self._file)
            kinds = [_kind(directory) for directory in found]
            self.levels = [one for one, kind in zip(found, kinds, strict=True) if not kind & 4]
            self._masks = [one for one, kind in zip(found, kinds, strict=True) if kind & 4]
            if not self.levels or len(self._masks) not in (0, len(self.levels)):
                raise ValueError("masks of some levels only")
            self._places = [_places(directory) for directory in self.levels]
            self._mask_places = [_places(directory) for directory in self._masks]
        except (KeyError, ValueError, struct.error):
            self._file.close()
            raise ValueError(f"{path} is no file of tiles") from None

    def __enter__(self) -> EarlierTiles:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @classmethod
    def alike(cls, path: PathLike, directory: Directory, sizes: list[Level]) -> EarlierTiles | None:
        """Open a file whose tiles can be taken over by one of that directory and those levels; None where it cannot."""
        try:
            earlier = cls(path)
        except (OSError, ValueError):
            return None
        same = all(earlier.levels[0].get(tag) == directory.get(tag) for tag in codec.PIXEL_TAGS)
        counts = [len(offsets) for offsets, _ in earlier._places]
        if same and counts == [level.across * level.down for level in sizes]:
            return earlier
        earlier.close()
        return None

    def tile(self, level: int, index: int) -> bytes:
        """Bytes of a tile."""
        return self._read(*(part[index] for part in self._places[level]))

    def mask(self, level: int, index: int) -> bytes | None:
        """Bytes of a mask tile; None where the file has no masks: every pixel is valid then."""
        return self._read(*(part[index] for part in self._mask_places[level])) if self._masks else None

    def _read(self, offset: int, count: int) -> bytes:
        self._file.seek(offset)
        data = self._file.read(count)
        if len(data) != count:
            raise ValueError("the file ends inside a tile")
        return data

    def decoded(self, level: int, index: int, size: Level, nodata: float | None) -> tuple[AnyArray, ByteArray | None]:
        """Values (BLOCK, BLOCK, bands) of a tile and where they are valid, as `pyramid.Tile` has them."""
        values = codec.decode_tile(self.levels[level], self.tile(level, index))
        inside = inside_of(size, index)
        mask = self.mask(level, index)
        if mask is not None:
            bits = np.frombuffer(zlib.decompress(mask), dtype=np.uint8).reshape(BLOCK, BLOCK // 8)
            valid: ByteArray | None = np.unpackbits(bits, axis=1)
        elif nodata is not None:
            known = combine(missing_by_value(values, (nodata,) * values.shape[2]), None)
            valid = inside if known is None else (known if inside is None else known & inside)
        else:
            valid = inside
        return values, None if valid is None or valid.all() else valid


def inside_of(size: Level, index: int) -> ByteArray | None:
    """Pixels of a tile that lie within the image.

    Parameters
    ----------
    size : Level
        Of the image.
    index : int
        Of the tile, row by row.

    Returns
    -------
    uint8 array (BLOCK, BLOCK) or None
        1 inside, 0 beyond the edge; None where all lie inside.
    """
    row, col = divmod(index, size.across)
    part = Window(col * BLOCK, row * BLOCK, BLOCK, BLOCK).intersection(Window(0, 0, size.width, size.height))
    if (part.width, part.height) == (BLOCK, BLOCK):
        return None
    inside = np.zeros((BLOCK, BLOCK), dtype=np.uint8)
    inside[: part.height, : part.width] = 1
    return inside


def _kind(directory: Directory) -> int:
    field = directory.get(tiff.NEW_SUBFILE_TYPE)
    return field.integers[0] if field else 0


def _places(directory: Directory) -> tuple[tuple[int, ...], tuple[int, ...]]:
    if directory[tiff.TILE_WIDTH].integers != (BLOCK,) or directory[tiff.TILE_LENGTH].integers != (BLOCK,):
        raise ValueError("tiles of another size")
    return directory[tiff.TILE_OFFSETS].integers, directory[tiff.TILE_COUNTS].integers
