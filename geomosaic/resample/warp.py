"""Warp of one image into one block of output pixels."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from geomosaic.errors import InputError
from geomosaic.geo.grid import Window
from geomosaic.kernels import warp as kernels
from geomosaic.kernels.warp import Geometry, OutputScaling, Pixels, Span
from geomosaic.options.render import CELL, RESAMPLING
from geomosaic.sensor.lattice import Lattice
from geomosaic.surface.model import HeightPatch
from geomosaic.types import AnyArray, BoolArray, ByteArray, FloatArray, IntArray

RADIUS = {"nearest": 1, "bilinear": 1, "cubic": 2, "lanczos": 3, "average": 1, "rms": 1}

# Beyond this many image pixels per output pixel the image is reduced while it is read.
MOST_SAMPLES = 16
# The same of squares, which are reduced here and not by what decodes the image.
MOST_SQUARES = 64
# Image pixels read at once, as three bands of eight bits; a block that needs more memory is cut.
MOST_PIXELS = 6_000_000
# Sub-pixels placed at once where a block's window falls short; and single pixels.
STRIP = 65536
# Of the pixels of wanted cells, below which each is taken for itself.
SHARE = 0.3


class Reader(Protocol):
    """Reader of windows of an image: `raster.source.Source`, or an array in tests."""

    def read(self, window: Window, shrink: int = 1) -> tuple[AnyArray, ByteArray | None]:
        """Values (rows, cols, bands) and validity (rows, cols), None where all are valid."""


@dataclass(frozen=True, eq=False)
class Target:
    """Block of output pixels to be filled from an image.

    Attributes
    ----------
    values : array (rows, cols, bands)
        Only seen pixels are written.
    valid : uint8 array (rows, cols)
        Set to 1 where the image is seen.
    need : uint8 array (rows / 64, cols / 64), optional
        Cells of 64 x 64 pixels that are wanted; all unless given.
    only : bool array (rows, cols), optional
        Pixels that are wanted, where they are few; others of the cells may be filled too.
    """

    values: AnyArray
    valid: ByteArray
    need: ByteArray | None = None
    only: BoolArray | None = None

    def part(self, rows: slice, cols: slice, need: ByteArray | None) -> Target:
        """Part of the block, with its own wanted cells.

        Parameters
        ----------
        rows, cols : slice
        need : uint8 array (R, C), optional
            Wanted cells of the part.
        """
        only = None if self.only is None else self.only[rows, cols]
        return Target(self.values[rows, cols], self.valid[rows, cols], need, only)


@dataclass(frozen=True, eq=False)
class Colour:
    """Linear correction of values, per band: value · gain + offset.

    Attributes
    ----------
    gain, offset : array (bands,)
    """

    gain: FloatArray
    offset: FloatArray

    @classmethod
    def identity(cls, bands: int) -> Colour:
        """Correction that leaves values as they are."""
        return cls(np.ones(bands), np.zeros(bands))


def value_range(dtype: str) -> tuple[float, float, bool]:
    """Range of a sample type.

    Parameters
    ----------
    dtype : str

    Returns
    -------
    low, high : float
        Lowest and highest value; infinite for floating point.
    whole : bool
        Whether it holds whole numbers only.
    """
    if np.issubdtype(np.dtype(dtype), np.integer):
        info = np.iinfo(dtype)
        return float(info.min), float(info.max), True
    return -math.inf, math.inf, False


def supersampling(resampling: str, scale: float, most: int = MOST_SAMPLES) -> tuple[int, int]:
    """Samples per output pixel along each axis, and reduction on reading.

    One sample serves up to 1.5 image pixels; beyond, bilinear samples about one image pixel apart are averaged, which
    is the mean over the pixel's footprint. 'nearest' is for classes and never averages.

    Parameters
    ----------
    resampling : str
        One of `RESAMPLING`.
    scale : float
        Image pixels per output pixel.
    most : int
        Image pixels per output pixel beyond which the image is reduced on reading.

    Returns
    -------
    n : int
        Samples along each axis.
    shrink : int
        Power of two by which the image is reduced.
    """
    if resampling == "nearest" or not math.isfinite(scale):
        return 1, 1
    shrink = 1
    while scale / shrink > most:
        shrink *= 2
    scale = scale / shrink
    # 1e-6 keeps a scale of 2 from taking three samples for a rounding.
    return (1 if scale <= 1.5 else math.ceil(scale - 1e-6)), shrink


@dataclass(frozen=True)
class Sampling:
    """Way values are taken from an image.

    Attributes
    ----------
    resampling : str
        One of `RESAMPLING`.
    most : int
        Image pixels per output pixel beyond which the image is reduced on reading.
    """

    resampling: str
    most: int = MOST_SAMPLES


def warp(
    reader: Reader,
    size: tuple[int, int],
    lattice: Lattice,
    patch: HeightPatch | None,
    sampling: Sampling,
    colour: Colour,
    target: Target,
) -> None:
    """Warp of one image into one block of output pixels.

    Parameters
    ----------
    reader : Reader
        The image.
    size : tuple of int
        Width and height of the image in pixels.
    lattice : Lattice
        Of this block and image.
    patch : HeightPatch or None
        Heights over the block; None where they play no part.
    sampling : Sampling
    colour : Colour
        Applied to values before they are rounded.
    target : Target
        Of the block's size.

    Raises
    ------
    InputError
        No resampling of that name.
    """
    resampling = sampling.resampling
    if resampling not in RESAMPLING:
        raise InputError(f"no resampling named '{resampling}'", hint=f"use one of {', '.join(RESAMPLING)}")
    if resampling == "rms":
        _warp_squares(reader, size, lattice, patch, colour, target)
        return
    n, shrink = supersampling(resampling, lattice.scale, sampling.most)
    wanted = _cells(lattice) if target.need is None else target.need & _cells(lattice)
    if not wanted.any():
        return
    kernel = "bilinear" if resampling == "average" or n > 1 else resampling
    # Means of a reduced image come as floats of 32 bits, whatever the image holds.
    each = target.values.shape[2] * (target.values.itemsize if shrink == 1 else max(4, target.values.itemsize))
    most = min(MOST_PIXELS, 3 * MOST_PIXELS // each)
    shape = _Shape(kernel, n, shrink, size, most)
    boxes = _boxes(lattice)
    # Where heights do not move the image they count only if some are unknown, which leaves pixels empty.
    if patch is None or (lattice.flat and not np.isnan(patch.heights).any()):
        places, heights = None, np.zeros((1, 1), dtype=np.float32)
    else:
        t = patch.transform
        x, y = lattice.surface[..., 0], lattice.surface[..., 1]
        places = np.stack([t.a * x + t.b * y + t.c - 0.5, t.d * x + t.e * y + t.f - 0.5], axis=-1)
        heights = patch.heights
    per = CELL // lattice.step
    for rows, cols, window in _parts(boxes, wanted, slice(0, wanted.shape[0]), slice(0, wanted.shape[1]), shape):
        nodes = slice(rows.start * per, rows.stop * per + 1), slice(cols.start * per, cols.stop * per + 1)
        inside = slice(rows.start * CELL, rows.stop * CELL), slice(cols.start * CELL, cols.stop * CELL)
        geometry = Geometry(
            np.ascontiguousarray(lattice.nodes[nodes]),
            np.zeros((1, 1, 2)) if places is None else np.ascontiguousarray(places[nodes]),
            heights,
            lattice.z_middle,
            0.0 if lattice.flat else 1.0 / lattice.z_half,
            places is None,
            lattice.step,
        )
        here = np.ascontiguousarray(wanted[rows, cols])
        part = target.part(*inside, here)
        _fill(_Window(reader, shape, window), geometry, colour, part)


def _warp_squares(
    reader: Reader,
    size: tuple[int, int],
    lattice: Lattice,
    patch: HeightPatch | None,
    colour: Colour,
    target: Target,
) -> None:
    """Warp of the squares of an image, whose roots are the output; see `warp`."""
    # Squares of 16 bits have 32, and a mean of some thousand of them is as good in floats of 32 bits.
    exact = np.float64 if target.values.itemsize > 4 or target.values.dtype.kind == "i" else np.float32
    squares, seen = np.zeros(target.values.shape, dtype=exact), np.zeros_like(target.valid)
    inner = replace(target, values=squares, valid=seen)
    sampling = Sampling("average", MOST_SQUARES)
    warp(_Squares(reader, exact), size, lattice, patch, sampling, Colour.identity(target.values.shape[2]), inner)
    here = seen > 0
    low, high, whole = value_range(str(target.values.dtype))
    values = np.sqrt(squares[here]) * colour.gain + colour.offset
    target.values[here] = np.clip(np.floor(values + 0.5), low, high) if whole else values
    target.valid[here] = 1


@dataclass(frozen=True)
class _Squares:
    """Reader of the squares of an image's values, which are reduced as squares."""

    reader: Reader
    exact: type[np.floating[Any]]

    def read(self, window: Window, shrink: int = 1) -> tuple[AnyArray, ByteArray | None]:
        """Squares (rows, cols, bands) and validity (rows, cols), None where all are valid."""
        if shrink == 1:
            values, valid = self.reader.read(window)
            return np.square(values, dtype=self.exact), valid
        # A strip of rows at a time: the whole window at full resolution may not fit into memory.
        strips = [
            self._reduced(Window(window.col, row, window.width, min(shrink, window.stop_row - row)), shrink)
            for row in range(window.row, window.stop_row, shrink)
        ]
        known = np.concatenate([valid for _, valid in strips])
        return np.concatenate([values for values, _ in strips]), None if known.all() else known

    def _reduced(self, window: Window, shrink: int) -> tuple[AnyArray, ByteArray]:
        """Means of the squares of one row of reduced pixels, and where there are any."""
        values, valid = self.reader.read(window)
        known = np.ones((window.height, window.width), dtype=np.uint8) if valid is None else valid
        weights = (known > 0).astype(self.exact)[..., None]
        columns = np.arange(0, window.width, shrink)
        squares = np.square(values, dtype=self.exact) * weights
        total, count = (np.add.reduceat(each.sum(axis=0), columns, axis=0) for each in (squares, weights))
        means = (total / np.maximum(count, 1.0)).astype(self.exact)
        return means[None], (count[:, 0] > 0.0)[None].astype(np.uint8)


