"""Tiles of a TIFF: made, appended in order, and taken over from an earlier file."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from types import TracebackType
from typing import Any, BinaryIO

import numpy as np
from rasterio.errors import RasterioError

from geomosaic.errors import OutputError
from geomosaic.geo.grid import Window
from geomosaic.raster.cog import codec, tiff
from geomosaic.raster.cog.codec import BLOCK
from geomosaic.raster.cog.overviews import Half, Level, Tile, halve, levels
from geomosaic.raster.cog.tiff import Directory, Field
from geomosaic.raster.validity import combine, in_all_bands, missing_by_value
from geomosaic.stores.path import to_path
from geomosaic.types import AnyArray, ByteArray, PathLike


def filled(values: AnyArray, valid: ByteArray | None, nodata: float | None) -> AnyArray:
    """Values with nodata, or zero, where they are not valid; valid ones are moved off nodata.

    Parameters
    ----------
    values : array (rows, cols, bands)
    valid : uint8 array (rows, cols) or None, None where all are valid
    nodata : float or None

    Returns
    -------
    array (rows, cols, bands), `values` itself where nothing is to be changed
    """
    if nodata is not None:
        values = _off_nodata(values, valid, nodata)
    if valid is None:
        return values
    blank = values.dtype.type(0 if nodata is None else nodata)
    if not valid.any():
        return np.full_like(values, blank)
    if blank == 0 and values.dtype.kind in "iu":  # several times as fast as choosing
        filled: AnyArray = values * valid[..., None].astype(values.dtype)
        return filled
    return np.where(valid[..., None] != 0, values, blank)


def _off_nodata(values: AnyArray, valid: ByteArray | None, nodata: float) -> AnyArray:
    """Move valid pixels that happen to equal nodata to the next value, so that they stay valid."""
    if np.isnan(nodata):
        return values
    one = values.dtype.type(nodata)
    if values.dtype.kind == "u":  # only where all bands have it, see validity.missing_by_value
        pixels = in_all_bands(values, one)
        same = None if pixels is None else pixels[..., None]
    else:
        same = values == one
    if same is None or not (same if valid is None else same & (valid[..., None] != 0)).any():
        return values
    if values.dtype.kind == "f":
        near = np.nextafter(one, values.dtype.type(0 if nodata else 1))
    else:
        near = nodata - 1 if nodata == np.iinfo(values.dtype).max else nodata + 1
    return np.where(same, values.dtype.type(near), values)


@dataclass(frozen=True, eq=False)
class Pieces:
    """A tile made ready to be put in its place.

    Attributes
    ----------
    level, index : int, as in `pyramid.Tile`
    data : bytes-like, as they stand in the file
    zero : bool, whether these are all 0 and take no room in the file
    mask : bytes, of the internal mask; empty where none is kept
    half : Half, optional, None where the tile has no valid pixel, and on the last level
    """

    level: int
    index: int
    data: bytes | memoryview
    zero: bool
    mask: bytes
    half: Half | None

    def __reduce__(self) -> tuple[Any, ...]:
        # Uncompressed, the bytes are a view of an array.
        return Pieces, (self.level, self.index, bytes(self.data), self.zero, self.mask, self.half)


@dataclass(frozen=True, eq=False)
class WindowTiles:
    """The tiles of a window, made ready.

    Attributes
    ----------
    pieces : list of Pieces, row by row
    masked : bool, whether any pixel of the window is not valid
    """

    pieces: list[Pieces]
    masked: bool


@dataclass(frozen=True, eq=False)
class TileMaker:
    """Makes the pieces of tiles; pure, for any thread.

    Attributes
    ----------
    profile : mapping, of a GeoTIFF of one tile, see `codec.tile_profile`
    raw : bool, whether nothing is compressed
    nodata : float, optional
    categorical : bool, see `codec.encode_tile`
    overviews : str, how tiles are halved
    masked : bool, whether masks are kept
    last : int, level of which no half is wanted
    """

    profile: Mapping[str, Any]
    raw: bool
    nodata: float | None
    categorical: bool
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
        data = codec.encode_tile(values, self.profile, categorical=self.categorical)
        return Pieces(tile.level, tile.index, data, False, mask, half)

    def nothing(self, level: int, index: int) -> Pieces:
        """Pieces of a tile without a valid pixel: all of them are alike, and made once."""
        one = self._nothing
        return Pieces(level, index, one.data, one.zero, one.mask, None)

    @cached_property
    def _nothing(self) -> Pieces:
        values = np.zeros((BLOCK, BLOCK, self.profile["count"]), dtype=self.profile["dtype"])
        return self.pieces(Tile(self.last, 0, values, np.zeros((BLOCK, BLOCK), dtype=np.uint8)), blank=False)


@dataclass(frozen=True, eq=False)
class WindowTiler:
    """Tiles of windows of one raster, made apart from its file: pure, for any thread or process.

    Attributes
    ----------
    maker : TileMaker
    size : Level
        Of the raster.
    bands : int
    dtype : NumPy dtype
    overviews : bool
        Whether the raster has overviews, for which tiles are halved.
    """

    maker: TileMaker
    size: Level
    bands: int
    dtype: np.dtype[Any]
    overviews: bool

    def of_size(self, width: int, height: int) -> WindowTiler:
        """The same of a raster of another size, which has overviews if this one has."""
        if (width, height) == (self.size.width, self.size.height):
            return self
        last = len(levels(width, height)) - 1 if self.overviews else 0
        return replace(self, size=Level(width, height), maker=replace(self.maker, last=last))

    def tiles(self, window: Window, values: AnyArray, valid: ByteArray | None, *, blank: bool = False) -> WindowTiles:
        """Tiles of a window that covers whole blocks (but for the image's edge).

        Parameters
        ----------
        window : Window, in pixels of the grid
        values : array (rows, cols, bands)
            Of the file's type. Neither it nor `valid` may change afterwards: tiles may be parts of them.
        valid : uint8 array (rows, cols) of 1 and 0, or None, None where all are valid
        blank : bool, whether invalid pixels, and no others, hold nodata already (zero where there is none)

        Raises
        ------
        OutputError
            GDAL cannot compress it.
        """
        self._check(window)
        if values.shape != (window.height, window.width, self.bands) or values.dtype != self.dtype:
            raise ValueError(f"{values.dtype} values of shape {values.shape} do not fill {window}")
        if valid is not None and valid.view(np.bool_).all():
            valid = None
        made = []
        for part in window.split(BLOCK, BLOCK):
            here, index = part.slices_in(window), self.index(part)
            seen = None if valid is None else valid[here]
            if seen is not None and not seen.view(np.bool_).any():
                made.append(self.maker.nothing(0, index))
            else:
                made.append(self._pieces(self._tile(index, values[here], seen), blank))
        return WindowTiles(made, valid is not None)

    def _pieces(self, tile: Tile, blank: bool) -> Pieces:
        try:
            return self.maker.pieces(tile, blank)
        except (OSError, RasterioError) as error:
            raise OutputError(
                f"a tile cannot be compressed ({error.__cause__ or error})",
                hint="choose another compression (`creation`: COMPRESS=...)",
            ) from error

    def empty(self, window: Window) -> WindowTiles:
        """Tiles of a window that covers whole blocks and has no valid pixel."""
        self._check(window)
        return WindowTiles([self.maker.nothing(0, self.index(part)) for part in window.split(BLOCK, BLOCK)], True)

    def index(self, part: Window) -> int:
        """Number of the tile that a window starts with."""
        return (part.row // BLOCK) * self.size.across + part.col // BLOCK

    def _tile(self, index: int, values: AnyArray, valid: ByteArray | None) -> Tile:
        """Copy to a whole tile."""
        rows, cols = values.shape[:2]
        if valid is not None and valid.view(np.bool_).all():
            valid = None
        if (rows, cols) == (BLOCK, BLOCK):
            return Tile(0, index, values, valid)
        whole = np.zeros((BLOCK, BLOCK, self.bands), dtype=self.dtype)
        whole[:rows, :cols] = values
        whole_valid = np.zeros((BLOCK, BLOCK), dtype=np.uint8)
        whole_valid[:rows, :cols] = 1 if valid is None else valid
        return Tile(0, index, whole, whole_valid)

    def _check(self, window: Window) -> None:
        raster = Window(0, 0, self.size.width, self.size.height)
        if window.col % BLOCK or window.row % BLOCK or window.intersection(raster) != window:
            raise ValueError(f"{window} does not start on a block of {BLOCK} or leaves the raster")
        if any(
            stop % BLOCK and stop != end
            for stop, end in ((window.stop_col, raster.width), (window.stop_row, raster.height))
        ):
            raise ValueError(f"{window} ends within a block of {BLOCK}")


# Bytes of a tile that are rather copied than written in three pieces.
_SMALL = 1 << 16


class TileStore:
    """Appends tiles to a file in the order of their numbers.

    A tile that comes early waits in memory for its turn. Mask tiles, some tens of bytes each, stay in memory.

    Parameters
    ----------
    file : binary file, unbuffered; the store writes from `start` on
    start : int
    count : int, number of tiles
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
        """Add a tile; of one that is all zero bytes the file keeps a hole.

        Parameters
        ----------
        index : int
            Number of the tile.
        data : bytes or memoryview
            Compressed bytes.
        zero : bool
            Whether all its bytes are zero.
        """
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
        """Tags that say where the tiles are, when `start` is at `base` of the final file."""
        kind, shift = 16 if big else 4, base - self.start
        return {
            tiff.TILE_OFFSETS: Field.of(kind, *(offset + shift for offset in self.offsets)),
            tiff.TILE_COUNTS: Field.of(kind, *self.counts),
        }

    def mask_fields(self, base: int, *, big: bool) -> dict[int, Field]:
        """Tags that say where the mask's tiles are, when they follow each other from `base` on."""
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
    """Write of all bytes to an unbuffered file, which may take only a part at a time.

    Parameters
    ----------
    file : binary file
    data : bytes or memoryview

    Raises
    ------
    OSError
        Writing failed.
    """
    left = memoryview(data)
    while len(left):
        left = left[file.write(left) :]


class EarlierTiles:
    """The compressed tiles of a file, level by level, to be copied or decoded.

    Parameters
    ----------
    path : path, A tiled TIFF with tiles of `BLOCK`; a COG's overviews and masks are found by their kind

    Raises
    ------
    ValueError
        It is no such file.
    OSError
        It cannot be read.
    """

    def __init__(self, path: PathLike) -> None:
        self._file = to_path(path).open("rb")
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
    def if_compatible(cls, path: PathLike, directory: Directory, sizes: list[Level]) -> EarlierTiles | None:
        """Open a file whose tiles can be taken over by one of that directory and those levels; None where it cannot.

        Parameters
        ----------
        path : path-like
        directory : Directory
        sizes : sequence of Level
        """
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
        """Values (BLOCK, BLOCK, bands) of a tile and where they are valid, as `pyramid.Tile` has them.

        Parameters
        ----------
        level : int
            0 for the raster, then its overviews.
        index : int
            Number of the tile in the level.
        size : Level
        nodata : float or None
        """
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
    size : Level, of the image
    index : int, of the tile, row by row

    Returns
    -------
    uint8 array (BLOCK, BLOCK) or None, 1 inside, 0 beyond the edge; None where all lie inside
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
