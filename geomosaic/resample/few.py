"""A few pixels of a block, each placed and sampled for itself: sooner than whole cells where one in three is wanted."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from geomosaic.resample.engine import Engine
from geomosaic.types import AnyArray, BoolArray, ByteArray, IntArray

SHARE = 0.3
"""Of the pixels of wanted cells, below which each is taken for itself."""
CELL = 64
AT_ONCE = 65536


def few_of(engine: Engine, only: BoolArray, need: ByteArray, n: int) -> tuple[IntArray, IntArray] | None:
    """Rows and columns of the wanted pixels of wanted cells; None where all of the cells are done sooner.

    Parameters
    ----------
    engine : Engine
        NumPy's gives whole cells.
    only : bool array (rows, cols)
        Wanted pixels of a block.
    need : uint8 array (rows / 64, cols / 64)
        Wanted cells.
    n : int
        Samples along a pixel's side: one alone is taken for itself.
    """
    if n > 1 or not engine.quick:
        return None
    number = int(np.count_nonzero(only))
    if number > SHARE * CELL**2 * np.count_nonzero(need):
        return None
    from geomosaic.resample.kernels.few import listed

    down, along = np.empty((2, number), dtype=np.int64)
    number = listed(only, need, down, along)
    return down[:number], along[:number]


def fill_few(
    engine: Engine,
    kernel: str,
    geometry: tuple[Any, ...],
    size: tuple[int, int],
    few: tuple[IntArray, IntArray],
    pixels_for: Callable[[tuple[float, ...]], tuple[tuple[float, ...], AnyArray, ByteArray | None] | None],
    ending: tuple[Any, ...],
    out: AnyArray,
    out_valid: ByteArray,
) -> None:
    """Fill some pixels of a block; the bytes are those of the whole.

    Parameters
    ----------
    engine : Engine
        With compiled kernels.
    kernel : str
    geometry : tuple
        See `warp.Geometry`.
    size : tuple of int
        Width and height of the image.
    few : tuple of int array
        Rows and columns of the pixels.
    pixels_for : callable
        Image pixels for a span of coordinates: where they are, values and validity; None where there are none.
    ending : tuple
        What happens to values before they are written.
    out : array (rows, cols, bands)
    out_valid : uint8 array (rows, cols)
        Set to 1 where the image is seen.
    """
    from geomosaic.resample.kernels.few import coordinates_of

    for first in range(0, len(few[0]), AT_ONCE):
        down, along = (one[first : first + AT_ONCE] for one in few)
        cols, rows = np.empty((2, len(down)))
        found = pixels_for(coordinates_of(geometry, down, along, size, cols, rows))
        if found is None:
            continue
        place, pixels, known = found
        values, valid = (
            np.zeros((1, len(down), out.shape[2]), dtype=out.dtype),
            np.zeros((1, len(down)), dtype=np.uint8),
        )
        all_valid = np.ones((1, 1), dtype=np.uint8)
        engine.sample(
            kernel, pixels, all_valid if known is None else known, known is not None, cols[None], rows[None], 1, place,
            *ending, values, valid,
        )  # fmt: skip
        seen = valid[0] > 0
        down, along = down[seen], along[seen]
        out[down, along], out_valid[down, along] = values[0, seen], 1
