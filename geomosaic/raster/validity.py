"""Validity masks: nodata, alpha, NaN, usable areas; polygons to pixels. A mask of its own keeps true black valid."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from affine import Affine

from geomosaic.geo.grid import Grid, Window
from geomosaic.types import AnyArray, BoolArray, ByteArray, Float32Array


def usable_nodata(dtype: np.dtype[Any], nodata: float | None) -> float | None:
    """Nodata value as the sample type holds it.

    Parameters
    ----------
    dtype : dtype
    nodata : float or None, as the file or the user has it

    Returns
    -------
    float or None, None where no sample can have that value
    """
    if nodata is None or (np.isnan(nodata) and dtype.kind != "f"):
        return None
    if dtype.kind == "f":
        with np.errstate(over="ignore"):
            return float(np.asarray(nodata).astype(dtype))
    # A value that the type cannot hold marks nothing; cut to the type it would mark a grey value.
    limits = np.iinfo(dtype)
    return nodata if float(nodata).is_integer() and limits.min <= nodata <= limits.max else None


def missing_by_value(values: AnyArray, nodata: Sequence[float | None]) -> BoolArray | None:
    """Pixels without a measurement, by their values.

    Parameters
    ----------
    values : array (rows, cols, bands)
    nodata : sequence of float or None, per band, already through `usable_nodata`

    Returns
    -------
    bool array (rows, cols), or None, True where missing; None where no value could say so or none does
    """
    # Unsigned integers use nodata for an ordinary grey value (0 or 255), so a pixel is missing only where every band
    # has it. Signed and floating point types use an impossible one (-9999), which must never enter a sum: there one
    # band is enough. NaN and infinity always miss.
    found: BoolArray | None = None
    if values.dtype.kind == "f":
        known = np.isfinite(values)  # all bands at once, along the memory: four times as fast as one by one
        if not known.all():
            found = ~_across_bands(np.logical_and, known)
    ordinary, marked = values.dtype.kind == "u", None
    if len(set(nodata)) == 1:
        if nodata[0] is not None:
            # Compared with a float, every value would first become one.
            one = values.dtype.type(nodata[0])
            marked = in_all_bands(values, one) if ordinary else _across_bands(np.logical_or, values == one)
    else:
        for band, value in enumerate(nodata):
            none = value is None
            hit = np.zeros(values.shape[:2], bool) if none else values[:, :, band] == values.dtype.type(value)
            marked = hit if marked is None else (marked & hit if ordinary else marked | hit)
    if marked is not None and marked.any():
        found = marked if found is None else found | marked
    return found


def in_all_bands(values: AnyArray, one: Any) -> BoolArray | None:
    """Pixels that have one value in every band.

    Parameters
    ----------
    values : array (rows, cols, bands), integers
    one : scalar, of their type

    Returns
    -------
    bool array (rows, cols), or None where there are none
    """
    bands, size = values.shape[2], values.shape[2] * values.itemsize
    if not values.flags.c_contiguous or values.size == 0:
        found = _across_bands(np.logical_and, values == one)
    elif size in (1, 2, 4, 8):  # a pixel is one number: 3 to 15 times as fast
        found = (values.view(f"u{size}") == np.full(bands, one, values.dtype).view(f"u{size}"))[..., 0]
    elif bands > _FEW:
        found = values[..., 0] == one
        for band in range(1, bands):
            if not found.any():
                return None
            found &= values[..., band] == one
    else:
        # Looked at along the memory: bits that differ from the value, of as many samples in a row as there are bands.
        # Only where that finds none, pixels are looked at one by one, which takes several times as long.
        flat = values.reshape(-1)
        differ = flat ^ one if one else flat
        count = flat.size - bands + 1
        joined = differ[:count] | differ[1 : count + 1]
        for band in range(2, bands):
            joined |= differ[band : count + band]
        if joined.min():
            return None
        found = (joined[::bands] == 0).reshape(values.shape[:2])
    return found if found.any() else None


# Bands up to which looking at all samples is faster than at every pixel's first one.
_FEW = 4


def _across_bands(how: np.ufunc, hits: BoolArray) -> BoolArray:
    """Bool (rows, cols, bands) to (rows, cols); NumPy's reduction over so short an axis takes ten times as long."""
    found: BoolArray = hits[..., 0]
    for band in range(1, hits.shape[2]):
        found = how(found, hits[..., band])
    return found


def combine(missing: BoolArray | None, mask: AnyArray | None) -> ByteArray | None:
    """Validity of pixels from values that say 'missing' and from a mask or alpha band.

    Parameters
    ----------
    missing : bool array (rows, cols) or None
    mask : array (rows, cols) or None, 0 where missing

    Returns
    -------
    uint8 array (rows, cols) or None, 1 where valid, else 0; None where all are valid
    """
    if mask is None:
        return None if missing is None else (~missing).view(np.uint8)
    valid = mask != 0
    if missing is not None:
        valid &= ~missing
    return None if valid.all() else valid.view(np.uint8)


