"""Aligned images, whose pixels are pixels of the output: copied to the bit, not resampled."""

from __future__ import annotations

from typing import Any

import numpy as np

from geomosaic.block import Footprint
from geomosaic.geo.grid import Grid, Window
from geomosaic.options.render import CELL
from geomosaic.radiometry.corrections import ToneCurve
from geomosaic.raster.source import Source
from geomosaic.raster.validity import block_sum
from geomosaic.resample.warp import Colour, value_range
from geomosaic.sensor.lattice import FIRST_STEP, Lattice
from geomosaic.sensor.map_to_image import MapToImage
from geomosaic.types import AnyArray, ByteArray, IntArray

# Pixels that an image may lie beside the grid: below what its geotransform can mean, and half the usual tolerance.
NEAR = 0.01
_PLACES = 5
# Samples that are read at once for means of cells.
_STRIP = 1 << 23

# Columns and rows: image pixel = output pixel + offset.
Offset = tuple[int, int]


def offset_on(grid: Grid, mapper: MapToImage, footprint: Footprint) -> Offset | None:
    """Offset of an image whose pixels are pixels of the grid.

    Parameters
    ----------
    grid : Grid
        The output.
    mapper : MapToImage
        Map of `grid` to image.
    footprint : Footprint
        Of the image, in the map of `grid`.

    Returns
    -------
    (columns, rows) or None
        Image pixel minus output pixel; None where the image has to be resampled.
    """
    # The image positions of 5 × 5 places over the footprint must all differ from the places' own by the same whole
    # numbers, within `NEAR`.
    if mapper.uses_heights:
        return None
    left, bottom, right, top = footprint.bounds
    x, y = np.meshgrid(np.linspace(left, right, _PLACES), np.linspace(bottom, top, _PLACES))
    xy = np.column_stack([x.ravel(), y.ravel()])
    apart = mapper(xy, np.zeros(len(xy))) - grid.colrow(xy)
    if not np.isfinite(apart).all():
        return None
    whole = np.round(apart[0])
    if (np.abs(apart - whole) > NEAR).any():
        return None
    return int(whole[0]), int(whole[1])


