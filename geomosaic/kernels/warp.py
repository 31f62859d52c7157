"""Compiled kernels of resampling: blocks of output pixels filled from a window of an image.

The C++ stands in `warp.cpp`, `sampling.hpp` (methods) and `coordinates.hpp` (places between the nodes of a lattice).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from geomosaic.kernels.library import native
from geomosaic.types import AnyArray, BoolArray, ByteArray, FloatArray, IntArray

# The order is that of `Method` in sampling.hpp.
METHODS = ("nearest", "bilinear", "cubic", "lanczos")
_GEOMETRY, _IMAGE, _ENDING = "ddsffii", "auifffffi", "ddffiau"
_warp = native("warp", _GEOMETRY + "iiu" + _IMAGE + _ENDING)
_sample = native("sample", "dd" + _IMAGE + _ENDING)
_coordinates = native("coordinates", _GEOMETRY + "iiiiuddl")
_coordinates_of_pixels = native("coordinates_of_pixels", _GEOMETRY + "iillddl")
_list_pixels = native("list_pixels", "uull")
_ALL_VALID = np.ones((1, 1), dtype=np.uint8)

# First column, first row, last column and last row of the image pixels that some output pixels fall in.
Span = tuple[int, int, int, int]


class Geometry(NamedTuple):
    """Place of a block's pixels in the image and its height patch.

    Attributes
    ----------
    nodes : array (ny, nx, 8)
        Cubic coefficients in height, see `sensor.lattice.Lattice`.
    places : array (ny, nx, 2)
        Node positions in the height patch; (0, 0) is the centre of the first height.
    heights : float32 array
        The patch, metres; NaN where unknown.
    z_middle, z_inverse : float
        Centre of the range of heights, and the inverse of half of it.
    flat : bool
        Whether heights play no part.
    step : int
        Output pixels between nodes.
    """

    nodes: FloatArray
    places: FloatArray
    heights: AnyArray
    z_middle: float
    z_inverse: float
    flat: bool
    step: int


class Pixels(NamedTuple):
    """Window of an image, with what is known of its place.

    Attributes
    ----------
    values : array (rows, cols, bands)
        Interleaved by pixel or, in planes of contiguous rows, by band.
    valid : uint8 array (rows, cols) or None
        None where every pixel is valid.
    col, row : int
        First column and row in the image.
    shrink : int
        Reduction on reading, a power of two.
    size : (int, int)
        Width and height of the image.
    """

    values: AnyArray
    valid: ByteArray | None
    col: int
    row: int
    shrink: int
    size: tuple[int, int]

    def _arguments(self, method: str) -> tuple[object, ...]:
        valid = _ALL_VALID if self.valid is None else self.valid
        place = self.col, self.row, self.shrink, *self.size
        return self.values, valid, self.valid is not None, *place, METHODS.index(method)


class OutputScaling(NamedTuple):
    """What happens to values before they are stored: value · gain + offset, rounded into a range.

    Attributes
    ----------
    gain, offset : array (bands,)
    low, high : float
        Range of the output's type.
    whole : bool
        Whether values are rounded, halves up.
    """

    gain: FloatArray
    offset: FloatArray
    low: float
    high: float
    whole: bool


def warp(
    geometry: Geometry,
    start: int,
    n: int,
    need: ByteArray,
    pixels: Pixels,
    method: str,
    ending: OutputScaling,
    out: AnyArray,
    out_valid: ByteArray,
) -> int:
    """Rows of a block, placed and sampled, from `start` on.

    Parameters
    ----------
    geometry : Geometry
    start : int
        First row of the block that is wanted.
    n : int
        Samples per output pixel along each axis; their mean is taken where at least half of them are seen.
    need : uint8 array (rows / 64, cols / 64)
        Cells of 64 x 64 output pixels that are wanted.
    pixels : Pixels
    method : str
        One of `METHODS`.
    ending : OutputScaling
    out : array (rows, cols, bands)
        Only seen pixels are written.
    out_valid : uint8 array (rows, cols)
        Set to 1 where the image is seen.

    Returns
    -------
    int
        First row that reaches beyond the window; the number of rows if none does.
    """
    return _warp(*geometry, start, n, need, *pixels._arguments(method), *ending, out, out_valid)


def sample(
    cols: FloatArray,
    rows: FloatArray,
    pixels: Pixels,
    method: str,
    ending: OutputScaling,
    out: AnyArray,
    out_valid: ByteArray,
) -> None:
    """Values at image coordinates, where the image is seen.

    Parameters
    ----------
    cols, rows : array (R, C)
        (0.5, 0.5) is the centre of the first pixel of the image; NaN where not wanted.
    pixels, method, ending
        As `warp` has them.
    out : array (R, C, bands)
    out_valid : uint8 array (R, C)
    """
    places = np.ascontiguousarray(cols), np.ascontiguousarray(rows)
    _sample(*places, *pixels._arguments(method), *ending, out, out_valid)


def coordinates(
    geometry: Geometry, start: int, n: int, size: tuple[int, int], need: ByteArray, cols: FloatArray, rows: FloatArray
) -> Span:
    """Image coordinates of the sub-pixels of output rows, and the image pixels that they span.

    Parameters
    ----------
    geometry : Geometry
    start : int
        First output row.
    n : int
        Sub-pixels per output pixel along each axis.
    size : (int, int)
        Width and height of the image.
    need : uint8 array (rows / 64, cols / 64)
        Cells that are wanted; the others are left NaN.
    cols, rows : array (R·n, C·n)
        Filled.

    Returns
    -------
    first col, first row, last col, last row : int
        Of those that fall in the image; last col is −1 where none does.
    """
    span = np.empty(4, dtype=np.int64)
    _coordinates(*geometry, start, n, *size, need, cols, rows, span)
    return int(span[0]), int(span[1]), int(span[2]), int(span[3])


def coordinates_of_pixels(
    geometry: Geometry, down: IntArray, along: IntArray, size: tuple[int, int], cols: FloatArray, rows: FloatArray
) -> Span:
    """Image coordinates of single output pixels of a block, and the image pixels that they span.

    Parameters
    ----------
    geometry, size
        As `coordinates` has them.
    down, along : int64 array (N,)
        Rows and columns of the pixels.
    cols, rows : array (N,)
        Filled with what `coordinates` gives these pixels.

    Returns
    -------
    first col, first row, last col, last row : int
        As of `coordinates`.
    """
    span = np.empty(4, dtype=np.int64)
    _coordinates_of_pixels(*geometry, *size, down, along, cols, rows, span)
    return int(span[0]), int(span[1]), int(span[2]), int(span[3])


def list_pixels(only: BoolArray, need: ByteArray, number: int) -> tuple[IntArray, IntArray]:
    """Rows and columns of the wanted pixels of wanted cells.

    Parameters
    ----------
    only : bool array (rows, cols)
        Pixels that are wanted.
    need : uint8 array (rows / 64, cols / 64)
        Cells that are wanted.
    number : int
        Wanted pixels at most.

    Returns
    -------
    down, along : int64 array (N,)
    """
    down, along = np.empty((2, number), dtype=np.int64)
    number = _list_pixels(only, need, down, along)
    return down[:number], along[:number]
