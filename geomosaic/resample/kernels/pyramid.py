"""One step down and one step up an image pyramid: five taps (1, 4, 6, 4, 1) / 16 along each axis, edges repeated.

Of Burt and Adelson (1983). The twins in NumPy are in `resample.pyramid`: the same operations in the same order. Rows
are combined as flat lines, which processors do eight numbers at a time; then pixels along the line.
"""

from __future__ import annotations

import numpy as np
from numba import njit

SIXTEENTH, EIGHTH, QUARTER = np.float32(0.0625), np.float32(0.125), np.float32(0.25)
THREE_EIGHTHS, HALF, THREE_QUARTERS = np.float32(0.375), np.float32(0.5), np.float32(0.75)


@njit(cache=True, nogil=True, error_model="numpy")
def _five(a, b, c, d, e, line):
    for i in range(line.size):
        line[i] = (a[i] + e[i]) * SIXTEENTH + (b[i] + d[i]) * QUARTER + c[i] * THREE_EIGHTHS


@njit(cache=True, nogil=True, error_model="numpy")
def _three(a, b, c, line):
    for i in range(line.size):
        line[i] = (a[i] + c[i]) * EIGHTH + b[i] * THREE_QUARTERS


@njit(cache=True, nogil=True, error_model="numpy")
def _two(b, c, line):
    for i in range(line.size):
        line[i] = (b[i] + c[i]) * HALF


@njit(cache=True, nogil=True, error_model="numpy")
def reduce(fine):
    """Half the size (rows / 2, cols / 2, bands): the sample (k, l) lies on the fine sample (2k, 2l)."""
    height, width, bands = fine.shape
    rows, cols = height // 2, width // 2
    out = np.empty((rows, cols, bands), dtype=np.float32)
    flat, into = fine.reshape((height, width * bands)), out.reshape((rows, cols * bands))
    # Two pixels before the line and two behind it repeat its ends.
    padded = np.empty((width + 4) * bands, dtype=np.float32)
    line, end = padded[2 * bands : (width + 2) * bands], (width + 1) * bands
    for k in range(rows):
        r = 2 * k
        low, high = min(r + 1, height - 1), min(r + 2, height - 1)
        _five(flat[max(r - 2, 0)], flat[max(r - 1, 0)], flat[r], flat[low], flat[high], line)
        for m in range(bands):
            padded[m] = padded[bands + m] = padded[2 * bands + m]
            padded[end + bands + m] = padded[end + 2 * bands + m] = padded[end + m]
        target = into[k]
        for m in range(bands):
            for i in range(cols):
                p = 2 * i * bands + m
                target[i * bands + m] = (
                    (padded[p] + padded[p + 4 * bands]) * SIXTEENTH
                    + (padded[p + bands] + padded[p + 3 * bands]) * QUARTER
                    + padded[p + 2 * bands] * THREE_EIGHTHS
                )
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def expand(coarse):
    """Twice the size (2 rows, 2 cols, bands), the samples of `reduce` in their places."""
    rows, cols, bands = coarse.shape
    out = np.empty((2 * rows, 2 * cols, bands), dtype=np.float32)
    flat, into = coarse.reshape((rows, cols * bands)), out.reshape((2 * rows, 2 * cols * bands))
    padded = np.empty((cols + 2) * bands, dtype=np.float32)
    line, end = padded[bands : (cols + 1) * bands], cols * bands
    for r in range(2 * rows):
        k = r // 2
        below = flat[min(k + 1, rows - 1)]
        if r % 2 == 0:
            _three(flat[max(k - 1, 0)], flat[k], below, line)
        else:
            _two(flat[k], below, line)
        for m in range(bands):
            padded[m] = padded[bands + m]
            padded[end + bands + m] = padded[end + m]
        target = into[r]
        for m in range(bands):
            for i in range(cols):
                p = i * bands + m
                before, here, after = padded[p], padded[p + bands], padded[p + 2 * bands]
                q = 2 * i * bands + m
                target[q] = (before + after) * EIGHTH + here * THREE_QUARTERS
                target[q + bands] = (here + after) * HALF
    return out
