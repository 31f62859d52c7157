"""Image pyramids and differences from a base, compiled.

Of Burt and Adelson (1983). The twins in NumPy are in `resample.pyramid`: the same operations in the same order. Bands
lie one after the other, so that processors take eight samples of a line at a time.
"""

from __future__ import annotations

import numpy as np

from geomosaic.resample.kernels.compiled import kernel

SIXTEENTH, EIGHTH, QUARTER = np.float32(0.0625), np.float32(0.125), np.float32(0.25)
THREE_EIGHTHS, HALF, THREE_QUARTERS = np.float32(0.375), np.float32(0.5), np.float32(0.75)


@kernel
def _five(a, b, c, d, e, line):
    for i in range(line.size):
        line[i] = (a[i] + e[i]) * SIXTEENTH + (b[i] + d[i]) * QUARTER + c[i] * THREE_EIGHTHS


@kernel
def _three(a, b, c, line):
    for i in range(line.size):
        line[i] = (a[i] + c[i]) * EIGHTH + b[i] * THREE_QUARTERS


@kernel
def _two(b, c, line):
    for i in range(line.size):
        line[i] = (b[i] + c[i]) * HALF


@kernel
def reduce(fine):
    """Half the size: the sample (k, l) lies on the fine sample (2k, 2l).

    Parameters
    ----------
    fine : float32 array (bands, rows, cols)
        Rows and columns even.

    Returns
    -------
    float32 array (bands, rows / 2, cols / 2)
    """
    bands, height, width = fine.shape
    rows, cols = height // 2, width // 2
    out = np.empty((bands, rows, cols), dtype=np.float32)
    # Two samples before the line and two behind it repeat its ends.
    padded = np.empty(width + 4, dtype=np.float32)
    line = padded[2 : width + 2]
    for m in range(bands):
        band = fine[m]
        for k in range(rows):
            r = 2 * k
            low, high = min(r + 1, height - 1), min(r + 2, height - 1)
            _five(band[max(r - 2, 0)], band[max(r - 1, 0)], band[r], band[low], band[high], line)
            padded[0] = padded[1] = padded[2]
            padded[width + 2] = padded[width + 3] = padded[width + 1]
            target = out[m, k]
            for i in range(cols):
                p = 2 * i
                target[i] = (
                    (padded[p] + padded[p + 4]) * SIXTEENTH
                    + (padded[p + 1] + padded[p + 3]) * QUARTER
                    + padded[p + 2] * THREE_EIGHTHS
                )
    return out


@kernel
def expand(coarse):
    """Twice the size, the samples of `reduce` in their places.

    Parameters
    ----------
    coarse : float32 array (bands, rows, cols)

    Returns
    -------
    float32 array (bands, 2 rows, 2 cols)
    """
    bands, rows, cols = coarse.shape
    out = np.empty((bands, 2 * rows, 2 * cols), dtype=np.float32)
    padded = np.empty(cols + 2, dtype=np.float32)
    line = padded[1 : cols + 1]
    for m in range(bands):
        band = coarse[m]
        for r in range(2 * rows):
            k = r // 2
            below = band[min(k + 1, rows - 1)]
            if r % 2 == 0:
                _three(band[max(k - 1, 0)], band[k], below, line)
            else:
                _two(band[k], below, line)
            padded[0] = padded[1]
            padded[cols + 1] = padded[cols]
            target = out[m, r]
            for i in range(cols):
                here = padded[i + 1]
                target[2 * i] = (padded[i] + padded[i + 2]) * EIGHTH + here * THREE_QUARTERS
                target[2 * i + 1] = (here + padded[i + 2]) * HALF
    return out


@kernel
def minus(values, ground, both):
    """Differences of an image from a base, bands one after the other.

    Parameters
    ----------
    values, ground : array (rows, cols, bands)
        Of the image and of the base.
    both : bool array (rows, cols)
        Where both are known.

    Returns
    -------
    float32 array (bands, rows, cols)
        0 where they are not.
    """
    rows, cols, bands = values.shape
    out = np.empty((bands, rows, cols), dtype=np.float32)
    for k in range(rows):
        line, below, known = values[k], ground[k], both[k]
        for m in range(bands):
            target = out[m, k]
            for c in range(cols):
                target[c] = np.float32(line[c, m] - below[c, m]) if known[c] else np.float32(0.0)
    return out


@kernel
def join(values, own, differs, blend, blends, label, index, low, high, whole, kind, out):
    """Mosaic values of one image's own pixels: blend + value − own difference, rounded.

    Every step is rounded to the exact type, as NumPy does.

    Parameters
    ----------
    values : array (rows, cols, bands)
    own : float32 array (bands, rows, cols)
        Differences of the image from the base; looked at only if `differs`.
    differs : bool
    blend : float32 array (bands, rows, cols)
        Blend of the differences; looked at only if `blends`.
    blends : bool
    label : int array (rows, cols)
        Image that each pixel belongs to.
    index : int
        What `label` calls this image.
    low, high : float
        Range of the output's type.
    whole : bool
        Whether values are rounded, halves up.
    kind : array (1,)
        Holds a number of the exact type: float32 or float64.
    out : array (rows, cols, bands)
        Filled where `label` is `index`.
    """
    rows, cols, bands = values.shape
    exact = kind.dtype.type
    half = exact(0.5)
    for k in range(rows):
        line, chosen, target = values[k], label[k], out[k]
        for m in range(bands):
            for c in range(cols):
                if chosen[c] != index:
                    continue
                value = exact(line[c, m])
                if blends:
                    value = exact(exact(blend[m, k, c]) + value)
                if differs:
                    value = exact(value - exact(own[m, k, c]))
                if whole:
                    value = min(max(np.floor(value + half), exact(low)), exact(high))
                target[c, m] = value