def picked(source: Source, offset: Offset, step: int, window: Window, out: AnyArray, out_valid: ByteArray) -> None:
    """Middle pixels of cells of `step` × `step` output pixels, of a source that `decimates`.

    Parameters
    ----------
    source : Source
    offset : (columns, rows)
        See `offset_on`.
    step : int
        Output pixels along a cell.
    window : Window
        In cells.
    out : array (rows, cols, bands)
        Of the window.
    out_valid : uint8 array (rows, cols)
        Set to 1 where the image is seen.
    """
    at = offset[0] + step // 2, offset[1] + step // 2  # of the middle pixel of cell 0
    size = source.info.width, source.info.height
    (col, stop_col), (row, stop_row) = (
        (-(place // step), -((place - length) // step)) for place, length in zip(at, size, strict=True)
    )
    part = Window(col, row, stop_col - col, stop_row - row).intersection(window)
    if part.empty:
        return
    first = at[0] + part.col * step, at[1] + part.row * step
    values, valid = source.read_decimated(first, (part.width, part.height), step)
    seen = np.ones(values.shape[:2], dtype=np.uint8) if valid is None else valid
    inside = part.slices_in(window)
    np.copyto(out[inside], values, where=seen[..., None] > 0)
    out_valid[inside] = seen


def is_identity(colour: Colour) -> bool:
    """Whether a correction leaves all values as they are.

    Parameters
    ----------
    colour : Colour

    Returns
    -------
    bool
    """
    return bool((colour.gain == 1.0).all() and (colour.offset == 0.0).all())


def copied(
    source: Source,
    offset: Offset,
    window: Window,
    out: AnyArray,
    out_valid: ByteArray,
    need: ByteArray | None,
    table: AnyArray | None = None,
) -> list[Lattice]:
    """Copy the pixels of a block; what is not wanted, or not valid, stays as it is.

    Parameters
    ----------
    source : Source
    offset : (columns, rows)
        See `offset_on`.
    window : Window
        The block, in output pixels.
    out : array (rows, cols, bands)
        Of the block.
    out_valid : uint8 array (rows, cols)
        Set to 1 where the image is seen.
    need : uint8 array (rows / 64, cols / 64), optional
        Cells of 64 × 64 pixels that are wanted.
    table : array (bands, values), optional
        What becomes of each value, see `table_of`.

    Returns
    -------
    list of Lattice
        The exact way to the image; empty where the block does not see it.
    """
    wanted = window
    if need is not None:
        rows, cols = np.nonzero(need.any(axis=1))[0], np.nonzero(need.any(axis=0))[0]
        if not len(rows):
            return []
        first_col, first_row = window.col + int(cols[0]) * CELL, window.row + int(rows[0]) * CELL
        size = int(cols[-1] - cols[0] + 1) * CELL, int(rows[-1] - rows[0] + 1) * CELL
        wanted = Window(first_col, first_row, *size).intersection(window)
    image = Window(-offset[0], -offset[1], source.info.width, source.info.height)
    part = wanted.intersection(image)
    if part.empty:
        return []
    values, valid = source.read(Window(part.col + offset[0], part.row + offset[1], part.width, part.height))
    inside = part.slices_in(window)
    mask = None if need is None or need.all() else _pixels(need)[inside]
    if valid is not None:
        mask = valid > 0 if mask is None else mask & (valid > 0)
    if table is not None:
        from geomosaic.kernels.blend import lookup

        wanted_pixels = _EVERY if mask is None else mask.view(np.uint8)
        lookup(values, table, wanted_pixels, mask is not None, out[inside], out_valid[inside])
        return [_exact(window, offset)]
    if mask is None:
        out[inside], out_valid[inside] = values, 1
    else:
        np.copyto(out[inside], values, where=mask[..., None])
        out_valid[inside][mask] = 1
    return [_exact(window, offset)]


def cell_means(source: Source, offset: Offset, window: Window, size: int, out: AnyArray, out_valid: ByteArray) -> None:
    """Means over cells of size × size output pixels: images of the same pixels have the same means, to the bit.

    Parameters
    ----------
    source : Source
    offset : (columns, rows)
        See `offset_on`.
    window : Window
        Of the cells.
    size : int
    out : array (rows, cols, bands)
    out_valid : uint8 array (rows, cols)
        1 where at least half of a cell's pixels are valid.
    """
    image = Window(-offset[0], -offset[1], source.info.width, source.info.height)
    samples = size * size * out.shape[2]  # of a cell
    # A strip of cells across the window; of a window so wide that one row of cells is too much, parts of it.
    rows, cols = max(1, _STRIP // (samples * window.width)), max(1, 8 * _STRIP // samples)
    for strip in window.split(min(window.width, cols), rows):
        cells = Window(strip.col * size, strip.row * size, strip.width * size, strip.height * size)
        part = cells.intersection(image)
        if part.empty:
            continue
        values, valid = source.read(Window(part.col + offset[0], part.row + offset[1], part.width, part.height))
        if valid is None:
            valid = np.ones(values.shape[:2], dtype=np.uint8)
        if part != cells:
            edges = (
                (part.row - cells.row, cells.stop_row - part.stop_row),
                (part.col - cells.col, cells.stop_col - part.stop_col),
            )
            values, valid = np.pad(values, (*edges, (0, 0))), np.pad(valid, edges)
        here, count = strip.slices_in(window), block_sum(valid, size, np.int32)
        _blank_parts(values, valid, size, count)
        total = block_sum(values, size, np.float64)
        total[count == 0] = 0.0
        out[here] = total / np.maximum(count, 1)[..., None]
        out_valid[here] = 2 * count >= size * size


def _blank_parts(values: AnyArray, valid: ByteArray, size: int, count: IntArray) -> None:
    """Zeros where pixels are not valid; of whole numbers only in cells that are valid in part."""
    if values.dtype.kind == "f":  # what is not valid may be no number
        values[valid == 0] = 0
        return
    # Few cells are: to blank all pixels took longer than to read them and to add them up.
    rows, cols = count.shape
    by_cell, known = values.reshape(rows, size, cols, size, -1), valid.reshape(rows, size, cols, size)
    for row, col in np.argwhere((count > 0) & (count < size * size)):
        by_cell[row, :, col][known[row, :, col] == 0] = 0


def table_of(colour: Colour | ToneCurve, scale: float, source: np.dtype[Any], out: np.dtype[Any]) -> AnyArray | None:
    """Lookup table of a correction, for samples of 8 or 16 bits without sign.

    Parameters
    ----------
    colour : Colour or ToneCurve
    scale : float
        Factor that values have before the correction.
    source, out : dtype
        Of the image and of the output.

    Returns
    -------
    array (bands, values) or None
        Of type `out`; None for other sample types, whose tables would be too long.
    """
    # Whole numbers are rounded, halves up, and kept within the type of the output.
    if source.kind != "u" or source.itemsize > 2:
        return None
    plain = np.arange(np.iinfo(source).max + 1, dtype=np.float64)
    if isinstance(colour, ToneCurve):
        bands = len(colour.knots)
        values = colour(np.repeat((plain * scale)[:, None], bands, axis=1)).T
    else:
        values = plain * (colour.gain * scale)[:, None] + colour.offset[:, None]
    low, high, whole = value_range(str(out))
    return (np.clip(np.floor(values + 0.5), low, high) if whole else values).astype(out, order="C")


_EVERY = np.ones((1, 1), dtype=np.uint8)


def _pixels(need: ByteArray) -> AnyArray:
    return np.repeat(np.repeat(need > 0, CELL, axis=0), CELL, axis=1)


def _exact(window: Window, offset: Offset) -> Lattice:
    """The lattice of an image that needs none."""
    step = FIRST_STEP
    rows, cols = -(-window.height // step), -(-window.width // step)
    nodes = np.zeros((rows + 1, cols + 1, 8))
    nodes[..., 0] = window.col + offset[0] + step * np.arange(cols + 1)
    nodes[..., 4] = (window.row + offset[1] + step * np.arange(rows + 1))[:, None]
    bounds = (
        float(window.col + offset[0]), float(window.row + offset[1]),
        float(window.stop_col + offset[0]), float(window.stop_row + offset[1]),
    )  # fmt: skip
    seen = np.ones((rows, cols), dtype=np.bool_)
    return Lattice(
        window, step, nodes, np.zeros((rows + 1, cols + 1, 2)), 0.0, 0.0, 0.0, bounds, 1.0, seen, nodes[None, ..., ::4]
    )
