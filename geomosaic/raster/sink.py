"""Rasters written window by window: GeoTIFF and cloud-optimised GeoTIFF, whole under their final name or not at all."""

from __future__ import annotations

import os
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType

import numpy as np
import rasterio.shutil
from rasterio.errors import RasterioError

from geomosaic.errors import InputError, OutputError, OutputExistsError
from geomosaic.geo.grid import Grid, Window
from geomosaic.raster.codec import BLOCK
from geomosaic.raster.environment import environment
from geomosaic.raster.info import DTYPES
from geomosaic.raster.tiff import is_whole
from geomosaic.raster.tilefile import TileFile
from geomosaic.types import AnyArray, ByteArray, PathLike

DRIVERS = ("COG", "GTiff")
# Deflate level 1 is 4 times as fast as GDAL's level 6 for 5 % more bytes, and every TIFF reader knows it.
_GTIFF_DEFAULTS = {"COMPRESS": "DEFLATE", "ZLEVEL": "1", "BIGTIFF": "IF_SAFER"}
_COG_DEFAULTS = {"COMPRESS": "DEFLATE", "LEVEL": "1", "BIGTIFF": "IF_SAFER", "BLOCKSIZE": str(BLOCK)}
_PREDICTED = ("DEFLATE", "ZSTD", "LZW")
# GTiff spellings that people type for COGs too.
_COG_NAMES = {"ZLEVEL": "LEVEL", "ZSTD_LEVEL": "LEVEL", "JPEG_QUALITY": "QUALITY", "WEBP_LEVEL": "QUALITY"}
_COG_PREDICTORS = {"1": "NO", "2": "STANDARD", "3": "FLOATING_POINT"}
# How the file is cut is this program's business; other values than its own cannot be had.
_FIXED = {"TILED": ("YES",), "INTERLEAVE": ("PIXEL",), "BLOCKXSIZE": (str(BLOCK),), "BLOCKYSIZE": (str(BLOCK),)}
_SIDECARS = (".aux.xml", ".ovr", ".msk")


