"""Reduced copies of rasters: means of square blocks of valid pixels, and small pictures for reports."""

from __future__ import annotations

from io import BytesIO

import numpy as np
from rasterio.enums import Resampling
from rasterio.errors import RasterioError

from geomosaic.errors import RasterReadError
from geomosaic.raster.environment import environment
from geomosaic.raster.info import describe, open_raster
from geomosaic.raster.validity import combine, missing_by_value, usable_nodata
from geomosaic.types import AnyArray, ByteArray, PathLike

_PACKED = 2
"""Of zlib's levels: a fifth of the time of its usual one (6), and pictures of photos 14 % larger."""

_QUALITY = 92
"""Of JPEG: nothing of it is seen at twice the size."""
_NOTHING = 238, 241, 244
"""Of `.map` in the report's style.css."""


def preview(path: PathLike, max_size: int = 1024) -> tuple[ByteArray, ByteArray]:
    """Read a raster reduced to a small picture, through its overviews where it has any.

    Parameters
    ----------
    path : path
    max_size : int
        Longer side in pixels.

    Returns
    -------
    rgb : uint8 array (rows, cols, 3)
        The first three bands, or the first one as grey. Samples that are not uint8 are stretched from their 2nd to
        their 98th percentile.
    valid : uint8 array (rows, cols)
        1 where there is a picture.
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
            raise RasterReadError(f"cannot be read ({error.__cause__ or error})", where=str(path)) from error
    nodata = [usable_nodata(values.dtype, info.nodatas[i]) for i in range(len(numbers))]
    valid = combine(missing_by_value(values, nodata), mask)
    if valid is None:
        valid = np.ones(shape, dtype=np.uint8)
    rgb = values if values.dtype == np.uint8 else stretch(values, valid)
    return np.ascontiguousarray(np.broadcast_to(rgb, (*shape, 3))), valid


def stretch(values: AnyArray, valid: ByteArray) -> ByteArray:
    """Contrast stretch of any samples to uint8, from the 2nd to the 98th percentile of all valid pixels and bands.

    Parameters
    ----------
    values : array (rows, cols, bands)
    valid : uint8 array (rows, cols)

    Returns
    -------
    uint8 array (rows, cols, bands)
        0 where not valid.
    """
    known = values[valid != 0].astype(np.float64)
    if not known.size:
        return np.zeros(values.shape, dtype=np.uint8)
    low, high = np.percentile(known, (2.0, 98.0))
    with np.errstate(invalid="ignore"):
        # An image of one value has no contrast to stretch.
        grey = (values.astype(np.float64) - low) * (255.0 / max(high - low, 1e-12))
    return np.where(valid[:, :, None] != 0, np.clip(np.nan_to_num(grey), 0, 255), 0).astype(np.uint8)


def jpeg_bytes(rgb: ByteArray, valid: ByteArray) -> bytes:
    """JPEG of a picture to be looked at, a fifth of PNG's size and time; pale where not valid.

    Parameters
    ----------
    rgb : uint8 array (rows, cols, 3)
    valid : uint8 array (rows, cols)

    Returns
    -------
    bytes
    """
    from PIL import Image

    shown = rgb if valid.all() else np.where(valid[:, :, None] != 0, rgb, np.array(_NOTHING, dtype=np.uint8))
    stream = BytesIO()
    Image.fromarray(shown).save(stream, format="JPEG", quality=_QUALITY, subsampling=0)
    return stream.getvalue()


def png_bytes(rgb: ByteArray, valid: ByteArray | None = None) -> bytes:
    """PNG of a picture, transparent where not valid.

    Parameters
    ----------
    rgb : uint8 array (rows, cols, 3)
    valid : uint8 array (rows, cols), optional
        All valid unless given.

    Returns
    -------
    bytes
    """
    from PIL import Image

    pixels = rgb if valid is None or valid.all() else np.dstack([rgb, np.where(valid != 0, 255, 0).astype(np.uint8)])
    stream = BytesIO()
    Image.fromarray(pixels).save(stream, format="PNG", compress_level=_PACKED)
    return stream.getvalue()
