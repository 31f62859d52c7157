"""Engines of resampling: compiled kernels with their fast paths, or the NumPy twins for jobs too small to compile for.

Both give the same bytes, so results never depend on the choice, and tests hold one against the other. An ortho of 512 x
512 pixels takes 0.89 s of processor time by NumPy and 1.15 s by compiled kernels (medians of 7 pairs of whole
processes).
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from geomosaic.geo.grid import Window
from geomosaic.options.render import CELL
from geomosaic.types import AnyArray, BoolArray, ByteArray, IntArray


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
        """Part of the block, with its own wanted cells."""
        only = None if self.only is None else self.only[rows, cols]
        return Target(self.values[rows, cols], self.valid[rows, cols], need, only)


@dataclass(frozen=True, eq=False)
class Engine:
    """Engine of resampling: the kernels, compiled or in NumPy; both give the same bytes.

    Attributes
    ----------
    coordinates, sample : callable
        Kernels; see the modules of `resample.kernels`.
    block_kernels : mapping of str to callable
        By resampling, kernels that place and sample a whole block of three bands of eight bits at once; "bilinear,
        inner" is one whose taps all exist, without heights or correction.
    block_threads : int
        Threads that share one block.
    """

    coordinates: Callable[..., tuple[float, float, float, float]]
    sample: Callable[..., None]
    block_kernels: Mapping[str, Callable[..., int]]
    block_threads: int = 1

    def threads(self, most: int) -> int:
        """Threads that are worth starting: NumPy's small steps would only wait for each other."""
        return most if self.block_kernels else 1

    def share(self, work: Callable[[int], None], pieces: Sequence[int]) -> None:
        """Do pieces of work that touch nothing in common."""
        if self.block_threads == 1 or len(pieces) == 1:
            for piece in pieces:
                work(piece)
            return
        from concurrent.futures import ThreadPoolExecutor

        with ThreadPoolExecutor(self.block_threads) as executor:
            list(executor.map(work, pieces))


def numpy_engine(block_threads: int = 1) -> Engine:
    """Engine of NumPy kernels: nothing to start, slow on large jobs.

    Parameters
    ----------
    block_threads : int
        Threads that share one block.

    Returns
    -------
    Engine
    """
    from geomosaic.resample import reference

    return Engine(reference.coordinates, reference.sample, {}, block_threads)


def numba_engine() -> Engine:
    """Engine of compiled kernels."""
    from geomosaic.resample.kernels import image_coordinates, sample

    return Engine(
        image_coordinates.coordinates,
        sample.sample,
        {
            "bilinear": image_coordinates.bilinear_rgb,
            "cubic": image_coordinates.cubic_rgb,
            "bilinear, inner": sample.bilinear_rgb_inner,
        },
    )


# Samples that NumPy has taken by the time the compiled kernels have started, measured.
_WHILE_STARTING = {
    "nearest": 5_000_000,
    "bilinear": 5_000_000,
    "average": 1_500_000,
    "cubic": 700_000,
    "lanczos": 500_000,
}


def started() -> bool:
    """Whether this process has compiled kernels at hand, or is loading them."""
    return "geomosaic.resample.kernels.image_coordinates" in sys.modules


def engine_for(samples: int, resampling: str, block_threads: int = 1) -> Engine:
    """Engine for an amount of work; NumPy's where it is done before compiled kernels have started.

    Parameters
    ----------
    samples : int
        Samples that the whole job takes.
    resampling : str
        One of `RESAMPLING`.
    block_threads : int
        Threads that share one block, where the work is little.

    Returns
    -------
    Engine
    """
    return numba_engine() if samples > _WHILE_STARTING[resampling] else numpy_engine(block_threads)


# Gain and offset per band, lowest and highest value, and whether values are rounded.
Ending = tuple[Any, Any, float, float, bool]


