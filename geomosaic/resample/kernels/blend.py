"""Weighted means of several images."""

from __future__ import annotations

import math

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def accumulate(values, valid, weight, factor, margin, index, total, sums, best, label):
    """Add one image's weighted values to a block; `weight` is a reduced lattice with `margin` cells around it."""
    height, width, bands = values.shape
    none = np.float32(0.0)
    across, cells = np.empty(width, dtype=np.float32), np.empty(width, dtype=np.int64)
    for c in range(width):
        u = (c + 0.5) / factor - 0.5 + margin
        cells[c] = int(u)
        across[c] = np.float32(u - cells[c])
    row = np.empty(width, dtype=np.float32)
    for k in range(height):
        v = (k + 0.5) / factor - 0.5 + margin
        j = int(v)
        fv = np.float32(v - j)
        upper, lower = weight[j], weight[j + 1]
        least, most = _weighty(upper, lower)
        begin, end = (least - 2 - margin) * factor, (most + 2 - margin) * factor
        first, stop = width, 0
        for c in range(max(begin, 0), min(end, width)):
            i = cells[c]
            top = upper[i] + (upper[i + 1] - upper[i]) * across[c]
            low = lower[i] + (lower[i + 1] - lower[i]) * across[c]
            w = top + (low - top) * fv
            row[c] = w if valid[k, c] else none
            if row[c] > none:
                first, stop = min(first, c), c + 1
        # Without branches from here: a weight of zero adds nothing.
        if bands == 3:
            for c in range(first, stop):
                w, some = row[c], row[c] > none
                total[k, c, 0] += w * values[k, c, 0] if some else none
                total[k, c, 1] += w * values[k, c, 1] if some else none
                total[k, c, 2] += w * values[k, c, 2] if some else none
        else:
            for c in range(first, stop):
                if row[c] > none:
                    for m in range(bands):
                        total[k, c, m] += row[c] * values[k, c, m]
        for c in range(first, stop):
            w = row[c]
            sums[k, c] += max(w, none)
            more = w > best[k, c]
            best[k, c] = w if more else best[k, c]
            label[k, c] = index if more else label[k, c]


@njit(cache=True, nogil=True, error_model="numpy")
def _weighty(upper, lower):
    """First and last cell of two rows that has weight; the last is before the first where none has."""
    least, most = len(upper), -1
    for i in range(len(upper)):
        if upper[i] > np.float32(0.0) or lower[i] > np.float32(0.0):
            least, most = min(least, i), i
    return least, most


@njit(cache=True, nogil=True, error_model="numpy")
def finish(total, sums, low, high, whole, out, out_valid):
    """Divide by the sum of weights, round, and store."""
    for k in range(out.shape[0]):
        for c in range(out.shape[1]):
            if sums[k, c] > np.float32(0.0):
                share = np.float32(1.0) / sums[k, c]
                for m in range(out.shape[2]):
                    value = np.float64(total[k, c, m] * share)
                    if whole:
                        value = np.float64(min(max(math.floor(value + 0.5), low), high))
                    out[k, c, m] = value
                out_valid[k, c] = 1
