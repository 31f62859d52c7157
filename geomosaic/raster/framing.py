"""Framing of rasters: the part of a north-up raster inside given bounds, read once at the resolution asked for."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from geomosaic.errors import InputError
from geomosaic.geo.grid import Bounds, Grid, Window
from geomosaic.raster.source import Source
from geomosaic.types import AnyArray, ByteArray

_STRIP = 256


_REACH = 4
"""Pixels around a strip that bicubic interpolation may need."""


def raster_grid(source: Source, where: str) -> Grid:
    """Grid of a raster that can be framed: with a CRS, and north up.

    Parameters
    ----------
    source : Source
    where : str
        Named in errors.

    Returns
    -------
    Grid

    Raises
    ------
    InputError
        No CRS, no geo-reference, turned, or colours that stand in a palette.
    """
    info = source.info
    if info.crs is None or info.transform is None:
        raise InputError(
            f"the raster has no {'CRS' if info.transform is not None else 'geo-reference'}",
            where=where,
            hint="make it with `geomosaic ortho` or `geomosaic mosaic`, or assign a CRS with gdal_edit -a_srs",
        )
    t = info.transform
    if t.b or t.d or t.a <= 0 or t.e >= 0:
        raise InputError("the raster is not north up", where=where, hint="rectify it into a north-up grid first")
    if "palette" in info.colors:
        raise InputError(
            "the colours of the raster stand in a palette",
            where=where,
            hint="expand them first: gdal_translate -expand rgb",
        )
    from geomosaic.geo.crs import horizontal

    return Grid(horizontal(info.crs), t, info.width, info.height)


Curves = Sequence[Callable[[AnyArray], AnyArray]]
"""One per band: from values to levels from 0 to 255."""


def picture(
    source: Source,
    grid: Grid,
    bounds: Bounds,
    size: tuple[int, int],
    bands: Sequence[int] = (),
    curves: Curves = (),
) -> ByteArray:
    """Pixels of an area: bicubic, or the mean of what a print pixel covers where the raster is finer.

    Parameters
    ----------
    source : Source
    grid : Grid
        Of the source; north up.
    bounds : Bounds
        Area in the grid's CRS; what lies outside the raster stays transparent.
    size : tuple of int
        Width and height of the result.
    bands : sequence of int
        Three or one to show, from 1; by default the first three, or the first one as grey.
    curves : sequence of callable
        Of the shown bands; without them values are levels from 0 to 255.

    Returns
    -------
    uint8 array (height, width, 4)
        Red, green, blue and 255 where there is a picture, 0 elsewhere.
    """
    width, height = size
    (left, top), (right, bottom) = grid.colrow(np.array([[bounds[0], bounds[3]], [bounds[2], bounds[1]]]))
    # 1e-6 keeps a ratio of exactly n from being cut to n - 1 by rounding.
    shrink = max(1, int(min((right - left) / width, (bottom - top) / height) + 1e-6))
    bands = bands or ((1, 2, 3) if source.info.bands >= 3 else (1,))
    out = np.zeros((height, width, 4), dtype=np.uint8)
    step = (bottom - top) / height
    for row in range(0, height, _STRIP):
        stop = min(height, row + _STRIP)
        first, last = top + row * step, top + stop * step
        reach = _REACH * max(shrink, step)
        window = _aligned(left - reach, first - reach, right + reach, last + reach, shrink)
        values, valid = read_bands(source, grid, window, shrink, bands)
        if not valid.any():
            continue
        box = (
            (left - window.col) / shrink, (first - window.row) / shrink,
            (right - window.col) / shrink, (last - window.row) / shrink,
        )  # fmt: skip
        out[row:stop] = _resized(values, valid, box, (width, stop - row), curves)
    return out


def _aligned(left: float, top: float, right: float, bottom: float, shrink: int) -> Window:
    col, row = (int(np.floor(v / shrink)) * shrink for v in (left, top))
    stop_col, stop_row = (int(np.ceil(v / shrink)) * shrink for v in (right, bottom))
    return Window(col, row, stop_col - col, stop_row - row)


def read_bands(
    source: Source, grid: Grid, window: Window, shrink: int, bands: Sequence[int]
) -> tuple[AnyArray, AnyArray]:
    """Values and validity of a window that may reach beyond the raster.

    Parameters
    ----------
    source : Source
    grid : Grid
        Of the source.
    window : Window
        Its corner and size are multiples of `shrink`.
    shrink : int
        Pixels along a side of which one mean is read.
    bands : sequence of int
        From 1.

    Returns
    -------
    values : float32 array (rows, cols, bands)
        0 where not valid.
    valid : float32 array (rows, cols)
        1 or 0.
    """
    shape = (window.height // shrink, window.width // shrink)
    values, valid = np.zeros((*shape, len(bands)), dtype=np.float32), np.zeros(shape, dtype=np.float32)
    inside = window.intersection(grid.window)
    if inside.empty:
        return values, valid
    part, known = source.read(inside, shrink)
    row, col = (inside.row - window.row) // shrink, (inside.col - window.col) // shrink
    place = slice(row, row + part.shape[0]), slice(col, col + part.shape[1])
    valid[place] = 1.0 if known is None else known
    values[place] = np.where(valid[place][..., None] > 0, part[..., [band - 1 for band in bands]], 0)
    return values, valid


def _resized(values: AnyArray, valid: AnyArray, box: Any, size: tuple[int, int], curves: Curves = ()) -> ByteArray:
    """Resample; invalid pixels have no weight."""
    from PIL import Image

    def resize(band: AnyArray) -> AnyArray:
        image = Image.fromarray(np.ascontiguousarray(band, dtype=np.float32))
        return np.asarray(image.resize(size, Image.Resampling.BICUBIC, box=box))

    out = np.zeros((size[1], size[0], 4), dtype=np.uint8)
    weight = resize(valid)
    seen = weight >= 0.5
    whole = bool((valid > 0).all())
    for band in range(3):
        if band < values.shape[2]:
            mean = resize(values[..., band])
            if not whole:
                mean = np.where(seen, mean / np.where(seen, weight, 1.0), 0.0)
            if curves:
                mean = curves[band](mean)
            grey = np.clip(np.floor(mean + 0.5), 0, 255).astype(np.uint8)
        out[..., band] = grey
    out[..., 3] = np.where(seen, 255, 0)
    return out
