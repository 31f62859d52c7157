"""Blending limited where images disagree: no ghosts of what moved, or leans another way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.mosaicking.blending.weights import Share
from geomosaic.resample.agreement import box_of, doubt_of
from geomosaic.resample.engine import Engine
from geomosaic.resample.pyramid import steps
from geomosaic.types import AnyArray, ByteArray, FloatArray

_SPARSE = 8
"""Every so many pixels serve for a mean level."""
_PART, _LEAST = 1e-4, 1e-12
"""Of the values of floating point, differences of rounding; and the least such, whose square 32 bits still hold."""


@dataclass(frozen=True)
class Shown:
    """What an image shows of a block: values (rows, cols, bands) and where they are seen, of some cells."""

    share: Share
    values: AnyArray
    seen: ByteArray
    cells: ByteArray


def limit(shown: Sequence[Shown], engine: Engine, dtype: str, label: AnyArray, total: AnyArray) -> None:
    """Take back, from a block's weighted sums, what other images show differently than that of a pixel.

    Images are judged by pairs, from nothing but the block itself. What they show alike stays as it is, to the bit.
    """
    if len(shown) < 2:
        return
    by = steps(compiled=bool(engine.block_kernels))
    whole = np.issubdtype(np.dtype(dtype), np.integer)
    levels = [_level(one) for one in shown]
    for at, (one, level) in enumerate(zip(shown, levels, strict=True)):
        for other, other_level in zip(shown[at + 1 :], levels[at + 1 :], strict=True):
            cells = one.cells & other.cells
            if not cells.any():
                continue
            corner, (rows, cols) = box_of(cells)
            moments = np.zeros((5, total.shape[2], rows, cols), dtype=np.float32)
            known = np.zeros((rows, cols), dtype=np.float32)
            engine.compare(one.values, other.values, one.seen, other.seen, level, cells, corner, moments, known)
            least = 0.5 if whole else max(_PART * max(_size(level), _size(other_level)), _LEAST)
            doubt = doubt_of(moments, known, level, least, by)
            if doubt is None:
                continue
            a, b = one.share, other.share
            engine.deghost(
                one.values, other.values, one.seen, other.seen, a.weight, b.weight, a.factor, a.margin,
                (a.index + 1, b.index + 1), cells, corner, doubt, label, total,
            )  # fmt: skip


def _size(level: FloatArray) -> float:
    return float(np.abs(level).mean())


def _level(one: Shown) -> FloatArray:
    some = one.seen[::_SPARSE, ::_SPARSE] > 0
    values = one.values[::_SPARSE, ::_SPARSE][some]
    return values.mean(axis=0, dtype=np.float64) if len(values) else np.zeros(one.values.shape[2])
