"""Image pyramids of Burt and Adelson (1983), compiled, and what is made of them."""

from __future__ import annotations

import numpy as np

from geomosaic.kernels.library import native
from geomosaic.types import AnyArray, BoolArray, Float32Array, IntArray

_reduce = native("reduce", "ss")
_expand = native("expand", "ss")
_minus = native("minus", "aaus")
_join = native("join", "asisiaiffia")


def reduce(fine: AnyArray) -> AnyArray:
    """Half the size: the sample (k, l) lies on the fine sample (2k, 2l).

    Parameters
    ----------
    fine : float32 array (bands, rows, cols)
        Rows and columns even.

    Returns
    -------
    float32 array (bands, rows / 2, cols / 2)
    """
    bands, rows, cols = fine.shape
    out: AnyArray = np.empty((bands, rows // 2, cols // 2), dtype=np.float32)
    _reduce(np.ascontiguousarray(fine, dtype=np.float32), out)
    return out


def expand(coarse: AnyArray) -> AnyArray:
    """Twice the size, the samples of `reduce` in their places.

    Parameters
    ----------
    coarse : float32 array (bands, rows, cols)

    Returns
    -------
    float32 array (bands, 2 rows, 2 cols)
    """
    bands, rows, cols = coarse.shape
    out: AnyArray = np.empty((bands, 2 * rows, 2 * cols), dtype=np.float32)
    _expand(np.ascontiguousarray(coarse, dtype=np.float32), out)
    return out


def minus(values: AnyArray, ground: AnyArray, both: BoolArray) -> AnyArray:
    """Differences of an image from a base, bands one after the other.

    Parameters
    ----------
    values, ground : array (rows, cols, bands)
        Of the image, and of the base in the exact type, float32 or float64.
    both : bool array (rows, cols)
        Where both are known.

    Returns
    -------
    float32 array (bands, rows, cols)
        0 where they are not.
    """
    out: AnyArray = np.empty((values.shape[2], *both.shape), dtype=np.float32)
    _minus(values, ground, both, out)
    return out


def join(
    values: AnyArray,
    own: Float32Array | None,
    blend: Float32Array | None,
    label: IntArray,
    index: int,
    limits: tuple[float, float, bool],
    out: AnyArray,
) -> None:
    """Mosaic values of one image's own pixels: blend + value − own difference, rounded.

    Every step is rounded to the floating-point type that holds the samples.

    Parameters
    ----------
    values : array (rows, cols, bands)
    own : float32 array (bands, rows, cols) or None
        Differences of the image from the base.
    blend : float32 array (bands, rows, cols) or None
        Blend of the differences.
    label : int array (rows, cols)
        Image that each pixel belongs to.
    index : int
        What `label` calls this image.
    limits : (float, float, bool)
        Range of the output's type, and whether values are rounded, halves up; see `value_range`.
    out : array (rows, cols, bands)
        Filled where `label` is `index`.
    """
    # A kernel is given an array in any case, and told whether to look at it.
    pairs = ((_NONE, False) if each is None else (each, True) for each in (own, blend))
    _join(values, *(part for pair in pairs for part in pair), label, index, *limits, out)


_NONE = np.zeros((1, 1, 1), dtype=np.float32)


def descend(values: AnyArray, levels: int) -> list[AnyArray]:
    """Pyramid of an image: its values and smaller versions of them.

    Parameters
    ----------
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
        pyramid.append(reduce(pyramid[-1]))
    return pyramid


def ascend(values: AnyArray, levels: int) -> AnyArray:
    """Values expanded several times.

    Parameters
    ----------
    values : float32 array (bands, rows, cols)
    levels : int
        Times that the size is doubled.

    Returns
    -------
    float32 array (bands, rows · 2 ** levels, cols · 2 ** levels)
    """
    for _ in range(levels):
        values = expand(values)
    return values


def filled(values: AnyArray, certainty: AnyArray, levels: int) -> AnyArray:
    """Values where they are certain, and where they are not, what their surroundings say.

    Parameters
    ----------
    values : float32 array (bands, rows, cols)
        Finite everywhere; what is uncertain does not matter.
    certainty : float32 array (1, rows, cols)
        0 to 1.
    levels : int
        Reach: beyond about 2 ^ levels samples from anything certain, values fade to 0.
    """
    # Normalised convolution (Knutsson and Westin, 1993) over a pyramid: means of certain values descend with their
    # certainty, and what a level does not know it takes from the next coarser one.
    sums, weights = descend(values * certainty, levels), descend(certainty, levels)
    # `least` stands for no certainty at all: 0 / 1e-6 is 0, where 0 / 0 would spread NaN.
    one, least = np.float32(1.0), np.float32(1e-6)
    out = sums[-1] / np.maximum(weights[-1], least)
    for total, weight in zip(sums[-2::-1], weights[-2::-1], strict=True):
        out = expand(out)
        out *= one - weight
        out += total
    return out
