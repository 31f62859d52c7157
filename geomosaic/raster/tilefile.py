"""A tiled GeoTIFF written window by window, with the same bytes whatever the windows' width and the threads."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import numpy as np

from geomosaic.geo.grid import Grid, Window
from geomosaic.raster import codec, tiff
from geomosaic.raster.codec import BLOCK
from geomosaic.raster.tiff import Field
from geomosaic.types import AnyArray, ByteArray


class TileFile:
    """A GeoTIFF under construction.

    Uncompressed tiles have their places from the start. Compressed ones follow each other row by row; a tile that
    comes early (from the second block row of a tall window) waits in memory for its turn. Mask tiles stay in memory,
    some tens of bytes each, and come last.

    Parameters
    ----------
    path : Path
        Made new; errors of the file system are raised as OSError.
    grid : Grid
        Place and size.
    bands, dtype, options
        Of the raster; `options` are GDAL's creation options for compression, colour and BIGTIFF.
    nodata : float or None
        Invalid pixels get this value, and there is no mask.
    threads : int
        Tiles that are compressed at once.
    sparse : bool
        Leave out tiles that hold no valid pixel; for temporary files.
    """

    def __init__(
        self,
        path: Path,
        grid: Grid,
        bands: int,
        dtype: str,
        options: Mapping[str, str],
        *,
        nodata: float | None = None,
        descriptions: Sequence[str | None] = (),
        tags: Mapping[str, str] | None = None,
        mask: bool = True,
        threads: int = 1,
        sparse: bool = False,
    ) -> None:
        self._grid, self._bands, self._dtype = grid, bands, np.dtype(dtype)
        self._nodata, self._keep_mask, self._sparse = nodata, mask and nodata is None, sparse
        self._across, self._down = -(-grid.width // BLOCK), -(-grid.height // BLOCK)
        raw_bytes = grid.width * grid.height * bands * self._dtype.itemsize
        self._profile: dict[str, Any] = codec.tile_profile(bands, dtype, options)
        self._big = _needs_big(self._profile.pop("bigtiff", "IF_SAFER"), raw_bytes)
        self._directory = codec.describe_raster(
            grid, self._profile, nodata=nodata, descriptions=descriptions, tags=tags or {}, where=str(path)
        )
        self._raw = self._directory[tiff.COMPRESSION].integers[0] == 1
        self._tile_bytes = BLOCK * BLOCK * bands * self._dtype.itemsize
        tiles = self._across * self._down
        self._offsets, self._counts = [0] * tiles, [0] * tiles
        self._written = bytearray(tiles)
        self._masks: dict[int, bytes] = {}
        self._masked = False
        self._waiting: dict[int, bytes] = {}
        self._next = 0
        self._jobs: deque[tuple[int, Future[bytes]]] = deque()
        self._most_jobs = 4 * threads
        self._pool = None if self._raw or threads < 2 else ThreadPoolExecutor(threads, thread_name_prefix="tiles")
        self._file: BinaryIO = path.open("w+b", buffering=0)
        tiff.write_header(self._file, big=self._big)
        self._end = self._file.tell()

    def __enter__(self) -> TileFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop; without `finish` before, the file is no TIFF."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
        self._file.close()

    def write(self, window: Window, values: AnyArray, valid: ByteArray | None) -> None:
        """Add a window that covers whole blocks (but for the image's edge); windows come row by row.

        Parameters
        ----------
        window : Window
            In pixels of the grid.
        values : array (rows, cols, bands)
            Of the file's type. Not changed; may be used again by the caller at once.
        valid : uint8 array (rows, cols) of 1 and 0, or None
            None where all are valid.
        """
        for part in window.split(BLOCK, BLOCK):
            rows = slice(part.row - window.row, part.stop_row - window.row)
            cols = slice(part.col - window.col, part.stop_col - window.col)
            tile_valid = None if valid is None else valid[rows, cols]
            if tile_valid is not None and tile_valid.all():
                tile_valid = None
            self._write_tile(
                (part.row // BLOCK) * self._across + part.col // BLOCK,
                self._padded(values[rows, cols], tile_valid),
                tile_valid,
                part,
            )

    def _padded(self, values: AnyArray, valid: ByteArray | None) -> AnyArray:
        """Copy to a whole tile, invalid pixels set to nodata or zero."""
        rows, cols = values.shape[:2]
        if (rows, cols) == (BLOCK, BLOCK) and valid is None and self._nodata is None:
            return np.ascontiguousarray(values) if self._pool is None else np.array(values, order="C")
        tile = np.zeros((BLOCK, BLOCK, self._bands), dtype=self._dtype)
        if self._nodata is not None:
            tile[...] = self._nodata
            values = _off_nodata(values, self._nodata)
        if valid is None:
            tile[:rows, :cols] = values
        else:
            np.copyto(tile[:rows, :cols], values, where=(valid != 0)[:, :, None])
        return tile

    def _write_tile(self, index: int, tile: AnyArray, valid: ByteArray | None, part: Window) -> None:
        self._written[index] = 1
        if self._keep_mask:
            if valid is None and (part.width, part.height) == (BLOCK, BLOCK):
                self._masks[index] = codec.encode_mask(None)
            else:
                whole = np.zeros((BLOCK, BLOCK), dtype=np.uint8)
                whole[: part.height, : part.width] = 1 if valid is None else valid
                self._masks[index] = codec.encode_mask(whole)
            self._masked = self._masked or valid is not None
        if self._sparse and valid is not None and not valid.any():
            if not self._raw:
                self._compressed(index, b"")
        elif self._raw:
            self._place(index, tile)
        elif self._pool is None:
            self._compressed(index, codec.encode_tile(tile, self._profile))
        else:
            self._jobs.append((index, self._pool.submit(codec.encode_tile, tile, self._profile)))
            self._collect(self._most_jobs)

    def _collect(self, left: int) -> None:
        while len(self._jobs) > left:
            index, job = self._jobs.popleft()
            self._compressed(index, job.result())

    def _place(self, index: int, tile: AnyArray) -> None:
        """Write an uncompressed tile at its place; zeros become a hole in the file."""
        self._offsets[index] = 16 + index * self._tile_bytes
        self._counts[index] = self._tile_bytes
        if tile.any():
            self._file.seek(self._offsets[index])
            self._write_bytes(tile.data.cast("B"))

    def _write_bytes(self, data: bytes | memoryview) -> None:
        """Write all bytes or raise; an unbuffered file may take only a part."""
        left = memoryview(data)
        while len(left):
            done = self._file.write(left)
            left = left[done:]

    def _compressed(self, index: int, data: bytes) -> None:
        """Append compressed tiles whose turn has come."""
        self._waiting[index] = data
        while self._next in self._waiting:
            self._append(self._offsets, self._counts, self._next, self._waiting.pop(self._next))
            self._next += 1

    def _append(self, offsets: list[int], counts: list[int], index: int, data: bytes) -> None:
        if data:
            self._file.seek(self._end)
            self._write_bytes(data)
            offsets[index], counts[index] = self._end, len(data)
            self._end += len(data)

    def finish(self) -> None:
        """Write what is waiting, the mask and the directories, and bring the file to the disk.

        Raises
        ------
        OverflowError
            BIGTIFF=NO was asked for and the file is too large.
        ValueError
            Windows are missing.
        """
        self._collect(0)
        if not all(self._written):
            raise ValueError("not every window of the raster was written")
        if self._raw:
            self._end = 16 + len(self._offsets) * self._tile_bytes
            self._file.truncate(self._end)
        directories = [{**self._directory, **self._places(self._offsets, self._counts)}]
        if self._masked:
            offsets, counts = [0] * len(self._offsets), [0] * len(self._offsets)
            for index in sorted(self._masks):
                self._append(offsets, counts, index, self._masks[index])
            size = {tag: self._directory[tag] for tag in (tiff.WIDTH, tiff.LENGTH)}
            directories.append({**codec.MASK_TAGS, **size, **self._places(offsets, counts)})
        tiff.write_directories(self._file, directories, big=self._big)

    def _places(self, offsets: list[int], counts: list[int]) -> dict[int, Field]:
        kind = 16 if self._big else 4
        try:
            return {tiff.TILE_OFFSETS: Field.of(kind, *offsets), tiff.TILE_COUNTS: Field.of(kind, *counts)}
        except Exception as error:
            raise OverflowError("more than 4 GB need BigTIFF") from error


def _needs_big(option: str, raw_bytes: int) -> bool:
    """Decide as GDAL does: IF_SAFER takes BigTIFF from 2 GB uncompressed, IF_NEEDED from 4 GB."""
    choice = str(option).upper()
    if choice in ("YES", "NO"):
        return choice == "YES"
    return raw_bytes > (4_000_000_000 if choice == "IF_NEEDED" else 2_000_000_000)


def _off_nodata(values: AnyArray, nodata: float) -> AnyArray:
    """Move valid pixels that happen to equal nodata to the next value, so that they stay valid."""
    if np.isnan(nodata):
        return values
    same = values == nodata
    if values.dtype.kind == "u" and values.shape[2] > 1:  # see validity.missing_by_value
        same = same.all(axis=2, keepdims=True)
    if not same.any():
        return values
    if values.dtype.kind == "f":
        near = np.nextafter(values.dtype.type(nodata), values.dtype.type(0 if nodata else 1))
    else:
        near = nodata - 1 if nodata == np.iinfo(values.dtype).max else nodata + 1
    return np.where(same, values.dtype.type(near), values)