class Usable:
    """The part of an image that may be used.

    Parameters
    ----------
    ring : sequence of (col, row), its corners, in order
    """

    def __init__(self, ring: Sequence[tuple[float, float]]) -> None:
        import shapely

        self._area = shapely.Polygon(ring)
        shapely.prepare(self._area)

    def mask(self, window: Window, mask: AnyArray | None) -> AnyArray | None:
        """Mask (rows, cols) of a window, 0 where not valid, with what lies outside added; None where all is valid."""
        import shapely
        from rasterio.features import rasterize

        if self._area.covers(shapely.box(window.col, window.row, window.stop_col, window.stop_row)):
            return mask
        shape, place = (window.height, window.width), Affine.translation(window.col, window.row)
        inside: AnyArray = rasterize([(self._area, 1)], out_shape=shape, transform=place, fill=0, dtype="uint8")
        return inside if mask is None else np.where(inside > 0, mask, 0)


def rasterized(shapes: Sequence[tuple[Any, int]], grid: Grid, fill: int = -1, dtype: str = "int32") -> AnyArray:
    """Give each pixel whose centre lies in a polygon the polygon's number; later ones win.

    Parameters
    ----------
    shapes : sequence of (geometry, number), in the grid's CRS
    grid : Grid
    fill : int, number of pixels in no polygon
    dtype : str, that has room for the numbers

    Returns
    -------
    array (rows, cols)
    """
    from rasterio.features import rasterize

    kept = [(shape, number) for shape, number in shapes if not shape.is_empty]
    if not kept:
        return np.full(grid.shape, fill, dtype=dtype)
    burnt: AnyArray = rasterize(kept, out_shape=grid.shape, transform=grid.transform, fill=fill, dtype=dtype)
    return burnt


def polygons_of_labels(label: AnyArray, grid: Grid) -> list[tuple[Any, int]]:
    """Polygons around cells of equal number.

    Parameters
    ----------
    label : int array (rows, cols), cells below 0 are left out
    grid : Grid, of the cells

    Returns
    -------
    list of (polygon, int), polygons in the CRS of `grid`, and their numbers
    """
    from rasterio.features import shapes
    from shapely.geometry import shape

    wanted = np.ascontiguousarray(label, dtype=np.int32)
    # Borders follow the edges of cells, so that neighbours have common vertices. Cells that meet at a corner only would
    # make a polygon that touches itself.
    found = shapes(wanted, mask=wanted >= 0, connectivity=4, transform=grid.transform)
    return [(shape(geometry), int(number)) for geometry, number in found]


# Bytes whose sum fits in sixteen bits.
_BYTES = 257


def block_sum(values: AnyArray, size: int, dtype: type[np.generic]) -> AnyArray:
    """Sums over blocks of size × size pixels; blocks at the end hold what is left.

    Parameters
    ----------
    values : array (rows, cols, ...)
    size : int, pixels along a block
    dtype : type, of the sums

    Returns
    -------
    array (rows / size, cols / size, ...), sizes rounded up
    """
    # Rows first, then columns: every addition runs over long stretches of memory, and the order of the additions of a
    # block never depends on where the array was cut.
    rows, cols = values.shape[:2]
    tall = np.empty((-(-rows // size), *values.shape[1:]), dtype=dtype)
    whole = rows // size
    narrow = np.uint16 if values.dtype == np.uint8 and size <= _BYTES else dtype
    bands_of_rows = values[: whole * size].reshape(whole, size, *values.shape[1:])
    tall[:whole] = np.add.reduce(bands_of_rows, axis=1, dtype=narrow)
    tall[whole:] = np.add.reduce(values[whole * size :], axis=0, dtype=narrow)
    out = np.zeros((tall.shape[0], -(-cols // size), *values.shape[2:]), dtype=dtype)
    for offset in range(min(size, cols)):
        part = tall[:, offset::size]
        out[:, : part.shape[1]] += part
    return out


def block_mean(values: AnyArray, valid: ByteArray | None, size: int) -> tuple[Float32Array, ByteArray | None]:
    """Mean of the valid pixels of every block.

    Parameters
    ----------
    values : array (rows, cols, bands)
    valid : uint8 array (rows, cols) of 1 and 0, or None, None where all are valid
    size : int, pixels along the side of a block

    Returns
    -------
    means : float32 array (ceil(rows / size), ceil(cols / size), bands), 0 where no pixel of the block is valid
    valid : uint8 array or None, 1 where any pixel of the block is valid; None where all blocks are
    """
    rows, cols = values.shape[:2]
    whole = values.dtype.kind in "ui" and values.dtype.itemsize <= 2
    total = block_sum(
        values if valid is None else np.where(valid[:, :, None] != 0, values, values.dtype.type(0)),
        size,
        np.int32 if whole and size <= 128 else np.float64,
    )
    if valid is None:
        high = np.minimum(size, rows - size * np.arange(total.shape[0]))
        wide = np.minimum(size, cols - size * np.arange(total.shape[1]))
        return np.divide(total, (high[:, None] * wide)[:, :, None], dtype=np.float64).astype(np.float32), None
    count = block_sum(valid, size, np.int32)
    means = np.divide(total, np.maximum(count, 1)[:, :, None], dtype=np.float64).astype(np.float32)
    return means, None if (count > 0).all() else (count > 0).view(np.uint8)