class RasterSink:
    """A raster under construction. A context manager: without `finish`, nothing of it stays.

    The bytes of the file depend on the pixels and the options only, not on the width of the windows or on threads.

    Parameters
    ----------
    path : path
        Final name. Until it is whole, the file is called `.NAME.partial-PID` in the same folder.
    grid : Grid
        Place and size.
    bands : int
        Number of bands.
    dtype : str
        NumPy name of the sample type.
    nodata : float, optional
        Invalid pixels get this value; without it an internal mask says which pixels are valid.
    driver : str
        'COG' (with overviews) or 'GTiff' (without, fastest).
    creation : mapping, optional
        GDAL creation options of the driver; they win over the defaults (deflate level 1, predictor).
    overwrite : bool
        Replace an existing file.
    threads : int
        For compression.
    descriptions : sequence of str, optional
        Per band.
    tags : mapping, optional
        Metadata of the file.
    mask : bool
        Write the internal mask (left out where every pixel is valid).
    photometric : str, optional
        'RGB' or 'MINISBLACK'; by default RGB for three bands of uint8.
    overviews : str
        How COG overviews are resampled: 'average', or 'nearest' for labels.

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
        bands: int,
        dtype: str,
        *,
        nodata: float | None = None,
        driver: str = "COG",
        creation: Mapping[str, str] | None = None,
        overwrite: bool = False,
        threads: int = 1,
        descriptions: Sequence[str | None] = (),
        tags: Mapping[str, str] | None = None,
        mask: bool = True,
        photometric: str | None = None,
        overviews: str = "average",
    ) -> None:
        self.path = Path(path)
        self._grid, self._bands, self._dtype, self._driver = grid, bands, np.dtype(dtype), driver
        self._threads, self._overviews = threads, overviews
        check_output(self.path, overwrite=overwrite)
        _check_type(dtype, nodata, str(path))
        self._options = creation_options(driver, self._dtype, creation or {}, str(path))
        options = dict(self._options)
        if driver == "COG":  # GDAL makes the final file from this one
            options = {"COMPRESS": "ZSTD", "ZSTD_LEVEL": "1", "BIGTIFF": "IF_SAFER"}
        if options["COMPRESS"] == "NONE":
            options.pop("PREDICTOR", None)
        options.setdefault("PHOTOMETRIC", photometric or _photometric(bands, self._dtype))
        self._bytes = grid.width * grid.height * bands * self._dtype.itemsize
        self._check_space()
        self._partial = self.path.with_name(f".{self.path.name}.partial-{os.getpid()}")
        try:
            self._tiles = TileFile(
                self._partial,
                grid,
                bands,
                dtype,
                options,
                nodata=nodata,
                descriptions=descriptions,
                tags=tags,
                mask=mask,
                threads=threads,
                sparse=driver == "COG",
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

    def write(self, window: Window, values: AnyArray, valid: ByteArray | None = None) -> None:
        """Write a window; call from one thread, windows row by row, each once.

        Parameters
        ----------
        window : Window
            Starts at multiples of 512 pixels and ends at such or at the image's edge.
        values : array (rows, cols, bands)
            Of the raster's type; what stands in invalid pixels does not matter.
        valid : uint8 array (rows, cols) of 1 and 0, optional
            All are valid without it.

        Raises
        ------
        OutputError
            The disk is full.
        """
        if window.col % BLOCK or window.row % BLOCK or window.intersection(self._grid.window) != window:
            raise ValueError(f"{window} does not start on a block of {BLOCK} or leaves the raster")
        if any(
            stop % BLOCK and stop != end
            for stop, end in ((window.stop_col, self._grid.width), (window.stop_row, self._grid.height))
        ):
            raise ValueError(f"{window} ends within a block of {BLOCK}")
        if values.shape != (window.height, window.width, self._bands) or values.dtype != self._dtype:
            raise ValueError(f"{values.dtype} values of shape {values.shape} do not fill {window} of {self.path}")
        try:
            self._tiles.write(window, values, valid)
        except (OSError, RasterioError) as error:
            raise self._failed(error) from error

    def finish(self) -> Path:
        """Complete the file and give it its final name.

        Returns
        -------
        Path
            The final name.

        Raises
        ------
        OutputError
            The disk is full.
        """
        try:
            self._tiles.finish()
            self._tiles.close()
            whole = self._partial if self._driver == "GTiff" else self._to_cog()
            _sync(whole)
            for suffix in _SIDECARS:  # of the file that is replaced
                self.path.with_name(self.path.name + suffix).unlink(missing_ok=True)
            whole.replace(self.path)
            _sync(self.path.parent)
        except (OSError, OverflowError, RasterioError) as error:
            raise self._failed(error) from error
        finally:
            self._tiles.close()
            self._remove()
        return self.path

    def _to_cog(self) -> Path:
        """Let GDAL add overviews and order the file for reading over a network."""
        target = self._partial.with_name(self._partial.name + ".tif")
        with environment():
            rasterio.shutil.copy(
                str(self._partial),
                str(target),
                driver="COG",
                NUM_THREADS=str(self._threads),
                OVERVIEW_RESAMPLING=self._overviews.upper(),
                **self._options,
            )
        # GDAL may notice a full disk only as it closes the file, and then tells nobody.
        if not is_whole(target):
            raise OSError("the file could not be written to its end")
        return target

    def _check_space(self) -> None:
        """Refuse early what cannot fit; compressed sizes are not known before."""
        if self._options.get("COMPRESS") != "NONE":
            return
        free = shutil.disk_usage(self.path.parent).free
        if self._bytes > free:
            raise OutputError(
                f"the raster needs {_size(self._bytes)}, {_size(free)} are free in {self.path.parent}",
                where=str(self.path),
                mend="free some space, write to another disk, or leave out COMPRESS=NONE",
            )

    def _failed(self, error: Exception) -> OutputError:
        free = shutil.disk_usage(self.path.parent).free
        cause = error.__cause__ or error
        reason = getattr(cause, "strerror", None) or str(cause)
        return OutputError(
            f"writing failed ({reason}); uncompressed the raster has {_size(self._bytes)}, {_size(free)} are free in "
            f"{self.path.parent.resolve()}",
            where=str(self.path),
            mend="free some space, write to another disk, or choose a stronger compression (--co COMPRESS=...)",
        )

    def _remove(self) -> None:
        for file in self.path.parent.glob(f"{_literal(self._partial.name)}*"):
            file.unlink(missing_ok=True)


def check_output(path: Path, *, overwrite: bool) -> None:
    """Refuse a final name that is taken, or whose folder does not exist.

    Raises
    ------
    OutputExistsError, InputError
    """
    if path.is_dir():
        raise InputError("the output is a folder", where=str(path), mend="name a file")
    if not path.parent.is_dir():
        raise InputError("the folder of the output does not exist", where=str(path), mend="make it, or check the path")
    if path.exists() and not overwrite:
        raise OutputExistsError("the output exists", where=str(path), mend="choose another name, or give --overwrite")


def creation_options(driver: str, dtype: np.dtype[np.generic], given: Mapping[str, str], where: str) -> dict[str, str]:
    """Join the defaults of a driver and the options of the user, who wins.

    Raises
    ------
    InputError
        An unknown driver, or a layout that cannot be had.
    """
    if driver not in DRIVERS:
        raise InputError(f"rasters are not written as '{driver}'", where=where, mend=f"choose {' or '.join(DRIVERS)}")
    user = {key.upper(): str(value) for key, value in given.items()}
    for key, values in _FIXED.items():
        if key in user and user.pop(key).upper() not in values:
            raise InputError(
                f"creation option {key}={given.get(key, given.get(key.lower()))} cannot be had: files are written "
                f"pixel-interleaved in tiles of {BLOCK}",
                where=where,
                mend=f"leave {key} out, and convert the result with gdal_translate",
            )
    options = dict(_GTIFF_DEFAULTS if driver == "GTiff" else _COG_DEFAULTS)
    if driver == "COG":
        user = {_COG_NAMES.get(key, key): value for key, value in user.items()}
        if "PREDICTOR" in user:
            user["PREDICTOR"] = _COG_PREDICTORS.get(user["PREDICTOR"], user["PREDICTOR"])
    if user.get("COMPRESS", "DEFLATE").upper() != "DEFLATE":
        options.pop("ZLEVEL", None)
        options.pop("LEVEL", None)
    options.update(user)
    options["COMPRESS"] = options["COMPRESS"].upper()
    if options["COMPRESS"] in _PREDICTED:
        if driver == "COG":
            options.setdefault("PREDICTOR", "YES")
        else:
            options.setdefault("PREDICTOR", "3" if dtype.kind == "f" else "2")
    return options


def _check_type(dtype: str, nodata: float | None, where: str) -> None:
    if dtype not in DTYPES:
        raise InputError(f"samples of type {dtype} cannot be written", where=where, mend=f"one of {', '.join(DTYPES)}")
    if nodata is None:
        return
    kind = np.dtype(dtype)
    if kind.kind == "f":
        fits = not np.isfinite(nodata) or abs(nodata) <= float(np.finfo(dtype).max)
    else:
        limits = np.iinfo(dtype)
        fits = float(nodata).is_integer() and limits.min <= nodata <= limits.max
    if not fits:
        raise InputError(
            f"nodata {nodata} is not a value of type {dtype}",
            where=where,
            mend="choose another nodata value, or none: then an internal mask marks the invalid pixels",
        )


def _photometric(bands: int, dtype: np.dtype[np.generic]) -> str:
    # Without it GDAL would call the fourth of four bands alpha.
    return "RGB" if bands == 3 and dtype == np.uint8 else "MINISBLACK"


def _sync(path: Path) -> None:
    """Bring a file, or a folder's entries, to the disk."""
    if os.name == "nt" and path.is_dir():
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _literal(name: str) -> str:
    """Escape a file name for glob."""
    return "".join(f"[{c}]" if c in "*?[" else c for c in name)


def _size(size: int) -> str:
    return f"{size / 1e9:.1f} GB" if size >= 1e9 else f"{size / 1e6:.1f} MB"
