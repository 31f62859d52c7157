"""Rasters written window by window, whole under their name; the result of a call that has written one."""

from __future__ import annotations

import errno
import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from rasterio.errors import RasterioError

from geomosaic.errors import InputError, OutputError
from geomosaic.geo.grid import Grid, Window
from geomosaic.raster.cog.codec import OVERVIEWS, RasterMetadata, Samples
from geomosaic.raster.cog.tiles import WindowTiler, WindowTiles
from geomosaic.raster.cog.writer import TileFile
from geomosaic.raster.creation_options import check_nodata, check_type, creation_options
from geomosaic.raster.files import check_output, size_text
from geomosaic.raster.source import Source
from geomosaic.stores.path import to_path
from geomosaic.types import AnyArray, ByteArray, PathLike
from geomosaic.whole_files import partial, put_in_place, remove, workplace


class RasterProduct:
    """Result that is a raster file with a grid; base of `OrthoResult` and `MosaicResult`."""

    path: Path
    grid: Grid

    def read(self, window: Window | None = None, bands: Sequence[int] | None = None) -> np.ma.MaskedArray[Any, Any]:
        """Pixels of the file.

        Parameters
        ----------
        window : Window, optional
            In pixels of `grid`, cut to it; the whole raster unless given.
        bands : sequence of int, optional
            Counted from 1, in this order; all but alpha unless given.

        Returns
        -------
        masked array (bands, rows, cols)
            In the file's sample type and rasterio's order of axes; masked where the raster shows nothing.

        Raises
        ------
        RasterReadError
            The file is gone or damaged.
        InputError
            The window lies outside of the grid, or there is no such band.
        """
        part = self.grid.window if window is None else window.intersection(self.grid.window)
        if part.empty:
            raise InputError(
                f"{window} lies outside of the raster of {self.grid.width} x {self.grid.height} pixels",
                where="window",
                hint="give a window within the raster",
            )
        with Source(self.path, bands=bands) as source:
            values, valid = source.read(part)
        array = np.moveaxis(values, 2, 0)
        hidden = np.zeros(array.shape, dtype=np.bool_) if valid is None else np.broadcast_to(valid == 0, array.shape)
        return np.ma.MaskedArray(array, mask=hidden)

    def to_xarray(self, **options: Any) -> Any:
        """`xarray.DataArray` of the file, opened lazily by rioxarray.

        Parameters
        ----------
        **options
            Of `rioxarray.open_rasterio`, such as `chunks`; `masked=True` unless given otherwise.

        Raises
        ------
        InputError
            rioxarray is not installed.
        """
        try:
            import rioxarray
        except ImportError:
            raise InputError(
                "to_xarray needs rioxarray, which is not installed", hint="pip install rioxarray"
            ) from None
        return rioxarray.open_rasterio(self.path, **{"masked": True, **options})

    def __repr__(self) -> str:
        return f"{type(self).__name__}('{self.path}', {self.grid.label})"


_SIDECARS = (".aux.xml", ".ovr", ".msk")