@dataclass(frozen=True)
class _Shape:
    """How values are taken: kernel, samples per output pixel along each axis, reduction; image; pixels read at once."""

    kernel: str
    n: int
    shrink: int
    size: tuple[int, int]
    most: int

    @property
    def reach(self) -> int:
        """Image pixels that the kernel takes beyond a point."""
        return (RADIUS[self.kernel] + 1) * self.shrink


class _Window:
    """What is read of an image for a part of a block, and again where the lattice's nodes promised too little."""

    def __init__(self, reader: Reader, shape: _Shape, window: Window) -> None:
        self.reader, self.shape = reader, shape
        self._read(window)

    def _read(self, window: Window) -> None:
        self.window, shrink = window, self.shape.shrink
        self.pixels = Pixels(*self.reader.read(window, shrink), window.col, window.row, shrink, self.shape.size)

    def covers(self, span: Span) -> bool:
        """Whether any pixel falls in the image; what all of them take is read then."""
        needed = _window(span, self.shape)
        if needed is None:
            return False
        if needed.intersection(self.window) != needed:
            self._read(needed)
        return True


def _fill(image: _Window, geometry: Geometry, colour: Colour, target: Target) -> None:
    """Fill a part of a block whose image window is small enough to be read at once."""
    out, need, shape = target.values, target.need, image.shape
    assert need is not None  # `warp` names the cells of every part
    ending = OutputScaling(colour.gain, colour.offset, *value_range(str(out.dtype)))
    if target.only is not None and shape.n == 1:
        number = int(np.count_nonzero(target.only))
        if number <= SHARE * CELL**2 * np.count_nonzero(need):
            _fill_pixels(image, geometry, ending, target, kernels.list_pixels(target.only, need, number))
            return
    height, width = target.valid.shape
    strip = max(1, STRIP // (width * shape.n**2))
    done = 0
    while True:
        done = kernels.warp(
            geometry, done, shape.n, need, image.pixels, shape.kernel, ending, out, target.valid
        )  # fmt: skip
        if done == height:
            return
        rows = min(strip, height - done)
        places = np.empty((2, rows * shape.n, width * shape.n))
        image.covers(kernels.coordinates(geometry, done, shape.n, shape.size, need, *places))


def _fill_pixels(
    image: _Window, geometry: Geometry, ending: OutputScaling, target: Target, pixels: tuple[IntArray, IntArray]
) -> None:
    """Fill some pixels of a block, given by their rows and columns; the bytes are those of the whole."""
    out, shape = target.values, image.shape
    for first in range(0, len(pixels[0]), STRIP):
        down, along = (one[first : first + STRIP] for one in pixels)
        cols, rows = np.empty((2, len(down)))
        if not image.covers(kernels.coordinates_of_pixels(geometry, down, along, shape.size, cols, rows)):
            continue
        values = np.empty((1, len(down), out.shape[2]), dtype=out.dtype)
        valid = np.zeros((1, len(down)), dtype=np.uint8)
        kernels.sample(cols[None], rows[None], image.pixels, shape.kernel, ending, values, valid)
        seen = valid[0] > 0
        down, along = down[seen], along[seen]
        out[down, along], target.valid[down, along] = values[0, seen], 1


def _cells(lattice: Lattice) -> ByteArray:
    """Cells of 64 x 64 output pixels that may show the image."""
    per = CELL // lattice.step
    rows, cols = -(-lattice.window.height // CELL), -(-lattice.window.width // CELL)
    padded = np.zeros((rows * per, cols * per), dtype=np.uint8)
    padded[: lattice.seen.shape[0], : lattice.seen.shape[1]] = lattice.seen
    seen: ByteArray = padded.reshape(rows, per, cols, per).max(axis=(1, 3))
    return seen


def _boxes(lattice: Lattice) -> FloatArray:
    """Left, top, −right, −bottom (4, rows, cols) of each cell of 64 x 64 pixels in the image; infinite where unseen."""
    per = CELL // lattice.step
    both = np.moveaxis(
        np.concatenate([lattice.levels, -lattice.levels], axis=-1), -1, 0
    )  # (4, levels, node rows, node cols)
    least = np.fmin.reduce(both, axis=1)
    for axis in (1, 2):
        starts = np.arange(0, least.shape[axis] - 1, per)
        first = np.fmin.reduceat(least, starts, axis=axis)
        last = least.take(np.minimum(starts + per, least.shape[axis] - 1), axis=axis)
        least = np.fmin(first, last)
    return np.where(np.isnan(least), np.inf, least)


def _parts(
    boxes: FloatArray, wanted: ByteArray, rows: slice, cols: slice, shape: _Shape
) -> Iterator[tuple[slice, slice, Window]]:
    """Cut cells in halves until the image window of what is wanted is small enough; parts without any are left out."""
    here = wanted[rows, cols] > 0
    if not here.any():
        return
    left, top, right, bottom = boxes[:, rows, cols][:, here].min(axis=1)
    window = _window((left, top, -right, -bottom), shape)
    if window is None:
        return
    tall, wide = rows.stop - rows.start, cols.stop - cols.start
    if window.width * window.height <= shape.most * shape.shrink**2 or (tall == 1 and wide == 1):
        yield rows, cols, window
    elif tall >= wide:
        middle = rows.start + tall // 2
        yield from _parts(boxes, wanted, slice(rows.start, middle), cols, shape)
        yield from _parts(boxes, wanted, slice(middle, rows.stop), cols, shape)
    else:
        middle = cols.start + wide // 2
        yield from _parts(boxes, wanted, rows, slice(cols.start, middle), shape)
        yield from _parts(boxes, wanted, rows, slice(middle, cols.stop), shape)


def _window(span: tuple[float, ...], shape: _Shape) -> Window | None:
    """Image window for points that span left, top, right, bottom, on multiples of the reduction; None if all miss."""
    (left, top, right, bottom), (width, height) = span, shape.size
    reach, shrink = shape.reach, shape.shrink
    if not (right >= 0 and bottom >= 0 and left < width and top < height):
        return None
    first_col = int(max(0.0, left - reach)) // shrink * shrink
    first_row = int(max(0.0, top - reach)) // shrink * shrink
    last_col = min(width, -(-int(min(float(width), right + 1 + reach)) // shrink) * shrink)
    last_row = min(height, -(-int(min(float(height), bottom + 1 + reach)) // shrink) * shrink)
    return Window(first_col, first_row, last_col - first_col, last_row - first_row)
