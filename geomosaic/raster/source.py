"""Images read by windows from any thread: values, validity, reduced copies; decoded images kept whole."""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import rasterio.windows
from rasterio.errors import RasterioError

from geomosaic.errors import OutputError, RasterReadError
from geomosaic.geo.grid import Window
from geomosaic.raster.environment import close_all, environment
from geomosaic.raster.info import SourceInfo, describe, inspect, joined, open_raster
from geomosaic.raster.validity import Usable, block_mean, combine, missing_by_value, usable_nodata
from geomosaic.stores.failures import raise_failure
from geomosaic.types import AnyArray, ByteArray, PathLike
from geomosaic.whole_files import absolute

if TYPE_CHECKING:
    from geomosaic.raster.cloud_mask import CloudMask

Pixels = tuple[AnyArray, ByteArray | None]
Seen = Callable[[Window, AnyArray, ByteArray | None], None]


class Calibrated(Protocol):
    """Physical quantity that the values of an image stand for."""

    @property
    def quantity(self) -> str:
        """Its name."""

    @property
    def unit(self) -> str:
        """Its unit."""

    def __call__(self, values: AnyArray, window: Window) -> AnyArray:
        """Quantity (rows, cols, bands), float32, of the values of a window; NaN where there is none."""


class _InMemory:
    """Decoded image in memory.

    Parameters
    ----------
    values : array (rows, cols, bands)
    valid : uint8 array (rows, cols) or None, None where every pixel is valid
    """

    def __init__(self, values: AnyArray, valid: ByteArray | None) -> None:
        self._values, self._valid = values, valid

    def read(self, window: Window) -> Pixels:
        """Copy a window: values (rows, cols, bands), and valid (rows, cols) or None."""
        rows, cols = slice(window.row, window.stop_row), slice(window.col, window.stop_col)
        valid = None if self._valid is None else self._valid[rows, cols].copy()
        return self._values[rows, cols].copy(), valid

    def close(self) -> None:
        """Free the memory."""
        self._values, self._valid = self._values[:0], None


class _OnDisk:
    """A decoded image as raw rows in a temporary folder that is removed on close.

    Parameters
    ----------
    scratch : Path or None, folder for the temporary folder; the system's when None
    shape : tuple, rows, columns, bands
    dtype : dtype, of the samples
    strips : iterable, pixels of full-width strips from the top
    name : str, the image, for errors
    """

    def __init__(
        self,
        scratch: Path | None,
        shape: tuple[int, int, int],
        dtype: np.dtype[np.generic],
        strips: Iterable[Pixels],
        name: str,
    ) -> None:
        self._shape, self._dtype = shape, dtype
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        rows, cols, bands = shape
        self._any_missing = False
        try:
            self._folder = tempfile.TemporaryDirectory(dir=scratch, prefix="geomosaic-")
            with self._path("values").open("wb") as values_file, self._path("valid").open("wb") as valid_file:
                for values, valid in strips:
                    values_file.write(values.data)
                    if valid is None:
                        valid = np.ones(values.shape[:2], dtype=np.uint8)
                    else:
                        self._any_missing = True
                    valid_file.write(valid.data)
        except OSError as error:
            self.close()
            need = rows * cols * (bands * dtype.itemsize + 1)
            raise OutputError(
                f"the decoded copy of this image ({need / 1e6:.0f} MB) cannot be written to the scratch folder "
                f"({error.strerror or error})",
                where=name,
                hint="give a folder with more room (TMPDIR), a larger `memory_limit`, or convert the image to a tiled "
                "GeoTIFF (gdal_translate -co TILED=YES)",
            ) from error
        except BaseException:
            self.close()
            raise

    def _path(self, name: str) -> Path:
        if self._folder is None:
            raise ValueError("the scratch copy is closed")
        return Path(self._folder.name) / name

    # A window is mapped, copied and unmapped, so that resident memory stays at one window whatever the image.
    def read(self, window: Window) -> Pixels:
        """Copy a window: values (rows, cols, bands), and valid (rows, cols) or None."""
        values = self._map("values", self._dtype, self._shape, window)
        if not self._any_missing:
            return values, None
        valid = self._map("valid", np.dtype(np.uint8), (*self._shape[:2], 1), window)[:, :, 0]
        return values, None if valid.all() else np.ascontiguousarray(valid)

    def _map(self, name: str, dtype: np.dtype[np.generic], shape: tuple[int, int, int], window: Window) -> AnyArray:
        row_bytes = shape[1] * shape[2] * dtype.itemsize
        mapped = np.memmap(
            self._path(name),
            dtype=dtype,
            mode="r",
            offset=window.row * row_bytes,
            shape=(window.height, shape[1], shape[2]),
        )
        return np.array(mapped[:, window.col : window.stop_col], order="C", subok=False)

    def close(self) -> None:
        """Remove the scratch folder."""
        if self._folder is not None:
            self._folder.cleanup()
            self._folder = None