class RasterSink:
    """A raster under construction. A context manager: without `finish`, nothing of it stays.

    The bytes of the file depend on the pixels and the options only, not on the width of the windows or on threads.

    Parameters
    ----------
    path : path, final name. Until it is whole, the file is called `.NAME.partial-HOST-PID` in the same folder.
    grid : Grid, place and size
    samples : Samples, bands, type, nodata and mask
    driver : str, 'COG' (with overviews) or 'GTiff' (without, fastest)
    creation : mapping, optional
        GDAL creation options of the driver; they win over the defaults (deflate level 1, predictor).
    overwrite : bool, replace an existing file
    threads : int, for the compression of overviews; other tiles are made by those who call `tiles`
    metadata : RasterMetadata, optional, names, scales and units of the bands, tags; whether values are labels

    Raises
    ------
    OutputExistsError
        The file exists and `overwrite` is false.
    InputError
        The folder does not exist; an option or a nodata value that cannot be had.
    OutputError
        The disk is full or the folder cannot be written to.
    """

    def __init__(
        self,
        path: PathLike,
        grid: Grid,
        samples: Samples,
        *,
        driver: str = "COG",
        creation: Mapping[str, str] | None = None,
        overwrite: bool = False,
        threads: int = 1,
        metadata: RasterMetadata | None = None,
    ) -> None:
        self.path = to_path(path)
        self._dtype = check_type(samples.dtype, str(path))
        check_output(self.path, overwrite=overwrite, geotiff=True)
        check_nodata(samples.dtype, samples.nodata, str(path))
        metadata = metadata or RasterMetadata()
        overviews = "nearest" if metadata.categorical else metadata.overviews
        made = creation_options(driver, samples.bands, self._dtype, creation or {}, overviews, str(path))
        if made.overviews == "rms":
            metadata = replace(metadata, tags={**metadata.tags, OVERVIEWS: "RMS"})
        self._raw = made.gtiff["COMPRESS"] == "NONE"
        self._bytes = grid.width * grid.height * samples.bands * self._dtype.itemsize
        self._check_space()
        # The name of the unfinished file: nothing appears under the final name before the file is whole.
        self._partial = self._name()
        try:
            self._tiles = TileFile(
                self._partial,
                grid,
                samples,
                made.gtiff,
                metadata,
                overviews=made.overviews,
                cog=driver == "COG",
                threads=threads,
            )
        except OSError as error:
            self._remove()
            raise self._failed(error) from error
        except BaseException:
            self._remove()
            raise

    def __enter__(self) -> RasterSink:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._tiles.close()
        self._remove()

    def write(self, window: Window, values: AnyArray, valid: ByteArray | None = None, *, blank: bool = False) -> None:
        """Addition of a window in one call: `add` of its `tiles`, which has the parameters."""
        self.add(self.tiles(window, values, valid, blank=blank))

    def tiles(
        self, window: Window, values: AnyArray, valid: ByteArray | None = None, *, blank: bool = False
    ) -> WindowTiles:
        """Tiles of a window, made ready for `add`: filled, compressed and halved; to be called from any thread.

        Parameters
        ----------
        window : Window, starts at multiples of 512 pixels and ends at such or at the image's edge
        values : array (rows, cols, bands)
            Of the raster's type; what stands in invalid pixels does not matter. Tiles may be parts of it: neither it
            nor `valid` may change afterwards.
        valid : uint8 array (rows, cols) of 1 and 0, optional, all are valid without it
        blank : bool
            Promise that invalid pixels, and no others, hold nodata already (zero where there is none); saves a pass.

        Raises
        ------
        OutputError
            GDAL cannot compress it.
        """
        return self.tiler.tiles(window, values, valid, blank=blank)

    @property
    def tiler(self) -> WindowTiler:
        """What makes the tiles of windows apart from the file, in any process."""
        return self._tiles.tiler

    def empty(self, window: Window) -> WindowTiles:
        """Tiles of a window without a valid pixel; windows as in `tiles`."""
        return self.tiler.empty(window)

    def add(self, tiles: WindowTiles) -> None:
        """Addition of the tiles of a window; to be called from one thread, windows row by row, each once.

        Parameters
        ----------
        tiles : WindowTiles

        Raises
        ------
        OutputError
            The disk is full.
        """
        with self._writing():
            self._tiles.add(tiles)

    @contextmanager
    def _writing(self, *failures: type[Exception]) -> Iterator[None]:
        """Context in which failures of writing close the file and become `OutputError`."""
        try:
            yield
        except (OSError, RasterioError, *failures) as error:
            self._tiles.close()
            raise self._failed(error) from error

    def reuse_tiles_of(self, earlier: Path) -> bool:
        """Take what is kept from an earlier file from now on, which may be the one that this one replaces.

        Returns
        -------
        bool, whether its tiles are of the same form; where not, nothing can be kept
        """
        return self._tiles.reuse_tiles_of(earlier)

    def keep(self, window: Window) -> None:
        """Take a window from the earlier file, to the byte; windows as in `tiles`.

        Raises
        ------
        OutputError
            The disk is full, or the earlier file is damaged.
        """
        with self._writing(ValueError):  # a damaged tile
            self._tiles.keep(window)

    def finish(self) -> Path:
        """Complete the file and give it its final name.

        Returns
        -------
        Path, the final name

        Raises
        ------
        OutputError
            The disk is full.
        """
        try:
            with self._writing(OverflowError):
                self._tiles.finish()
                self._tiles.close()
                # GDAL would take statistics, overviews and masks of the old pixels for those of the new ones.
                for suffix in _SIDECARS:  # of the file that is replaced
                    self.path.with_name(self.path.name + suffix).unlink(missing_ok=True)
                put_in_place(self._partial, self.path)
        finally:
            self._tiles.close()
            self._remove()
        return self.path

    def _check_space(self) -> None:
        """Refuse early what cannot fit; compressed sizes are not known before."""
        if not self._raw:
            return
        free = shutil.disk_usage(workplace(self.path)).free
        if self._bytes > free:
            raise OutputError(
                f"the raster needs {size_text(self._bytes)}, {size_text(free)} are free in {workplace(self.path)}",
                where=str(self.path),
                hint="free some space, write to another disk, or leave out COMPRESS=NONE",
            )

    def _failed(self, error: Exception) -> OutputError:
        """Remove what was written, so that the free space named is what there is for another try."""
        self._remove()
        free = shutil.disk_usage(workplace(self.path)).free
        cause = error.__cause__ or error
        reason = getattr(cause, "strerror", None) or str(cause)
        if getattr(cause, "errno", None) in (errno.EACCES, errno.EPERM, errno.EROFS):
            hint = "check the rights of the folder, or write to another one"
            return OutputError(f"writing failed ({reason})", where=str(self.path), hint=hint)
        return OutputError(
            f"writing failed ({reason}); uncompressed the raster has {size_text(self._bytes)}, {size_text(free)} are "
            f"free in {workplace(self.path).resolve()}",
            where=str(self.path),
            hint="free some space, write to another disk, or choose a stronger compression (`creation`: COMPRESS=...)",
        )

    def _name(self) -> Path:
        try:
            return partial(self.path)
        except OSError as error:
            raise OutputError(
                f"the folder cannot be read ({error.strerror})", where=str(self.path), hint="check its rights"
            ) from error

    def _remove(self) -> None:
        remove(self._partial)
