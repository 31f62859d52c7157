"""Raster that a call has written: its numbers stay with the result, its pixels are read when asked for."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.errors import InputError
from geomosaic.geo.grid import Grid, Window
from geomosaic.raster.source import Source


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
                f"{window} lies outside of the raster of {self.grid.width} x {self.grid.height} pixels", where="window"
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
        code = self.grid.crs.to_authority(min_confidence=100)
        name = ":".join(code) if code else self.grid.crs.name
        size = f"{self.grid.width} x {self.grid.height} px of {self.grid.resolution[0]:g}"
        return f"{type(self).__name__}('{self.path}', {size}, {name})"