__all__ = ["Source", "SourceInfo", "inspect"]

# Full-resolution bytes that are held at once while an image is copied to scratch, and while it is reduced: sums and
# means of a strip take five times its bytes.
_STRIP_BYTES, _REDUCED_BYTES = 16 << 20, 4 << 20


def _reopened(path: str, options: dict[str, Any]) -> Source:
    """Source of a file that another process had open."""
    return Source(path, **options)


class Source:
    """A raster file, read by windows from any number of threads.

    Every thread has a GDAL handle of its own, opened when it first reads. A format that knows no windows (JPEG, PNG,
    compressed strips) is decoded once, on the first read, and kept whole: in memory where it fits `memory_limit`,
    otherwise as raw rows in a scratch folder. Nothing is written next to the image.

    Parameters
    ----------
    path : path, the raster
    nodata : float, optional, value of missing pixels; replaces what the file says
    bands : sequence of int, optional, band numbers from 1 to read, in this order; all but alpha by default
    memory_limit : int, bytes that the source may hold between reads
    scratch : Path, optional, folder for a scratch copy; the system's temporary folder by default
    usable : sequence of (col, row), optional
        Corners of a polygon; pixels whose centre lies outside of it are not valid.
    clouds : CloudMask, optional, pixels under it are not valid
    calibrated : Calibrated, optional, what is read is this quantity

    Raises
    ------
    RasterReadError
        Missing file, no raster, or unsupported sample type.
    InputError
        A band that the file does not have.
    """

    def __init__(
        self,
        path: PathLike,
        *,
        nodata: float | None = None,
        bands: Sequence[int] | None = None,
        memory_limit: int = 512 << 20,
        scratch: Path | None = None,
        usable: Sequence[tuple[float, float]] | None = None,
        clouds: CloudMask | None = None,
        calibrated: Calibrated | None = None,
    ) -> None:
        self._path = str(path)
        self._local = threading.local()
        self._lock = threading.Lock()
        self._handles: list[Any] = []
        self._whole: _InMemory | _OnDisk | None = None
        self._memory_limit = memory_limit
        self._scratch = scratch
        self._opened_with = {
            "nodata": nodata,
            "bands": bands,
            "usable": usable,
            "clouds": clouds,
            "calibrated": calibrated,
        }
        self._usable = None if usable is None else Usable(usable)
        self._clouds, self._calibrated = clouds, calibrated
        with environment(), open_raster(path) as dataset:
            self.info: SourceInfo = describe(dataset, self._path, bands)
            plain = [i for i in dataset.indexes if i != self.info.alpha]
            self.bands: tuple[int, ...] = tuple(plain if bands is None else bands)
            self._block_rows = int(dataset.block_shapes[self.bands[0] - 1][0])
            declared = dataset.nodatavals
            overviews = bool(dataset.overviews(self.bands[0]))
        self.decimates = self.info.direct and not overviews and usable is None and clouds is None and calibrated is None
        """Whether one pixel out of many costs little, see `read_decimated`."""
        self._dtype = np.dtype(self.info.dtype)
        values = [declared[band - 1] if nodata is None else nodata for band in self.bands]
        self._nodata = tuple(usable_nodata(self._dtype, value) for value in values)
        if calibrated is not None:
            self.info = self.info.calibrated(calibrated.quantity, calibrated.unit)

    def __reduce__(self) -> tuple[Any, ...]:
        options = {**self._opened_with, "memory_limit": self._memory_limit, "scratch": self._scratch}
        return _reopened, (absolute(self._path), options)

    def __enter__(self) -> Source:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the handles of all threads and free what is held."""
        with self._lock:
            handles, self._handles = self._handles, []
            self._local = threading.local()
            close_all(handles)
            if self._whole is not None:
                self._whole.close()
                self._whole = None

    @property
    def dtype(self) -> np.dtype[np.generic]:
        """Type of the samples of a full-resolution read."""
        return np.dtype(self.info.dtype)

    def read(self, window: Window, shrink: int = 1, seen: Seen | None = None) -> Pixels:
        """Read a window.

        Parameters
        ----------
        window : Window
            Inside the image, in full-resolution pixels; column and row are multiples of `shrink`.
        shrink : int
            1 reads the pixels; s > 1 gives the means of the valid pixels of s × s blocks, where blocks at the end
            average what exists.
        seen : callable, optional
            See `Seen`.

        Returns
        -------
        values : array (rows, cols, bands)
            Contiguous by pixels or by bands; in the file's type, float32 where shrink > 1; arbitrary where not valid.
        valid : uint8 array (rows, cols) of 1 and 0, or None
            None where every pixel is valid. A block is valid where any pixel of it is.

        Raises
        ------
        RasterReadError
            The data is truncated or damaged.
        """
        image = Window(0, 0, self.info.width, self.info.height)
        if window.empty or window.intersection(image) != window:
            raise ValueError(f"{window} does not lie inside the {image.width} x {image.height} image {self._path}")
        if shrink == 1:
            return self._read_full(window)
        if shrink < 1 or window.col % shrink or window.row % shrink:
            raise ValueError(f"{window} does not start at a multiple of shrink {shrink}")
        return self._read_reduced(window, shrink, seen)

    def read_decimated(
        self, first: tuple[int, int], count: tuple[int, int], step: int
    ) -> tuple[AnyArray, ByteArray | None]:
        """Read one pixel out of many, where the source `decimates`: the others are not even looked for in the file.

        Parameters
        ----------
        first : (col, row), the first pixel
        count : (cols, rows), so many pixels, all inside the image
        step : int, columns and rows from one to the next

        Returns
        -------
        values, valid, as of `read`
        """
        values = np.empty((count[1], count[0], len(self.bands)), dtype=self._dtype)
        valid = np.ones(values.shape[:2], dtype=np.uint8)
        for rows, row, height in _runs(first[1], count[1], step, self.info.height):
            for cols, col, width in _runs(first[0], count[0], step, self.info.width):
                shape = rows.stop - rows.start, cols.stop - cols.start
                values[rows, cols], seen = self._decode(Window(col, row, width, height), shape)
                if seen is not None:
                    valid[rows, cols] = seen
        return values, None if valid.all() else valid

    def _read_reduced(self, window: Window, shrink: int, seen: Seen | None) -> Pixels:
        row_bytes = window.width * len(self.bands) * self._dtype.itemsize
        rows = shrink * max(1, _REDUCED_BYTES // (row_bytes * shrink))
        shape = (-(-window.height // shrink), -(-window.width // shrink))
        means = np.empty((*shape, len(self.bands)), dtype=np.float32)
        valid: ByteArray | None = None
        for strip in window.split(window.width, rows):
            at = (strip.row - window.row) // shrink
            pixels = self._read_full(strip)
            if seen is not None:
                seen(strip, *pixels)
            part, part_valid = block_mean(*pixels, shrink)
            means[at : at + len(part)] = part
            if part_valid is not None:
                if valid is None:
                    valid = np.ones(shape, dtype=np.uint8)
                valid[at : at + len(part)] = part_valid
        return means, valid

    def _read_full(self, window: Window) -> tuple[AnyArray, ByteArray | None]:
        values, valid = self._read_stored(window)
        if self._calibrated is None:
            return values, valid
        found = self._calibrated(values, window)
        return found, combine(missing_by_value(found, (None,) * found.shape[2]), valid)

    def _read_stored(self, window: Window) -> tuple[AnyArray, ByteArray | None]:
        """Read a window of what the file holds."""
        if self.info.windowed:
            return self._decode(window)
        with self._lock:
            if self._whole is None:
                self._whole = self._decode_whole()
            whole = self._whole
        return whole.read(window)

    def _decode_whole(self) -> _InMemory | _OnDisk:
        """Decode an image that knows no windows, once."""
        width, height, bands = self.info.width, self.info.height, len(self.bands)
        row_bytes = width * bands * self._dtype.itemsize
        # Never all at once: GDAL's short cut for whole PNGs does not notice a truncated file.
        rows = min(_STRIP_BYTES // row_bytes, height // 2) // self._block_rows * self._block_rows
        strips = Window(0, 0, width, height).split(width, max(self._block_rows, rows))
        if height * (row_bytes + width) > self._memory_limit:
            return _OnDisk(self._scratch, (height, width, bands), self._dtype, map(self._decode, strips), self._path)
        values = np.empty((height, width, bands), dtype=self._dtype)
        valid: ByteArray | None = None
        for strip in strips:
            values[strip.row : strip.stop_row], part = self._decode(strip)
            if part is not None:
                valid = np.ones((height, width), dtype=np.uint8) if valid is None else valid
                valid[strip.row : strip.stop_row] = part
        return _InMemory(values, valid)

    def _decode(self, window: Window, shape: tuple[int, int] | None = None) -> tuple[AnyArray, ByteArray | None]:
        """Read a window through this thread's GDAL handle, or so many rows and columns of its pixels."""
        shape = shape or (window.height, window.width)
        values = np.empty((*shape, len(self.bands)), dtype=self._dtype)
        area = rasterio.windows.Window(window.col, window.row, window.width, window.height)
        mask: AnyArray | None = None
        try:
            with environment():
                dataset = self._dataset()
                # GDAL writes through the strides, so pixels come out interleaved without a second copy. Files with
                # INTERLEAVE=BAND would be read by bands in 80 % of the time, and sampled in 155 %.
                dataset.read(list(self.bands), window=area, out=np.moveaxis(values, -1, 0))
                if self.info.alpha is not None:
                    mask = dataset.read(self.info.alpha, window=area, out_shape=shape)
                elif self.info.mask_band:
                    mask = dataset.read_masks(self.bands[0], window=area, out_shape=shape)
        except (RasterioError, OSError) as error:
            raise_failure()
            cause = str(error.__cause__ or error).strip().splitlines()
            raise RasterReadError(
                f"columns {window.col} to {window.stop_col}, rows {window.row} to {window.stop_row} cannot be read "
                f"({cause[0] if cause else error}); the file is truncated or damaged",
                where=self._path,
                hint="copy the file again from where it came, or leave the image out",
            ) from error
        if self._usable is not None:
            mask = self._usable.mask(window, mask)
        if self._clouds is not None:
            with environment():
                clear = self._clouds.clear(self._cloud_dataset(self._clouds), window, self.info.size)
            mask = clear if mask is None else np.where(clear > 0, mask, 0)
        return values, combine(missing_by_value(values, self._nodata), mask)

    def _dataset(self) -> Any:
        """Open dataset of this thread."""
        dataset = getattr(self._local, "dataset", None)
        if dataset is None:
            dataset = open_raster(self._path, direct=self.info.direct)
            self._local.dataset = dataset
            self._handles.append(dataset)
        return dataset

    def _cloud_dataset(self, clouds: CloudMask) -> Any:
        """Open cloud mask of this thread."""
        dataset = getattr(self._local, "clouds", None)
        if dataset is None:
            dataset = self._local.clouds = open_raster(clouds.path)
            self._handles.append(dataset)
        return dataset


