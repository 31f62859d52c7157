"""Image pyramids in NumPy: twins of the compiled steps, and what is made of steps of either kind."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from geomosaic.types import AnyArray, BoolArray, IntArray

Step = Callable[[AnyArray], AnyArray]


@dataclass(frozen=True)
class Steps:
    """Steps of an image pyramid, compiled or in NumPy.

    Attributes
    ----------
    reduce, expand : callable
        One step down and one up; float32 arrays (bands, rows, cols), of even size where they go down.
    minus, join : callable
        What is done pixel by pixel at either end, see `kernels.differences`.
    """

    reduce: Step
    expand: Step
    minus: Callable[[AnyArray, AnyArray, BoolArray], AnyArray]
    join: Callable[..., None]


def reduce(fine: AnyArray) -> AnyArray:
    """Half the size, see `kernels.pyramid.reduce`.

    Parameters
    ----------
    fine : float32 array (bands, rows, cols)
        Rows and columns even.

    Returns
    -------
    float32 array (bands, rows / 2, cols / 2)
    """
    return _halved(_halved(fine, 1), 2)


def expand(coarse: AnyArray) -> AnyArray:
    """Twice the size, see `kernels.pyramid.expand`.

    Parameters
    ----------
    coarse : float32 array (bands, rows, cols)

    Returns
    -------
    float32 array (bands, 2 rows, 2 cols)
    """
    return _doubled(_doubled(coarse, 1), 2)


def minus(values: AnyArray, ground: AnyArray, both: BoolArray) -> AnyArray:
    """Differences from a base, see `kernels.pyramid.minus`.

    Parameters
    ----------
    values, ground : array (rows, cols, bands)
        `ground` in the exact type, float32 or float64.
    both : bool array (rows, cols)
        Where both are known.

    Returns
    -------
    float32 array (bands, rows, cols)
        0 where they are not.
    """
    out = np.zeros((values.shape[2], *both.shape), dtype=np.float32)
    for band in range(len(out)):
        np.subtract(
            values[..., band], ground[..., band], out=out[band], where=both, dtype=ground.dtype, casting="same_kind"
        )
    return out


def join(
    values: AnyArray,
    own: AnyArray,
    differs: bool,
    blend: AnyArray,
    blends: bool,
    label: IntArray,
    index: int,
    low: float,
    high: float,
    whole: bool,
    kind: AnyArray,
    out: AnyArray,
) -> None:
    """Values and their corrections put together.

    Parameters
    ----------
    values, own, differs, blend, blends, label, index, low, high, whole, kind, out
        As `kernels.pyramid.join` has them.
    """
    mask = label == index
    for band in range(values.shape[2]):
        exact: AnyArray = values[..., band][mask].astype(kind.dtype)
        if blends:
            exact = blend[band][mask].astype(kind.dtype) + exact
        if differs:
            exact = exact - own[band][mask].astype(kind.dtype)
        out[..., band][mask] = np.clip(np.floor(exact + kind.dtype.type(0.5)), low, high) if whole else exact


def _halved(values: AnyArray, axis: int) -> AnyArray:
    size = values.shape[axis]
    middle = np.arange(0, size, 2)

    def tap(by: int) -> AnyArray:
        return values.take(np.clip(middle + by, 0, size - 1), axis=axis)

    return (
        (tap(-2) + tap(2)) * np.float32(0.0625) + (tap(-1) + tap(1)) * np.float32(0.25) + tap(0) * np.float32(0.375)
    )  # fmt: skip


def _doubled(values: AnyArray, axis: int) -> AnyArray:
    size = values.shape[axis]
    before = values.take(np.maximum(np.arange(size) - 1, 0), axis=axis)
    after = values.take(np.minimum(np.arange(size) + 1, size - 1), axis=axis)
    even = (before + after) * np.float32(0.125) + values * np.float32(0.75)
    odd = (values + after) * np.float32(0.5)
    shape = list(values.shape)
    shape[axis] *= 2
    joined: AnyArray = np.stack([even, odd], axis=axis + 1).reshape(shape)
    return joined


def descend(by: Steps, values: AnyArray, levels: int) -> list[AnyArray]:
    """Pyramid of an image: its values and smaller versions of them.

    Parameters
    ----------
    by : Steps
    values : float32 array (bands, rows, cols)
        Rows and columns multiples of 2 ** `levels`.
    levels : int
        Number of smaller versions.

    Returns
    -------
    list of array
        `levels` + 1 of them, finest first.
    """
    pyramid = [values]
    for _ in range(levels):
        pyramid.append(by.reduce(pyramid[-1]))
    return pyramid


def ascend(by: Steps, values: AnyArray, levels: int) -> AnyArray:
    """Values expanded several times.

    Parameters
    ----------
    by : Steps
    values : float32 array (bands, rows, cols)
    levels : int
        Times that the size is doubled.

    Returns
    -------
    float32 array (bands, rows · 2 ** levels, cols · 2 ** levels)
    """
    for _ in range(levels):
        values = by.expand(values)
    return values


def filled(by: Steps, values: AnyArray, certainty: AnyArray, levels: int) -> AnyArray:
    """Values where they are certain, and where they are not, what their surroundings say.

    Parameters
    ----------
    by : Steps
    values : float32 array (bands, rows, cols)
        Finite everywhere; what is uncertain does not matter.
    certainty : float32 array (1, rows, cols)
        0 to 1.
    levels : int
        Reach: beyond about 2 ^ levels samples from anything certain, values fade to 0.
    """
    # Normalised convolution (Knutsson and Westin, 1993) over a pyramid: means of certain values descend with their
    # certainty, and what a level does not know it takes from the next coarser one.
    sums, weights = descend(by, values * certainty, levels), descend(by, certainty, levels)
    # `least` stands for no certainty at all: 0 / 1e-6 is 0, where 0 / 0 would spread NaN.
    one, least = np.float32(1.0), np.float32(1e-6)
    out = sums[-1] / np.maximum(weights[-1], least)
    for total, weight in zip(sums[-2::-1], weights[-2::-1], strict=True):
        out = by.expand(out)
        out *= one - weight
        out += total
    return out
