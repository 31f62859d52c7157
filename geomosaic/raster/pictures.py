"""Pictures of rasters: reduced previews, and any part of a north-up raster at a given resolution."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from io import BytesIO
from typing import Any

import numpy as np
from rasterio.enums import Resampling
from rasterio.errors import RasterioError

from geomosaic.errors import InputError, RasterReadError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.grid import Bounds, Grid, Window
from geomosaic.raster.environment import environment
from geomosaic.raster.info import describe, open_raster
from geomosaic.raster.source import Source
from geomosaic.raster.validity import combine, missing_by_value, usable_nodata
from geomosaic.types import AnyArray, ByteArray, FloatArray, PathLike

# Level 2 of zlib takes a fifth of the time of its default (6), and makes pictures of photos 14 % larger.
_PNG_LEVEL = 2
# Artefacts of JPEG are not seen at twice the size.
_JPEG_QUALITY = 92
# Colour of `.map` in the report's style.css: pixels without data look like the page behind them.
_BACKGROUND = 238, 241, 244


def preview(path: PathLike, max_size: int = 1024) -> tuple[ByteArray, ByteArray]:
    """Read a raster reduced to a small picture, through its overviews where it has any.

    Parameters
    ----------
    path : path
    max_size : int, longer side in pixels

    Returns
    -------
    rgb : uint8 array (rows, cols, 3)
        The first three bands, or the first one as grey. Samples that are not uint8 are stretched from their 2nd to
        their 98th percentile.
    valid : uint8 array (rows, cols), 1 where there is a picture
    """
    with environment(), open_raster(path) as dataset:
        info = describe(dataset, str(path))
        factor = max(1.0, max(info.size) / max_size)
        shape = (max(1, round(info.height / factor)), max(1, round(info.width / factor)))
        numbers = [i for i in dataset.indexes if i != info.alpha][: 3 if info.bands >= 3 else 1]
        values = np.empty((*shape, len(numbers)), dtype=info.dtype)
        mask: AnyArray | None = None
        try:
            dataset.read(numbers, out=np.moveaxis(values, -1, 0), resampling=Resampling.average)
            if info.alpha is not None:
                mask = dataset.read(info.alpha, out_shape=shape)
            elif info.mask_band:
                mask = dataset.read_masks(numbers[0], out_shape=shape)
        except (RasterioError, OSError) as error:
            raise RasterReadError(
                f"cannot be read ({error.__cause__ or error})",
                where=str(path),
                hint="copy the file again from where it came",
            ) from error
    nodata = [usable_nodata(values.dtype, info.nodatas[i]) for i in range(len(numbers))]
    valid = combine(missing_by_value(values, nodata), mask)
    if valid is None:
        valid = np.ones(shape, dtype=np.uint8)
    rgb = values if values.dtype == np.uint8 else stretch(values, valid)
    return np.ascontiguousarray(np.broadcast_to(rgb, (*shape, 3))), valid


def line_picture(
    lines: Sequence[FloatArray], size: tuple[int, int], max_size: int = 1024
) -> tuple[ByteArray, ByteArray]:
    """Lines drawn in grey on a small picture.

    Parameters
    ----------
    lines : sequence of array (N, 2)
        Columns and rows, pixels of the whole.
    size : tuple of int
        Width and height of the whole.
    max_size : int
        Longer side of the picture, pixels.

    Returns
    -------
    rgb : uint8 array (rows, cols, 3)
    valid : uint8 array (rows, cols), all 1
    """
    from PIL import Image, ImageDraw

    shrink = max_size / max(size)
    image = Image.new("RGB", (max(1, round(size[0] * shrink)), max(1, round(size[1] * shrink))), _BACKGROUND)
    canvas = ImageDraw.Draw(image)
    # A line along the right or lower edge has its place in the last pixels.
    last = np.array(image.size) - 1.0
    for line in lines:
        places = [(float(x), float(y)) for x, y in np.minimum(line * shrink, last)]
        if len(places) > 1:
            canvas.line(places, fill=(70, 90, 100))
        else:
            canvas.ellipse([places[0][0] - 2, places[0][1] - 2, places[0][0] + 2, places[0][1] + 2], fill=(70, 90, 100))
    rgb = np.asarray(image, dtype=np.uint8)
    return rgb, np.ones(rgb.shape[:2], dtype=np.uint8)


def stretch(values: AnyArray, valid: ByteArray) -> ByteArray:
    """Contrast stretch of any samples to uint8, from the 2nd to the 98th percentile of all valid pixels and bands.

    Parameters
    ----------
    values : array (rows, cols, bands)
    valid : uint8 array (rows, cols)

    Returns
    -------
    uint8 array (rows, cols, bands), 0 where not valid
    """
    known = values[valid != 0].astype(np.float64)
    if not known.size:
        return np.zeros(values.shape, dtype=np.uint8)
    low, high = np.percentile(known, (2.0, 98.0))
    with np.errstate(invalid="ignore"):
        # An image of one value has no contrast to stretch: the least divisor keeps it from becoming infinite.
        grey = (values.astype(np.float64) - low) * (255.0 / max(high - low, 1e-12))
    return np.where(valid[:, :, None] != 0, np.clip(np.nan_to_num(grey), 0, 255), 0).astype(np.uint8)


def jpeg_bytes(rgb: ByteArray, valid: ByteArray, quality: int = _JPEG_QUALITY) -> bytes:
    """JPEG of a picture to be looked at, a fifth of PNG's size and time; pale where not valid.

    Parameters
    ----------
    rgb : uint8 array (rows, cols, 3)
    valid : uint8 array (rows, cols)
    quality : int
        Of JPEG, up to 100; below 90 colours have half the resolution.
    """
    from PIL import Image

    shown = rgb if valid.all() else np.where(valid[:, :, None] != 0, rgb, np.array(_BACKGROUND, dtype=np.uint8))
    stream = BytesIO()
    Image.fromarray(shown).save(stream, format="JPEG", quality=quality, subsampling=0 if quality >= 90 else 2)
    return stream.getvalue()


def png_bytes(rgb: ByteArray, valid: ByteArray | None = None) -> bytes:
    """PNG of a picture, transparent where not valid.

    Parameters
    ----------
    rgb : uint8 array (rows, cols, 3)
    valid : uint8 array (rows, cols), optional, all valid unless given
    """
    from PIL import Image

    pixels = rgb if valid is None or valid.all() else np.dstack([rgb, np.where(valid != 0, 255, 0).astype(np.uint8)])
    stream = BytesIO()
    Image.fromarray(pixels).save(stream, format="PNG", compress_level=_PNG_LEVEL)
    return stream.getvalue()


# Rows that are resampled at once: memory stays at a strip whatever the picture.
_STRIP = 256
# Pixels around a strip that bicubic interpolation may need.
_REACH = 4


def raster_grid(source: Source, where: str) -> Grid:
    """Grid of a raster that pictures are taken of: with a CRS, and north up.

    Parameters
    ----------
    source : Source
    where : str, named in errors

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
    return Grid(horizontal(info.crs), t, info.width, info.height)


