"""Rasters for the screen: reduced windows of any raster, and the stretch of its samples to 8 bits.

Where a raster has overviews, they are read. Where it has none, a reduced copy is made in the background: until a part
of it is there, samples from a few places stand for it.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from rasterio.enums import Resampling
from rasterio.errors import RasterioError

from geomosaic.errors import RasterReadError
from geomosaic.geo.grid import Window
from geomosaic.raster.environment import close_all, environment
from geomosaic.raster.info import SourceInfo, inspect, open_raster
from geomosaic.raster.source import Pixels, Source
from geomosaic.raster.validity import block_mean, combine, missing_by_value, usable_nodata
from geomosaic.types import AnyArray, ByteArray

# Pixels along the longer side up to which any level is quickly made of the pixels themselves, and of a reduced copy.
_SMALL, _REDUCED = 2048, 4096
# The least reduction of a copy: less of it is read from the pixels.
_LEAST = 8
# Bytes of a strip that is reduced at once, and of a decoded image that is held in memory.
_STRIP, _HELD = 8 << 20, 4 << 20
# Samples along each side that stand for a raster before its reduced copy, pixels along the side of each, and pixels
# along the longer side of the overview that the stretch is taken from.
_SAMPLES, _SAMPLE, _STRETCHED = 24, 4, 512
# Share of a raster after which its stretch is taken anew.
_AGAIN = 0.25


def _shown_bands(info: SourceInfo) -> tuple[int, ...]:
    """Numbers, from 1, of the bands that a screen shows: the first three, or the first one; none is alpha."""
    plain = [number for number in range(1, info.bands + 2) if number != info.alpha][: info.bands]
    return tuple(plain[: 3 if info.bands >= 3 else 1])


class _Coloured(Source):
    """Raster whose numbers are read as the colours of its palette."""

    def __init__(self, path: Path, palette: ByteArray) -> None:
        super().__init__(path, bands=(1,), memory_limit=_HELD)
        self._palette = palette

    def _read_full(self, window: Window) -> Pixels:
        values, valid = super()._read_full(window)
        return self._palette[values[..., 0]], valid


@dataclass
class _Reduced:
    """Reduced copy of a raster as far as it is made: block means, and samples elsewhere."""

    shrink: int
    values: AnyArray
    valid: ByteArray
    rows: int = 0
    finished: bool = False
    failure: RasterReadError | None = None
    lock: threading.Lock = field(default_factory=threading.Lock)


class DisplayRaster:
    """Raster read by reduced windows from any number of threads.

    Parameters
    ----------
    path : Path

    Raises
    ------
    RasterReadError
        No raster that can be read.

    Attributes
    ----------
    info : SourceInfo
        Of the shown bands.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        every = inspect(path)
        self._palette = _palette(path) if every.bands == 1 and "palette" in every.colors else None
        bands = _shown_bands(every)
        self.info = inspect(path, bands)
        self._source = Source(path, bands=bands, memory_limit=_HELD) if self._palette is None else _Coloured(
            path, self._palette
        )  # fmt: skip
        with environment(), open_raster(path) as dataset:
            levels = dataset.overviews(bands[0])
        large = max(self.info.size) > _SMALL
        self._overviews = self.info.windowed and bool(levels)
        self._handles = threading.local()
        self._opened: list[Any] = []
        self._closing = threading.Event()
        self._lock = threading.Lock()
        self._limits: tuple[float, float] | None = None
        self._limits_of = 0.0  # share of the raster that they were taken of
        self._reduced: _Reduced | None = None
        if large and not self._overviews:
            shrink = _LEAST
            while max(self.info.size) / shrink > _REDUCED:
                shrink *= 2
            shape = (-(-self.info.height // shrink), -(-self.info.width // shrink))
            count = 3 if self._palette is not None else self.info.bands
            dtype = np.uint8 if self._palette is not None else np.dtype(self.info.dtype)
            self._reduced = _Reduced(shrink, np.zeros((*shape, count), dtype), np.zeros(shape, np.uint8))
            self._sample(self._reduced)
            self._maker = threading.Thread(target=self._reduce, args=(self._reduced,), daemon=True)
            self._maker.start()

    def close(self) -> None:
        """Stop what runs in the background and close the file."""
        self._closing.set()
        if self._reduced is not None:
            self._maker.join()
        self._source.close()
        close_all(self._opened)

    @property
    def ready(self) -> float:
        """Share of the raster, from 0 to 1, whose coarse view is made of all its pixels."""
        reduced = self._reduced
        return 1.0 if reduced is None or reduced.finished else reduced.rows / reduced.values.shape[0]

    def read(self, window: Window, shrink: int) -> Pixels:
        """Means of the pixels of a window.

        Parameters
        ----------
        window : Window
            Inside the image, in its pixels; its corner is a multiple of `shrink`.
        shrink : int
            A power of two: pixels along a side of what one mean stands for.

        Returns
        -------
        values : array (rows, cols, bands)
        valid : uint8 array (rows, cols) or None
            None where every pixel is valid.

        Raises
        ------
        RasterReadError
            The data is truncated or damaged.
        """
        if self._overviews and shrink > 1:
            return self._from_overviews(window, shrink)
        reduced = self._reduced
        if reduced is None or shrink < reduced.shrink:
            return self._source.read(window, shrink)
        if reduced.failure is not None:
            raise reduced.failure
        by = reduced.shrink
        rows = slice(window.row // by, -(-window.stop_row // by))
        cols = slice(window.col // by, -(-window.stop_col // by))
        with reduced.lock:
            values, valid = reduced.values[rows, cols].copy(), reduced.valid[rows, cols].copy()
        return block_mean(values, None if valid.all() else valid, shrink // by) if shrink > by else (values, valid)

    def limits(self) -> tuple[float, float] | None:
        """Values that the screen shows as black and as white: the 2nd and 98th percentile; None for 8 bits as they are.

        Returns
        -------
        tuple of float or None
        """
        if self.info.dtype == "uint8" or self._palette is not None:
            return None
        # While a reduced copy grows, one thread takes them anew a few times; the others go on with those before.
        share = self.ready
        due = share - self._limits_of >= _AGAIN or share >= 1.0 > self._limits_of
        if (self._limits is None or due) and self._lock.acquire(blocking=self._limits is None):
            try:
                if self._limits is None or share > self._limits_of:
                    self._limits, self._limits_of = self._percentiles(), share
            finally:
                self._lock.release()
        return self._limits

    def _percentiles(self) -> tuple[float, float]:
        if self._reduced is not None:
            step = -(-max(self._reduced.values.shape[:2]) // _STRETCHED)
            with self._reduced.lock:
                values, valid = (part[::step, ::step].copy() for part in (self._reduced.values, self._reduced.valid))
        else:
            shrink = 1
            while max(self.info.size) / shrink > _STRETCHED:
                shrink *= 2
            values, known = self.read(Window(0, 0, *self.info.size), shrink)
            valid = np.ones(values.shape[:2], np.uint8) if known is None else known
        shown = values[valid != 0]
        if not shown.size:
            return 0.0, 1.0
        low, high = np.percentile(shown, (2.0, 98.0))
        return float(low), float(max(high, low + 1e-12))

    def _from_overviews(self, window: Window, shrink: int) -> Pixels:
        """Means through the overviews of the file."""
        shape = -(-window.height // shrink), -(-window.width // shrink)
        bands = list(self._source.bands)
        values = np.empty((*shape, len(bands)), dtype=self.info.dtype)
        at = ((window.row, window.stop_row), (window.col, window.stop_col))
        how = Resampling.average if self._palette is None else Resampling.nearest
        mask: AnyArray | None = None
        try:
            with environment():
                dataset = self._dataset()
                dataset.read(bands, window=at, out=np.moveaxis(values, -1, 0), resampling=how)
                if self.info.alpha is not None:
                    mask = dataset.read(self.info.alpha, window=at, out_shape=shape)
                elif self.info.mask_band:
                    mask = dataset.read_masks(bands[0], window=at, out_shape=shape)
        except (RasterioError, OSError) as error:
            raise self._damaged(error) from error
        nodata = [usable_nodata(values.dtype, value) for value in self.info.nodatas]
        valid = combine(missing_by_value(values, nodata), mask)
        return (values if self._palette is None else self._palette[values[..., 0]]), valid

    def _dataset(self) -> Any:
        """Open dataset of this thread."""
        dataset = getattr(self._handles, "dataset", None)
        if dataset is None:
            dataset = self._handles.dataset = open_raster(self._path)
            self._opened.append(dataset)
        return dataset

    def _sample(self, reduced: _Reduced) -> None:
        """Samples of a few places in the reduced copy, where windows cost little."""
        if not self.info.windowed:
            return
        rows, cols = (np.linspace(0, n, _SAMPLES + 1).astype(int) for n in reduced.values.shape[:2])
        for top, below in pairwise(rows):
            for left, right in pairwise(cols):
                row, col = ((a + b) // 2 * reduced.shrink for a, b in ((top, below), (left, right)))
                place = Window(int(col), int(row), _SAMPLE, _SAMPLE).intersection(Window(0, 0, *self.info.size))
                values, valid = block_mean(*self._source.read(place), _SAMPLE)
                reduced.values[top:below, left:right] = np.rint(values[:1, :1])
                reduced.valid[top:below, left:right] = 1 if valid is None else valid[:1, :1]

    def _reduce(self, reduced: _Reduced) -> None:
        """Make the reduced copy, from the top."""
        width, height = self.info.size
        row_bytes = width * self.info.pixel_bytes * reduced.shrink
        rows = max(1, _STRIP // row_bytes) * reduced.shrink
        whole = np.issubdtype(reduced.values.dtype, np.integer)
        try:
            for strip in Window(0, 0, width, height).split(width, rows):
                if self._closing.is_set():
                    return
                values, valid = self._source.read(strip, reduced.shrink)
                at = slice(strip.row // reduced.shrink, strip.row // reduced.shrink + len(values))
                with reduced.lock:
                    reduced.values[at] = np.rint(np.nan_to_num(values)) if whole else values
                    reduced.valid[at] = 1 if valid is None else valid
                    reduced.rows = at.stop
            reduced.finished = True
        except RasterReadError as error:
            reduced.failure = error
            reduced.finished = True

    def _damaged(self, error: Exception) -> RasterReadError:
        return RasterReadError(
            f"a part of the raster cannot be read ({error.__cause__ or error})",
            where=str(self._path),
            hint="copy the file again from where it came",
        )


def _palette(path: Path) -> ByteArray:
    """Colours (256 or 65536, 3) of the numbers of a raster."""
    with environment(), open_raster(path) as dataset:
        size = 256 if dataset.dtypes[0] == "uint8" else 65536
        colours = np.zeros((size, 3), dtype=np.uint8)
        for number, colour in dataset.colormap(1).items():
            if number < size:
                colours[number] = colour[:3]
    return colours


def eight_bits(values: AnyArray, limits: tuple[float, float] | None) -> ByteArray:
    """Samples between two limits as grey values from 0 to 255.

    Parameters
    ----------
    values : array (rows, cols, bands)
    limits : tuple of float or None
        Values of black and of white; None where samples are grey values already.

    Returns
    -------
    uint8 array (rows, cols, bands)
    """
    grey = values.astype(np.float32, copy=False)
    if limits is not None:
        grey = (grey - np.float32(limits[0])) * np.float32(255.0 / (limits[1] - limits[0]))
    elif values.dtype == np.uint8:
        return values
    levels: ByteArray = np.clip(np.nan_to_num(grey) + 0.5, 0, 255).astype(np.uint8)
    return levels
