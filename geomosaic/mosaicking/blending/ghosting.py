"""Ghosting suppressed: no blending where images differ by more than noise, as of moving cars or relief displacement."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.mosaicking.blending.weights import ImageWeight
from geomosaic.resample.agreement import box_of, doubt_of
from geomosaic.resample.engine import Engine
from geomosaic.resample.pyramid import steps
from geomosaic.types import AnyArray, ByteArray, FloatArray

# A mean level needs no more than every eighth pixel.
_SAMPLE_STEP = 8
# Rounding of floating-point values, relative to their size; and the smallest noise whose square float32 still holds.
_RELATIVE_NOISE, _MIN_NOISE = 1e-4, 1e-12


@dataclass(frozen=True)
class ImageValues:
    """Values of an image in some cells of a block, before blending.

    Attributes
    ----------
    share : ImageWeight
    values : array (rows, cols, bands)
    seen : uint8 array (rows, cols)
        Pixels with a value.
    cells : uint8 array (rows, cols)
        Cells of 64 × 64 pixels that were rendered.
    """

    share: ImageWeight
    values: AnyArray
    seen: ByteArray
    cells: ByteArray


def suppress_ghosts(shown: Sequence[ImageValues], engine: Engine, dtype: str, label: AnyArray, total: AnyArray) -> None:
    """Weighted sums of a block, without the contribution of images that differ from a pixel's main image.

    Images are compared in pairs, from nothing but the block itself. Where they agree the sums stay as they are, to the
    bit.

    Parameters
    ----------
    shown : sequence of ImageValues
    engine : Engine
    dtype : str
        Sample type of the values.
    label : array (rows, cols)
        Number of the main image from 1, 0 where none.
    total : array (rows, cols, bands)
        Weighted sums, changed in place.
    """
    if len(shown) < 2:
        return
    pyramid_steps = steps(compiled=bool(engine.block_kernels))
    integers = np.issubdtype(np.dtype(dtype), np.integer)
    levels = [_mean_level(one) for one in shown]
    for at, (one, level) in enumerate(zip(shown, levels, strict=True)):
        for other, other_level in zip(shown[at + 1 :], levels[at + 1 :], strict=True):
            cells = one.cells & other.cells
            if not cells.any():
                continue
            corner, (rows, cols) = box_of(cells)
            moments = np.zeros((5, total.shape[2], rows, cols), dtype=np.float32)
            known = np.zeros((rows, cols), dtype=np.float32)
            engine.compare(one.values, other.values, one.seen, other.seen, level, cells, corner, moments, known)
            least = (
                0.5 if integers else max(_RELATIVE_NOISE * max(_magnitude(level), _magnitude(other_level)), _MIN_NOISE)
            )
            doubt = doubt_of(moments, known, level, least, pyramid_steps)
            if doubt is None:
                continue
            a, b = one.share, other.share
            engine.deghost(
                one.values, other.values, one.seen, other.seen, a.weight, b.weight, a.factor, a.margin,
                (a.index + 1, b.index + 1), cells, corner, doubt, label, total,
            )  # fmt: skip


def _magnitude(level: FloatArray) -> float:
    return float(np.abs(level).mean())


def _mean_level(one: ImageValues) -> FloatArray:
    some = one.seen[::_SAMPLE_STEP, ::_SAMPLE_STEP] > 0
    values = one.values[::_SAMPLE_STEP, ::_SAMPLE_STEP][some]
    return values.mean(axis=0, dtype=np.float64) if len(values) else np.zeros(one.values.shape[2])
