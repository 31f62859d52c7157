"""Interpolation between pixels in NumPy, with the same operations in the same order as `kernels.sample`."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from geomosaic.types import AnyArray, FloatArray


def _nearest(source: AnyArray, valid: AnyArray, masked: bool, x: FloatArray, y: FloatArray) -> FloatArray:
    values: FloatArray = source[y.astype(np.int64), x.astype(np.int64)].astype(np.float64)
    return values


def _bilinear(source: AnyArray, valid: AnyArray, masked: bool, x: FloatArray, y: FloatArray) -> FloatArray:
    height, width, _ = source.shape
    i, j = (x + 0.5).astype(np.int64) - 1, (y + 0.5).astype(np.int64) - 1
    a, b = (x - 0.5 - i)[:, None], (y - 0.5 - j)[:, None]
    if source.itemsize == 1:  # eight bits need no finer weights, and these make every product exact
        a, b = np.floor(a * 2048.0 + 0.5) / 2048.0, np.floor(b * 2048.0 + 0.5) / 2048.0
    i0, j0, i1, j1 = np.maximum(i, 0), np.maximum(j, 0), np.minimum(i + 1, width - 1), np.minimum(j + 1, height - 1)
    taps = [(j0, i0), (j0, i1), (j1, i0), (j1, i1)]
    p00, p01, p10, p11 = (source[tap].astype(np.float64) for tap in taps)
    top, low = p00 + (p01 - p00) * a, p10 + (p11 - p10) * a
    values: FloatArray = top + (low - top) * b
    if masked:
        known = [valid[tap] > 0 for tap in taps]
        part = ~(known[0] & known[1] & known[2] & known[3])
        if part.any():
            weights = [(1.0 - a) * (1.0 - b), a * (1.0 - b), (1.0 - a) * b, a * b]
            total = np.zeros((int(part.sum()), 1))
            mean = np.zeros((int(part.sum()), source.shape[2]))
            for tap, w, k in zip(taps, weights, known, strict=True):
                share = (w * k[:, None])[part]
                total = total + share
                mean = mean + np.where(share > 0.0, share * source[tap][part], 0.0)
            values[part] = mean / total
    return values


def bilinear_bytes(source: AnyArray, x: FloatArray, y: FloatArray) -> AnyArray:
    """Bilinear values of eight-bit samples in whole numbers, in a fraction of the time of floating point.

    Parameters
    ----------
    source : uint8 array (rows, cols, bands)
    x, y : array (...)
        Columns and rows in `source`; (0.5, 0.5) is the centre of its first pixel.

    Returns
    -------
    int32 array (..., bands)
        In units of 2⁻²²: two weights of 11 bits.
    """
    height, width, bands = source.shape
    # Floor of x − 0.5 for x ≥ 0, since the cast cuts towards zero.
    i, j = (x + 0.5).astype(np.int32) - 1, (y + 0.5).astype(np.int32) - 1
    a, b = ((x - 0.5 - i) * 2048.0 + 0.5).astype(np.int32), ((y - 0.5 - j) * 2048.0 + 0.5).astype(np.int32)
    a, b = a[..., None], b[..., None]
    i0, i1 = np.maximum(i, 0), np.minimum(i + 1, width - 1)
    j0, j1 = np.maximum(j, 0) * width, np.minimum(j + 1, height - 1) * width
    pixels = source.reshape(-1, bands)
    top, low = (pixels.take(row + i0, axis=0).astype(np.int32) for row in (j0, j1))
    top = top * 2048 + (pixels.take(j0 + i1, axis=0) - top) * a
    low = low * 2048 + (pixels.take(j1 + i1, axis=0) - low) * a
    values: AnyArray = top * 2048 + (low - top) * b
    return values


def _convolved(
    source: AnyArray, valid: AnyArray, masked: bool, x: FloatArray, y: FloatArray, radius: int
) -> FloatArray:
    height, width, _ = source.shape
    values = _bilinear(source, valid, masked, x, y)
    i, j = (x + 0.5).astype(np.int64) - 1, (y + 0.5).astype(np.int64) - 1
    full = (i - radius + 1 >= 0) & (j - radius + 1 >= 0) & (i + radius < width) & (j + radius < height)
    span = range(1 - radius, radius + 1)
    if masked:
        for q in span:
            for p in span:
                full[full] = valid[j[full] + q, i[full] + p] > 0
    i, j = i[full], j[full]
    u = _WEIGHTS[radius](x[full] - 0.5 - i, source.itemsize == 1)
    v = _WEIGHTS[radius](y[full] - 0.5 - j, source.itemsize == 1)
    total = np.zeros((len(i), source.shape[2]))
    for q, down in zip(span, v, strict=True):
        line = np.zeros_like(total)
        for p, across in zip(span, u, strict=True):
            line = line + across[:, None] * source[j + q, i + p]
        total = total + down[:, None] * line
    values[full] = total
    return values


def _cubic_weights(t: FloatArray, coarse: bool) -> list[FloatArray]:
    weights = [
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    ]
    if coarse:
        weights = [np.trunc(w * 2048.0 + np.where(w < 0.0, -0.5, 0.5)) / 2048.0 for w in weights]
        weights[1] = 1.0 - weights[0] - weights[2] - weights[3]
    return weights


def _lanczos_weights(t: FloatArray, coarse: bool) -> list[FloatArray]:
    weights = []
    total = np.zeros_like(t)
    for p in range(6):
        d = np.pi * (t + 2.0 - p)
        with np.errstate(invalid="ignore", divide="ignore"):
            w = np.where(d == 0.0, 1.0, 3.0 * np.sin(d) * np.sin(d / 3.0) / (d * d))
        weights.append(w)
        total = total + w
    return [w / total for w in weights]


_WEIGHTS = {2: _cubic_weights, 3: _lanczos_weights}
VALUES: dict[str, Callable[..., FloatArray]] = {
    "nearest": _nearest,
    "bilinear": _bilinear,
    "cubic": partial(_convolved, radius=2),
    "lanczos": partial(_convolved, radius=3),
}
