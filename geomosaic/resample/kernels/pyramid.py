"""One step down and one step up an image pyramid: five taps (1, 4, 6, 4, 1) / 16 along each axis, edges repeated.

Of Burt and Adelson (1983). The twins in NumPy are in `resample.pyramid`: the same operations in the same order.
"""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True, error_model="numpy")
def reduce(fine):
    """Half the size (rows / 2, cols / 2, bands): the sample (k, l) lies on the fine sample (2k, 2l)."""
    height, width, bands = fine.shape
    rows, cols = height // 2, width // 2
    out = np.empty((rows, cols, bands), dtype=np.float32)
    line = np.empty((width, bands), dtype=np.float32)
    for k in range(rows):
        r = 2 * k
        a, b = fine[max(r - 2, 0)], fine[max(r - 1, 0)]
        c, d, e = fine[r], fine[min(r + 1, height - 1)], fine[min(r + 2, height - 1)]
        for i in range(width):
            for m in range(bands):
                line[i, m] = (
                    (a[i, m] + e[i, m]) * np.float32(0.0625)
                    + (b[i, m] + d[i, m]) * np.float32(0.25)
                    + c[i, m] * np.float32(0.375)
                )
        for i in range(cols):
            x = 2 * i
            p, q, s, t = max(x - 2, 0), max(x - 1, 0), min(x + 1, width - 1), min(x + 2, width - 1)
            for m in range(bands):
                out[k, i, m] = (
                    (line[p, m] + line[t, m]) * np.float32(0.0625)
                    + (line[q, m] + line[s, m]) * np.float32(0.25)
                    + line[x, m] * np.float32(0.375)
                )
    return out


@njit(cache=True, nogil=True, error_model="numpy")
def expand(coarse):
    """Twice the size (2 rows, 2 cols, bands), the samples of `reduce` in their places."""
    rows, cols, bands = coarse.shape
    out = np.empty((2 * rows, 2 * cols, bands), dtype=np.float32)
    line = np.empty((cols, bands), dtype=np.float32)
    for r in range(2 * rows):
        k = r // 2
        a, b, c = coarse[max(k - 1, 0)], coarse[k], coarse[min(k + 1, rows - 1)]
        if r % 2 == 0:
            for i in range(cols):
                for m in range(bands):
                    line[i, m] = (a[i, m] + c[i, m]) * np.float32(0.125) + b[i, m] * np.float32(0.75)
        else:
            for i in range(cols):
                for m in range(bands):
                    line[i, m] = (b[i, m] + c[i, m]) * np.float32(0.5)
        for i in range(cols):
            left, right = max(i - 1, 0), min(i + 1, cols - 1)
            for m in range(bands):
                out[r, 2 * i, m] = (line[left, m] + line[right, m]) * np.float32(0.125) + line[i, m] * np.float32(0.75)
                out[r, 2 * i + 1, m] = (line[i, m] + line[right, m]) * np.float32(0.5)
    return out
