"""A tiled GeoTIFF or COG written window by window, with the same bytes whatever the windows and the threads.

The layout of a COG follows OGC 21-026 and the description of GDAL's COG driver: directories first, then the tiles of
the smallest overview, up to those of full resolution.
"""

from __future__ import annotations

import shutil
from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

import numpy as np

from geomosaic.geo.grid import Grid, Window
from geomosaic.raster.cog import codec, tiff
from geomosaic.raster.cog.codec import BLOCK
from geomosaic.raster.cog.overviews import Blank, Half, Kept, Level, Parents, Tile, halve, levels
from geomosaic.raster.cog.tiff import Directory, Field
from geomosaic.raster.cog.tiles import (
    EarlierTiles,
    Pieces,
    TileMaker,
    TileStore,
    WindowTiler,
    WindowTiles,
    inside_of,
    write_all,
)
from geomosaic.raster.environment import enter_for_good

# Offset of the first tile of a plain GeoTIFF: room for the header of a BigTIFF, which is written last.
_START = 16
_OVERVIEW_TAGS = (33550, 33922, 34264, 34735, 34736, 34737, 42112)  # geo-reference and metadata stay with level 0


class TileFile:
    """A GeoTIFF under construction.

    Parameters
    ----------
    path : Path
        Made new; errors of the file system come as OSError. While a COG grows, its levels are in files of this name
        with a number behind.
    grid : Grid, place and size
    samples : Samples
    options : mapping of str to str, GTiff creation options for compression, colour and BIGTIFF
    metadata : RasterMetadata
    overviews : str or None, 'average', 'rms' or 'nearest': overviews are made so; for a COG only
    cog : bool, A COG instead of a plain GeoTIFF
    threads : int, tiles of overviews that are compressed at once
    """

    def __init__(
        self,
        path: Path,
        grid: Grid,
        samples: codec.Samples,
        options: Mapping[str, str],
        metadata: codec.RasterMetadata,
        *,
        overviews: str | None = None,
        cog: bool = False,
        threads: int = 1,
    ) -> None:
        bands, nodata = samples.bands, samples.nodata
        self._path, self._grid, self._dtype = path, grid, np.dtype(samples.dtype)
        self._nodata, self._keep_mask, self._masked = nodata, samples.mask and nodata is None, False
        self._halves, self._cog = overviews or "average", cog
        self._profile: dict[str, Any] = codec.tile_profile(bands, samples.dtype, options)
        raw_bytes = grid.width * grid.height * bands * self._dtype.itemsize
        self._big = tiff.needs_big(self._profile.pop("bigtiff", "IF_SAFER"), raw_bytes * (4 / 3 if overviews else 1))
        self._directory = codec.describe_raster(grid, self._profile, metadata, nodata=nodata, where=str(path))
        self._raw = self._directory[tiff.COMPRESSION].integers[0] == 1
        self._levels = levels(grid.width, grid.height) if overviews else [Level(grid.width, grid.height)]
        self._maker = TileMaker(
            self._profile, self._raw, nodata, metadata.categorical, self._halves, self._keep_mask, len(self._levels) - 1
        )
        self.tiler = WindowTiler(self._maker, self._levels[0], bands, self._dtype, overviews is not None)
        """What makes the tiles of windows, in any thread or process."""
        self._parents = Parents(self._levels, bands, self._dtype, self._half_again)
        self._earlier: EarlierTiles | None = None
        self._jobs: deque[Future[Pieces]] = deque()
        # Tiles of overviews in work or waiting for their turn: each holds its pixels.
        self._most_jobs = 4 * threads
        several = threads > 1 and len(self._levels) > 1
        self._pool = ThreadPoolExecutor(threads, "tiles", enter_for_good) if several else None
        self._files: list[BinaryIO] = []
        names = [path.with_name(f"{path.name}.{i}") for i in range(len(self._levels))] if cog else [path]
        try:
            for name in names:
                self._files.append(name.open("w+b", buffering=0))
        except OSError:
            self.close()
            raise
        self._stores = [
            TileStore(file, 0 if cog else _START, level.across * level.down, framed=cog)
            for file, level in zip(self._files, self._levels, strict=True)
        ]

    def __enter__(self) -> TileFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop; without `finish` before, the file is no TIFF. Files of levels stay for the caller to remove."""
        if self._pool is not None:
            self._pool.shutdown(wait=True, cancel_futures=True)
        for file in self._files:
            file.close()
        if self._earlier is not None:
            self._earlier.close()

    def add(self, tiles: WindowTiles) -> None:
        """Put the tiles of a window in their places; from one thread, each window once."""
        self._masked = self._masked or tiles.masked
        for made in tiles.pieces:
            self._place(made)

    def reuse_tiles_of(self, path: Path) -> bool:
        """Take tiles that are kept from an earlier file from now on; false where it is none of this form."""
        self._earlier = EarlierTiles.if_compatible(path, self._directory, self._levels)
        return self._earlier is not None

    def keep(self, window: Window) -> None:
        """Take a window that covers whole blocks from the earlier file as it stands there."""
        self._place_done()  # what comes behind them would wait in memory
        for part in window.split(BLOCK, BLOCK):
            self._keep(Kept(0, self.tiler.index(part)))

    def _keep(self, tile: Kept) -> None:
        store, earlier, size = self._stores[tile.level], self._earlier, self._levels[tile.level]
        assert earlier is not None
        data = earlier.tile(tile.level, tile.index)
        if self._keep_mask:
            mask, inside = earlier.mask(tile.level, tile.index), codec.encode_mask(inside_of(size, tile.index))
            store.masks[tile.index] = mask or inside
            self._masked = self._masked or (tile.level == 0 and (mask or inside) != inside)
        store.add(tile.index, data, zero=self._raw and not np.frombuffer(data, dtype=np.uint8).any())
        if tile.level + 1 < len(self._levels):
            self._go_on(self._parents.keep(tile.level, tile.index))

    def _half_again(self, level: int, index: int) -> Half:
        """Half of a tile of the earlier file, whose neighbours have changed."""
        assert self._earlier is not None
        values, valid = self._earlier.decoded(level, index, self._levels[level], self._nodata)
        return halve(values, valid, self._halves)

    def _go_on(self, parent: Tile | Kept | Blank | None) -> None:
        if isinstance(parent, Kept):
            self._keep(parent)
        elif isinstance(parent, Blank):
            self._place(self._maker.nothing(parent.level, parent.index))
        elif parent is not None:
            self._make(parent)

    def _make(self, tile: Tile) -> None:
        """Make a tile of an overview, here or in another thread, and put what is ready in its place."""
        if self._pool is None:
            self._place(self._maker.pieces(tile, False))
            return
        self._jobs.append(self._pool.submit(self._maker.pieces, tile, False))
        self._place_done(self._most_jobs)

    def _place_done(self, most: int = 0) -> None:
        """Put in their places all but so many of the tiles of overviews that are being made."""
        while len(self._jobs) > most:
            self._place(self._jobs.popleft().result())

    def _place(self, made: Pieces) -> None:
        store = self._stores[made.level]
        if self._keep_mask:
            store.masks[made.index] = made.mask
        store.add(made.index, made.data, zero=made.zero)
        if made.level + 1 < len(self._levels):
            self._go_on(self._parents.add(made.level, made.index, made.half))

    def finish(self) -> None:
        """Complete the file.

        Raises
        ------
        OverflowError
            BIGTIFF=NO was asked for and the file is too large.
        ValueError
            Windows are missing.
        """
        self._place_done()
        if not all(store.complete for store in self._stores):
            raise ValueError("not every window of the raster was written")
        if self._cog:
            self._assemble()
        else:
            self._append_directories()

    def _directories(self, bases: list[tuple[int, int]]) -> list[Directory]:
        """Directories of all levels and masks, when tiles and mask tiles start at `bases`."""
        found: list[Directory] = []
        for i, (level, store, (base, mask_base)) in enumerate(zip(self._levels, self._stores, bases, strict=True)):
            size = {tiff.WIDTH: Field.of(4, level.width), tiff.LENGTH: Field.of(4, level.height)}
            own, mask = dict(self._directory), dict(codec.MASK_TAGS)
            if i:
                own = {tag: field for tag, field in own.items() if tag not in _OVERVIEW_TAGS}
                own[tiff.NEW_SUBFILE_TYPE] = Field.of(4, 1)
                mask[tiff.NEW_SUBFILE_TYPE] = Field.of(4, 5)
            found.append({**own, **size, **store.fields(base, big=self._big)})
            if self._masked and self._keep_mask:
                found.append({**mask, **size, **store.mask_fields(mask_base, big=self._big)})
        return found

    def _append_directories(self) -> None:
        """Finish a GeoTIFF: mask tiles and directories go behind the tiles."""
        store, file = self._stores[0], self._files[0]
        masks = store.mask_bytes() if self._masked and self._keep_mask else b""
        file.truncate(store.end)
        file.seek(store.end)
        write_all(file, masks + bytes(-(store.end + len(masks)) % 8))
        start = file.tell()
        write_all(file, tiff.lay_out(self._directories([(_START, store.end)]), start, big=self._big))
        file.seek(0)
        write_all(file, tiff.header(start, big=self._big))

    def _assemble(self) -> None:
        """Finish a COG: directories, then the levels from the smallest on, each with its mask."""
        # Directories stand first and name the places of the tiles behind them: laid out once with places of 0, which
        # have the same length, to know where the tiles begin.
        head = len(tiff.header(0, big=self._big))
        start = head + len(tiff.COG_MARK)
        nowhere = [(0, 0)] * len(self._levels)
        at = start + len(tiff.lay_out(self._directories(nowhere), start, big=self._big))
        bases = list(nowhere)
        masks = [store.mask_bytes() if self._masked and self._keep_mask else b"" for store in self._stores]
        for i in reversed(range(len(self._levels))):
            bases[i] = (at, at + self._stores[i].end)
            at += self._stores[i].end + len(masks[i])
        with self._path.open("wb") as final:
            final.write(tiff.header(start, big=self._big) + tiff.COG_MARK)
            final.write(tiff.lay_out(self._directories(bases), start, big=self._big))
            for i in reversed(range(len(self._levels))):
                self._files[i].truncate(self._stores[i].end)  # a last tile of zeros is a hole not yet there
                self._files[i].seek(0)
                shutil.copyfileobj(self._files[i], final, 1 << 20)
                final.write(masks[i])