def fill_rgb(
    engine: Engine,
    kernel: str,
    geometry: tuple[Any, ...],
    size: tuple[int, int],
    source: AnyArray,
    window: Window,
    ending: Ending,
    target: Target,
) -> int:
    """Fill a block from the `window` of an image; returns the first row that is not filled, its height if all are.

    Parameters
    ----------
    engine : Engine
        With block kernels.
    kernel : str
        'bilinear' or 'cubic'.
    geometry : tuple
        See `warp.Geometry`.
    size : tuple of int
        Width and height of the image.
    source : uint8 array (rows, cols, 3)
        What the window shows, all of it valid.
    ending : tuple
        What happens to values before they are written.
    target : Target
        Three bands, with the wanted cells.
    """
    corner, out, out_valid = (window.col, window.row), target.values, target.valid
    need = target.need
    assert need is not None  # `warp` names the cells of every part
    careful = engine.block_kernels[kernel]
    if not (kernel == "bilinear" and geometry[5] and _unchanged(ending) and out.dtype == np.uint8):
        return int(careful(geometry, size, need, source, corner, ending, out, out_valid))
    inner = _inner(geometry, need, source, window)
    per, height = CELL // geometry[6], int(out.shape[0])
    parts = [(0, need.shape[0], 0, need.shape[1])]
    while parts:
        top, bottom, left, right = parts.pop()
        rows, cols = slice(top * CELL, bottom * CELL), slice(left * CELL, right * CELL)
        here, wanted = inner[top:bottom, left:right], np.ascontiguousarray(need[top:bottom, left:right])
        nodes = np.ascontiguousarray(geometry[0][top * per : bottom * per + 1, left * per : right * per + 1])
        if here.all():
            part = out[rows, cols]
            line = np.empty((part.shape[0], 3 * part.shape[1]), dtype=np.uint8)
            engine.block_kernels["bilinear, inner"](nodes, geometry[6], source, corner, line)
            part[...], out_valid[rows, cols] = line.reshape(part.shape), 1
        elif not here.any() or (bottom - top == 1 and right - left == 1):
            if wanted.any():
                done = careful(
                    (nodes, *geometry[1:]), size, wanted, source, corner, ending, out[rows, cols], out_valid[rows, cols]
                )
                if done < out_valid[rows, cols].shape[0]:
                    return 0
        elif bottom - top >= right - left:
            middle = (top + bottom) // 2
            parts += [(middle, bottom, left, right), (top, middle, left, right)]
        else:
            middle = (left + right) // 2
            parts += [(top, bottom, middle, right), (top, bottom, left, middle)]
    return height


def _unchanged(ending: Ending) -> bool:
    return bool((ending[0] == 1.0).all() and (ending[1] == 0.0).all())


def _inner(geometry: tuple[Any, ...], need: ByteArray, source: AnyArray, window: Window) -> BoolArray:
    """Cells (rows, cols) that are wanted and all four taps of whose every pixel are in the window."""
    places = geometry[0][..., ::4] - (window.col, window.row)
    ends = source.shape[1] - 1.0, source.shape[0] - 1.0
    here = ((places >= 1.0) & (places < ends)).all(axis=-1)  # what lies between nodes is within them
    per = CELL // geometry[6]
    for axis in (0, 1):
        starts = np.arange(0, here.shape[axis] - 1, per)
        last = here.take(np.minimum(starts + per, here.shape[axis] - 1), axis=axis)
        here = np.logical_and.reduceat(here, starts, axis=axis) & last
    found: BoolArray = here & (need > 0)
    return found


# Of the pixels of wanted cells, below which each is taken for itself.
SHARE = 0.3
AT_ONCE = 65536


def wanted_pixels(engine: Engine, only: BoolArray, need: ByteArray, n: int) -> tuple[IntArray, IntArray] | None:
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
    if n > 1 or not engine.block_kernels:
        return None
    number = int(np.count_nonzero(only))
    if number > SHARE * CELL**2 * np.count_nonzero(need):
        return None
    from geomosaic.resample.kernels.pixel_list import listed

    down, along = np.empty((2, number), dtype=np.int64)
    number = listed(only, need, down, along)
    return down[:number], along[:number]


def fill_pixels(
    engine: Engine,
    kernel: str,
    geometry: tuple[Any, ...],
    size: tuple[int, int],
    few: tuple[IntArray, IntArray],
    pixels_for: Callable[[tuple[float, ...]], tuple[tuple[float, ...], AnyArray, ByteArray | None] | None],
    ending: tuple[Any, ...],
    target: Target,
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
    target : Target
    """
    from geomosaic.resample.kernels.pixel_list import coordinates_of

    out, out_valid = target.values, target.valid

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
