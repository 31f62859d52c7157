"""Weighted means of several images, and corrections of values by table or by gains on a coarse net, compiled."""

from __future__ import annotations

import numpy as np

from geomosaic.kernels.library import native
from geomosaic.types import AnyArray, ByteArray, Float32Array, FloatArray

_accumulate = native("accumulate", "ausiiiuassa")
_finish = native("finish", "asuffiau")
_lookup = native("lookup", "aauiau")
_shade = native("shade", "audddffffddfdffiau")


def accumulate(
    values: AnyArray,
    valid: ByteArray,
    weight: Float32Array,
    factor: int,
    margin: int,
    index: int,
    cells: ByteArray,
    total: AnyArray,
    sums: Float32Array,
    best: Float32Array,
    label: AnyArray,
) -> None:
    """Addition of one image's weighted values to a block.

    Parameters
    ----------
    values : array (rows, cols, bands)
        float32 or float64.
    valid : uint8 array (rows, cols)
    weight : float32 array (R, C)
        Weights of the image on a lattice of cells of `factor` x `factor` pixels, with `margin` cells around the block.
    factor, margin : int
    index : int
        What `label` calls the image.
    cells : uint8 array (rows / 64, cols / 64)
        Cells of 64 x 64 pixels that are wanted.
    total : array (rows, cols, bands)
        Sum of weighted values, of their type.
    sums : float32 array (rows, cols)
        Sum of weights.
    best : float32 array (rows, cols)
        Largest weight so far.
    label : int array (rows, cols)
        Image of the largest weight.
    """
    _accumulate(values, valid, weight, factor, margin, index, cells, total, sums, best, label)


def finish(
    total: AnyArray,
    sums: Float32Array,
    cells: ByteArray,
    low: float,
    high: float,
    whole: bool,
    out: AnyArray,
    out_valid: ByteArray,
) -> None:
    """Weighted means of a block, rounded and stored.

    Parameters
    ----------
    total : array (rows, cols, bands)
        Sum of weighted values, float32 or float64.
    sums : float32 array (rows, cols)
        Sum of weights.
    cells : uint8 array (rows / 64, cols / 64)
        Cells of 64 x 64 pixels that are wanted.
    low, high : float
        Range of the output's type.
    whole : bool
        Whether values are rounded, halves up.
    out : array (rows, cols, bands)
        Filled where there is weight.
    out_valid : uint8 array (rows, cols)
        Set to 1 there.
    """
    _finish(total, sums, cells, low, high, whole, out, out_valid)


def lookup(
    values: AnyArray, table: AnyArray, wanted: ByteArray, choose: bool, out: AnyArray, out_valid: ByteArray
) -> None:
    """Values by table: table[band, value] of each value.

    Parameters
    ----------
    values : uint8 or uint16 array (rows, cols, bands)
    table : array (bands, values)
        Of the type of `out`.
    wanted : uint8 array (rows, cols)
        Pixels that are wanted, looked at only if `choose`.
    choose : bool
    out : array (rows, cols, bands)
    out_valid : uint8 array (rows, cols)
        Set to 1 where a value is put.
    """
    _lookup(values, np.ascontiguousarray(table), wanted, choose, out, out_valid)


def shade(
    values: AnyArray,
    seen: ByteArray,
    net: FloatArray,
    path: FloatArray,
    haze: FloatArray,
    place: tuple[float, float, float, float],
    dark: FloatArray,
    curve: FloatArray,
    reach: float,
    offset: FloatArray,
    low: float,
    high: float,
    whole: bool,
    out: AnyArray,
    out_valid: ByteArray,
) -> None:
    """Correction of values by gains on a coarse net, rounded and stored.

    Parameters
    ----------
    values : array (rows, cols, bands)
    seen : uint8 array (rows, cols)
        Pixels that are corrected.
    net : array (node rows, node cols, bands)
        Gains.
    path : array (node rows, node cols)
        Excess air path; (0, 0) where there is no haze.
    haze : array (bands,)
    place : (float, float, float, float)
        Node of pixel (0, 0) and nodes per pixel, across and down: u0, v0, du, dv.
    dark, offset : array (bands,)
    curve : array (bands, steps + 1)
        Table from 0 to `reach`; (bands, 0) where values stay as they are.
    reach : float
    low, high : float
        Range of the output's type.
    whole : bool
        Whether values are rounded, halves up.
    out : array (rows, cols, bands)
    out_valid : uint8 array (rows, cols)
        Set to 1 where seen.

    Notes
    -----
    The formula is that of `radiometry.corrections.CorrectionField`.
    """
    _shade(values, seen, net, path, haze, *place, dark, curve, reach, offset, low, high, whole, out, out_valid)