class UnevenStackError(Exception):
    """Files of a stack miss different pixels of a window: they cannot share one mask."""


class Stack(Source):
    """Rasters of one size, read as the bands of one.

    Parameters
    ----------
    sources : sequence of Source, in the order of their bands; closed with the stack

    Raises
    ------
    UnevenStackError
        On reading, where they miss different pixels.
    """

    def __init__(self, sources: Sequence[Source]) -> None:
        self._sources = tuple(sources)
        self.info = joined([source.info for source in sources])
        self.bands = tuple(range(1, self.info.bands + 1))
        self.decimates = False
        self._path, self._dtype = self.info.path, np.dtype(self.info.dtype)

    def close(self) -> None:
        """Close all of them."""
        for source in self._sources:
            source.close()

    def _read_full(self, window: Window) -> Pixels:
        parts = [source.read(window) for source in self._sources]
        masks = [valid for _, valid in parts if valid is not None]
        if len(masks) not in (0, len(parts)) or any(not np.array_equal(valid, masks[0]) for valid in masks):
            raise UnevenStackError
        planes = np.concatenate([np.moveaxis(values, -1, 0) for values, _ in parts])
        return np.moveaxis(planes, 0, -1), masks[0] if masks else None


def _runs(first: int, count: int, step: int, size: int) -> Iterator[tuple[slice, int, int]]:
    """Cut decimated pixels along an axis into runs: which they are, and the start and length of a window for them."""
    # GDAL takes the middle of each `step` pixels; the first and the last of them may lie too near to the
    # image's edge for that, and are read on their own.
    before = first - step // 2
    start, stop = int(before < 0), count - int(before + count * step > size)
    for alone in range(start):
        yield slice(alone, alone + 1), first, 1
    if start < stop:
        yield slice(start, stop), before + start * step, (stop - start) * step
    for alone in range(max(start, stop), count):
        yield slice(alone, alone + 1), first + alone * step, 1
