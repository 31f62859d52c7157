"""Decoded images kept whole, in memory or as raw rows in a scratch folder, for formats that know no windows."""

from __future__ import annotations

import tempfile
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from geomosaic.errors import OutputError
from geomosaic.geo.grid import Window
from geomosaic.types import AnyArray, ByteArray

Pixels = tuple[AnyArray, ByteArray | None]


class InMemory:
    """Decoded image in memory.

    Parameters
    ----------
    values : array (rows, cols, bands)
    valid : uint8 array (rows, cols) or None
        None where every pixel is valid.
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


class OnDisk:
    """A decoded image as raw rows in a temporary folder that is removed on close.

    A window is mapped, copied and unmapped, so that resident memory stays at one window whatever the image.

    Parameters
    ----------
    scratch : Path or None
        Folder for the temporary folder; the system's when None.
    shape : tuple
        Rows, columns, bands.
    dtype : dtype
        Of the samples.
    strips : iterable
        Pixels of full-width strips from the top.
    name : str
        The image, for errors.
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
