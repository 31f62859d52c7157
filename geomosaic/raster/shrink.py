"""Means of square blocks of valid pixels, for reading an image at a fraction of its size."""

from __future__ import annotations

import numpy as np

from geomosaic.types import AnyArray, ByteArray, Float32Array

_BYTES = 257
"""Bytes whose sum fits in sixteen bits."""


def block_sum(values: AnyArray, size: int, dtype: type[np.generic]) -> AnyArray:
    """Sum blocks of size × size pixels of an array (rows, cols, ...); blocks at the end hold what is left.

    Rows first, then columns: every addition runs over long stretches of memory, and the order of the additions of a
    block never depends on where the array was cut.
    """
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
    valid : uint8 array (rows, cols) of 1 and 0, or None
        None where all are valid.
    size : int
        Pixels along the side of a block.

    Returns
    -------
    means : float32 array (ceil(rows / size), ceil(cols / size), bands)
        0 where no pixel of the block is valid.
    valid : uint8 array or None
        1 where any pixel of the block is valid; None where all blocks are.
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
