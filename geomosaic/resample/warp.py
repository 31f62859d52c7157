"""Pull one block of output pixels out of one image."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from geomosaic.errors import InputError
from geomosaic.geo.grid import Window
from geomosaic.sensor.lattice import FIRST_STEP, Lattice
from geomosaic.surface.model import HeightPatch
from geomosaic.types import AnyArray, ByteArray, FloatArray

RESAMPLING = ("nearest", "bilinear", "cubic", "lanczos", "average")
RADIUS = {"nearest": 1, "bilinear": 1, "cubic": 2, "lanczos": 3, "average": 1}

CELL = FIRST_STEP

# Beyond this many image pixels per output pixel the image is reduced while it is read.
MOST_SAMPLES = 16
# Image pixels read at once; larger windows are read strip by strip.
MOST_PIXELS = 6_000_000
# Sub-pixels handled at once: their coordinates stay in a processor's second-level cache.
STRIP = 65536


class Reader(Protocol):
    """Reads a window of an image: `raster.source.Source`, or an array in tests."""

    def read(self, window: Window, shrink: int = 1) -> tuple[AnyArray, ByteArray | None]:
        """Values (rows, cols, bands) and validity (rows, cols), None where all are valid."""


@dataclass(frozen=True)
class Engine:
    """Where the kernels come from; both engines give the same bytes."""

    coordinates: Callable[..., tuple[float, float, float, float]]
    sample: Callable[..., None]
    accumulate: Callable[..., None]
    finish: Callable[..., None]


def numpy_engine() -> Engine:
    """Kernels in NumPy: nothing to start, slow on large jobs."""
    from geomosaic.resample import reference

    return Engine(reference.coordinates, reference.sample, reference.accumulate, reference.finish)


def numba_engine() -> Engine:
    """Compiled kernels."""
    from geomosaic.resample import kernels

    table: dict[str, Callable[..., None]] = {
        "nearest": kernels.sample_nearest,
        "bilinear": kernels.sample_bilinear,
        "cubic": kernels.sample_cubic,
        "lanczos": kernels.sample_lanczos,
    }

    quick: dict[str, Callable[..., None]] = {"bilinear": kernels.bilinear_rgb, "cubic": kernels.cubic_rgb}

    def sample(
        name: str, source: AnyArray, valid: AnyArray, masked: bool, cols: FloatArray, rows: FloatArray, n: int,
        place: tuple[float, float, float, int, int], gain: FloatArray, offset: FloatArray,
        low: float, high: float, whole: bool, out: AnyArray, out_valid: ByteArray,
    ) -> None:  # fmt: skip
        rgb = source.dtype == np.uint8 and source.shape[2] == 3 and source.flags.c_contiguous
        if rgb and not masked and n == 1 and name in quick:
            quick[name](source, cols, rows, place, gain, offset, low, high, whole, out, out_valid)
        else:
            table[name](source, valid, masked, cols, rows, n, place, gain, offset, low, high, whole, out, out_valid)

    return Engine(kernels.coordinates, sample, kernels.accumulate, kernels.finish)


def engine_for(pixels: int) -> Engine:
    """Choose by the work to do: starting the compiled kernels costs as much as about 1.5 million pixels in NumPy."""
    return numba_engine() if pixels > 1_500_000 else numpy_engine()


@dataclass(frozen=True)
class Colour:
    """Linear correction of values, per band: value · gain + offset."""

    gain: FloatArray
    offset: FloatArray

    @classmethod
    def identity(cls, bands: int) -> Colour:
        """Leave values as they are."""
        return cls(np.ones(bands), np.zeros(bands))


def value_range(dtype: str) -> tuple[float, float, bool]:
    """Lowest and highest value of an output type, and whether it holds whole numbers."""
    if np.issubdtype(np.dtype(dtype), np.integer):
        info = np.iinfo(dtype)
        return float(info.min), float(info.max), True
    return -math.inf, math.inf, False


def supersampling(resampling: str, scale: float, most: int = MOST_SAMPLES) -> tuple[int, int]:
    """Samples per output pixel along each axis, and reduction on reading, at `scale` image pixels per output pixel.

    One sample serves up to 1.5 image pixels; beyond, bilinear samples about one image pixel apart are averaged, which
    is the mean over the pixel's footprint. 'nearest' is for classes and never averages.
    """
    if resampling == "nearest" or not math.isfinite(scale):
        return 1, 1
    shrink = 1
    while scale / shrink > most:
        shrink *= 2
    scale = scale / shrink
    return (1 if scale <= 1.5 else math.ceil(scale - 1e-6)), shrink


def warp(
    engine: Engine,
    reader: Reader,
    size: tuple[int, int],
    lattice: Lattice,
    patch: HeightPatch | None,
    resampling: str,
    colour: Colour,
    out: AnyArray,
    out_valid: ByteArray,
    need: ByteArray | None = None,
    most_samples: int | None = None,
) -> None:
    """Fill one block.

    Parameters
    ----------
    engine : Engine
    reader : Reader
        The image.
    size : tuple of int
        Width and height of the image in pixels.
    lattice : Lattice
        Of this block and image.
    patch : HeightPatch or None
        Heights over the block; None where they play no part.
    resampling : str
        One of `RESAMPLING`.
    colour : Colour
        Applied to values before they are rounded.
    out : array (rows, cols, bands)
        Of the block's size; only seen pixels are written.
    out_valid : uint8 array (rows, cols)
        Set to 1 where the image is seen.
    need : uint8 array (rows / 64, cols / 64), optional
        Cells of 64 x 64 pixels that are wanted; all unless given.
    most_samples : int, optional
        Image pixels per output pixel beyond which the image is reduced on reading.
    """
    if resampling not in RESAMPLING:
        raise InputError(f"no resampling named '{resampling}'", mend=f"use one of {', '.join(RESAMPLING)}")
    n, shrink = supersampling(resampling, lattice.scale, most_samples or MOST_SAMPLES)
    wanted = _cells(lattice) if need is None else need & _cells(lattice)
    if not wanted.any():
        return
    kernel = "bilinear" if resampling == "average" or n > 1 else resampling
    low, high, whole = value_range(str(out.dtype))
    flat = lattice.flat and (patch is None or not np.isnan(patch.heights).any())
    z_inverse = 0.0 if lattice.z_half == 0.0 else 1.0 / lattice.z_half
    if flat or patch is None:
        flat, places, heights = True, np.zeros((*lattice.nodes.shape[:2], 2)), np.zeros((1, 1), dtype=np.float32)
    else:
        t = patch.transform
        x, y = lattice.surface[..., 0], lattice.surface[..., 1]
        places = np.stack([t.a * x + t.b * y + t.c - 0.5, t.d * x + t.e * y + t.f - 0.5], axis=-1)
        heights = patch.heights
    reach = (RADIUS[kernel] + 1) * shrink
    whole_block = _window(lattice.bounds, size, reach, shrink)
    at_once = whole_block is not None and whole_block.width * whole_block.height <= MOST_PIXELS * shrink * shrink
    window: Window | None = None
    source, valid = np.empty((0, 0, 0)), None
    rows_at_once = max(1, STRIP // (lattice.window.width * n * n))
    buffer = np.empty((2, rows_at_once * n, lattice.window.width * n))
    for start in range(0, lattice.window.height, rows_at_once):
        stop = min(start + rows_at_once, lattice.window.height)
        cols, rows = buffer[0, : (stop - start) * n], buffer[1, : (stop - start) * n]
        span = engine.coordinates(
            lattice.nodes, places, heights, lattice.z_middle, z_inverse, flat, lattice.step, start, n, size, wanted,
            cols, rows,
        )  # fmt: skip
        needed = _window(span, size, reach, shrink)
        if needed is None:
            continue
        if window is None or needed.intersection(window) != needed:
            # The block's window is read once; where it is too large, or its bounds fell short, the strip's.
            inside = whole_block is not None and needed.intersection(whole_block) == needed
            window = whole_block if at_once and inside and whole_block is not None else needed
            source, valid = reader.read(window, shrink)
        place = (float(window.col), float(window.row), float(shrink), size[0], size[1])
        mask = _ALL_VALID if valid is None else valid
        engine.sample(
            kernel, source, mask, valid is not None, cols, rows, n, place, colour.gain, colour.offset,
            low, high, whole, out[start:stop], out_valid[start:stop],
        )  # fmt: skip


_ALL_VALID = np.ones((1, 1), dtype=np.uint8)


def _cells(lattice: Lattice) -> ByteArray:
    """Cells of 64 x 64 output pixels that may show the image."""
    per = CELL // lattice.step
    rows, cols = -(-lattice.window.height // CELL), -(-lattice.window.width // CELL)
    padded = np.zeros((rows * per, cols * per), dtype=np.uint8)
    padded[: lattice.seen.shape[0], : lattice.seen.shape[1]] = lattice.seen
    seen: ByteArray = padded.reshape(rows, per, cols, per).max(axis=(1, 3))
    return seen


def _window(span: tuple[float, float, float, float], size: tuple[int, int], reach: int, shrink: int) -> Window | None:
    """Image window for points that span left, top, right, bottom, on multiples of `shrink`; None where all miss."""
    (left, top, right, bottom), (width, height) = span, size
    if not (right >= 0 and bottom >= 0 and left < width and top < height):
        return None
    first_col = int(max(0.0, left - reach)) // shrink * shrink
    first_row = int(max(0.0, top - reach)) // shrink * shrink
    last_col = min(width, -(-int(min(float(width), right + 1 + reach)) // shrink) * shrink)
    last_row = min(height, -(-int(min(float(height), bottom + 1 + reach)) // shrink) * shrink)
    return Window(first_col, first_row, last_col - first_col, last_row - first_row)