# One per band: from values to levels from 0 to 255.
Curves = Sequence[Callable[[AnyArray], AnyArray]]


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
    grid : Grid, of the source; north up
    bounds : Bounds, area in the grid's CRS; what lies outside the raster stays transparent
    size : tuple of int, width and height of the result
    bands : sequence of int, three or one to show, from 1; by default the first three, or the first one as grey
    curves : sequence of callable, of the shown bands; without them values are levels from 0 to 255

    Returns
    -------
    uint8 array (height, width, 4), red, green, blue and 255 where there is a picture, 0 elsewhere
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
    grid : Grid, of the source
    window : Window, its corner and size are multiples of `shrink`
    shrink : int, pixels along a side of which one mean is read
    bands : sequence of int, from 1

    Returns
    -------
    values : float32 array (rows, cols, bands), 0 where not valid
    valid : float32 array (rows, cols), 1 or 0
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
    """Resampled values (rows, cols, 4); invalid pixels have no weight."""
    from PIL import Image

    def resize(band: AnyArray) -> AnyArray:
        image = Image.fromarray(np.ascontiguousarray(band, dtype=np.float32))
        return np.asarray(image.resize(size, Image.Resampling.BICUBIC, box=box))

    # Values are 0 where not valid: divided by the resampled validity, the mean is that of the valid pixels alone.
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
        out[..., band] = grey  # a single band is repeated
    out[..., 3] = np.where(seen, 255, 0)
    return out
