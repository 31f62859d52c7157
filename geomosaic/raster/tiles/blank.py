"""What stands in pixels that show nothing, and how others are kept from looking so."""

from __future__ import annotations

import numpy as np

from geomosaic.types import AnyArray, ByteArray


def filled(values: AnyArray, valid: ByteArray | None, nodata: float | None) -> AnyArray:
    """Set invalid pixels to nodata, or zero, and move valid ones off nodata."""
    if nodata is not None:
        values = _off_nodata(values, nodata)
    if valid is None:
        return values
    blank = values.dtype.type(0 if nodata is None else nodata)
    if not valid.any():
        return np.full_like(values, blank)
    if nodata is None and values.dtype.kind in "iu":  # several times as fast as choosing
        filled: AnyArray = values * valid[..., None].astype(values.dtype)
        return filled
    return np.where(valid[..., None] != 0, values, blank)


def _off_nodata(values: AnyArray, nodata: float) -> AnyArray:
    """Move valid pixels that happen to equal nodata to the next value, so that they stay valid."""
    if np.isnan(nodata):
        return values
    same = values == nodata
    if values.dtype.kind == "u" and values.shape[2] > 1:  # see validity.missing_by_value
        same = same.all(axis=2, keepdims=True)
    if not same.any():
        return values
    if values.dtype.kind == "f":
        near = np.nextafter(values.dtype.type(nodata), values.dtype.type(0 if nodata else 1))
    else:
        near = nodata - 1 if nodata == np.iinfo(values.dtype).max else nodata + 1
    return np.where(same, values.dtype.type(near), values)
