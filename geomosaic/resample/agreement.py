"""Agreement of two images of the same ground: cars that moved, houses that lean the other way.

The difference D = a − b of two images that meet at a seam is, where both show the same, a matter of light: slow, and in
proportion to brightness at most, D ≈ m + g·(A − level), with A the mean of both, m a mean over about 32 pixels around
and g one number per band. What is farther from that than images of this ground are as a rule stands out. There the
image that a pixel belongs to is shown alone, with what D would be by light; so that colours still pass into each other,
and nothing of the other image shines through.

Looked at are samples of 4 × 4 pixels, by the mean square over their quarters of 2 × 2. The rule is the median of the
mean squares at this seam.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from geomosaic.kernels.library import native
from geomosaic.options.render import CELL
from geomosaic.resample.pyramid import ascend, descend, expand, filled, reduce
from geomosaic.types import AnyArray, ByteArray, Float32Array, FloatArray

_compare = native("compare", "aauuduiiss")
_deghost = native("deghost", "aauussiiiiuiiddddaa")

# As in agreement.cpp.
SAMPLE = 4
PER = CELL // SAMPLE
# Levels over which the mean is taken, 32 pixels; and beyond which it is looked for where all around stands out.
LEVELS, MORE = 3, 2
# Samples of which rows and columns must be multiples.
ALIGNED = 1 << (LEVELS + MORE)
ROUNDS = 3
# Times the usual difference; what differs by 0.8 times as much is blended fully, by 1.6 times not at all.
TOLERATED = 3.0
# Squares of these multiples, since mean squares are compared: √0.7 ≈ 0.8, √2.5 ≈ 1.6.
_BLENDED, _NOT = 0.7, 2.5
_STEEPEST = 0.5


class Mismatch(NamedTuple):
    """Places where two images show different things, and the difference that light alone makes.

    Attributes
    ----------
    share : array (rows, cols)
        Of samples: 0 where they show the same, 1 where they do not.
    mean : array (bands, rows, cols)
        m of the module's text.
    slope, level : array (bands,)
        g, and the level that brightness is counted from.
    """

    share: FloatArray
    mean: FloatArray
    slope: FloatArray
    level: FloatArray


def mismatch_of(moments: Float32Array, known: Float32Array, level: FloatArray, least: float) -> Mismatch | None:
    """Samples where two images show different things; None where all that is known shows the same.

    Parameters
    ----------
    moments : float32 array (5, bands, rows, cols)
        Of `compare`; rows and columns multiples of `ALIGNED`.
    known : float32 array (rows, cols)
        1 where there are moments, else 0.
    level : array (bands,)
        Grey value that brightness is counted from, as in `compare`.
    least : float
        Difference that always counts as usual: rounding.
    """
    some = known > 0
    if not some.any():
        return None
    weight, (d, s, dd, ds, ss) = known[None], moments
    bands = len(d)
    both, slope = np.concatenate([d, s]), np.zeros(bands)
    trusted: AnyArray = weight
    around = np.maximum(expand(reduce(weight)), np.float32(1e-6))
    for number in range(ROUNDS):
        mean = _means(both, trusted)
        mean_d, mean_s = mean[:bands], mean[bands:]
        if number:
            x = s - mean_s
            spread = (trusted * x * x).sum(axis=(1, 2), dtype=np.float64) + known.sum(dtype=np.float64) * least**2
            slope = (trusted * x * (d - mean_d)).sum(axis=(1, 2), dtype=np.float64) / spread
            # Over even ground brightness hardly varies, and the slope would follow noise.
            slope = np.clip(slope, -_STEEPEST, _STEEPEST)
        g = slope.astype(np.float32)[:, None, None]
        centre = mean_d - g * mean_s
        off = dd - 2 * g * ds + g * g * ss - 2 * centre * (d - g * s) + centre * centre
        square = np.maximum(off.mean(axis=0, keepdims=True), 0) * weight
        # The median, so that what stands out does not raise the measure by which it is judged.
        usual = max(float(np.median(square[0][some])), least**2)
        ratio = expand(reduce(square)) / around / np.float32(TOLERATED**2 * usual)
        t = np.clip((ratio - np.float32(_BLENDED)) / np.float32(_NOT - _BLENDED), 0, 1)
        share = t * t * (3 - 2 * t)
        if not share[0][some].any():
            return None
        trusted = weight * (1 - share)
    return Mismatch(share[0].astype(np.float64), centre.astype(np.float64), g[:, 0, 0].astype(np.float64), level)


def _means(values: Float32Array, weight: Float32Array) -> Float32Array:
    total, sums = descend(values * weight, LEVELS)[-1], descend(weight, LEVELS)[-1]
    local = total / np.maximum(sums, np.float32(1e-6))
    return ascend(filled(local, np.minimum(4 * sums, np.float32(1)), MORE), LEVELS)


def box_of(cells: ByteArray) -> tuple[tuple[int, int], tuple[int, int]]:
    """Box of samples around the part of a block that some cells lie in.

    Parameters
    ----------
    cells : uint8 array (rows / 64, cols / 64)
        Some cell is not 0.

    Returns
    -------
    first : (row, column)
        Of the first sample, multiples of `ALIGNED`.
    size : (rows, columns)
        In samples, multiples of `ALIGNED`.
    """
    first, size = [], []
    for axis in (1, 0):
        at = np.flatnonzero(cells.any(axis=axis))
        start = int(at[0]) * PER // ALIGNED * ALIGNED
        first.append(start)
        size.append(-(-((int(at[-1]) + 1) * PER - start) // ALIGNED) * ALIGNED)
    return (first[0], first[1]), (size[0], size[1])


class View(NamedTuple):
    """Block as one image shows it.

    Attributes
    ----------
    values : array (rows, cols, bands)
        float32 or float64.
    seen : uint8 array (rows, cols)
        Pixels with a value.
    weight : float32 array
        As `accumulate` takes it.
    number : int
        What labels call the image.
    """

    values: AnyArray
    seen: ByteArray
    weight: Float32Array
    number: int


def compare(
    one: View,
    other: View,
    level: FloatArray,
    cells: ByteArray,
    corner: tuple[int, int],
    out: Float32Array,
    known: Float32Array,
) -> None:
    """Moments of samples of 4 × 4 pixels that both images show whole.

    Parameters
    ----------
    one, other : View
    level : array (bands,)
        Taken off brightness.
    cells : uint8 array (rows, cols)
        Cells of 64 × 64 pixels that are looked at.
    corner : (int, int)
        Row and column, in samples, of the first of `out`.
    out : float32 array (5, bands, R, C)
        Means over four quarters of D, A, D², D·A, A².
    known : float32 array (R, C)
        Set to 1.
    """
    _compare(one.values, other.values, one.seen, other.seen, level, cells, *corner, out, known)


def deghost(
    one: View,
    other: View,
    scale: tuple[int, int],
    cells: ByteArray,
    corner: tuple[int, int],
    mismatch: Mismatch,
    label: AnyArray,
    total: AnyArray,
) -> None:
    """Removal of the other image's weight from a sum where both show different things.

    With w the weight of the other image, V its value, O that of the pixel's own and E what V − O would be by light,
    w·share·(V − O − E) is taken off `total`.

    Parameters
    ----------
    one, other : View
    scale : (int, int)
        Output pixels along a cell of the weights, and cells of them around the block.
    cells : uint8 array (rows / 64, cols / 64)
        Cells of 64 × 64 pixels that are looked at.
    corner : (int, int)
        Row and column, in samples, of the first of `mismatch`.
    mismatch : Mismatch
    label : int array (rows, cols)
        Image that each pixel belongs to.
    total : array (rows, cols, bands)
        Weighted sum, changed in place.
    """
    views = (each for pair in zip(one, other, strict=True) for each in pair)
    values, others, seen, other_seen, weight, other_weight, number, other_number = views
    _deghost(
        values, others, seen, other_seen, weight, other_weight, *scale, number, other_number, cells, *corner, *mismatch,
        label, total,
    )  # fmt: skip
