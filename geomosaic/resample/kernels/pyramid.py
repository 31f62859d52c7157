"""Image pyramids, differences from a base, and agreement of two images of the same ground, compiled."""

# Pyramids are those of Burt and Adelson (1983). The twins in NumPy are in `resample.pyramid` and `resample.agreement`:
# the same operations in the same order. Bands lie one after the other, so that processors take eight samples of a line
# at a time.

from __future__ import annotations

import numpy as np

from geomosaic.options.render import CELL
from geomosaic.resample.agreement import PER, SAMPLE
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


@kernel
def compare(a, b, seen_a, seen_b, level, cells, corner, out, known):
    """Moments of samples of 4 x 4 pixels that both images show whole.

    Parameters
    ----------
    a, b, seen_a, seen_b, level, cells, corner, out, known
        As `resample.agreement.compare` has them.
    """
    height, width, bands = a.shape
    for p, q in np.ndindex(cells.shape):
        if not cells[p, q]:
            continue
        for r in range(p * PER, min(p * PER + PER, height // SAMPLE)):
            for c in range(q * PER, min(q * PER + PER, width // SAMPLE)):
                top, left = r * SAMPLE, c * SAMPLE
                whole = True
                for k in range(top, top + SAMPLE):
                    for i in range(left, left + SAMPLE):
                        whole = whole and seen_a[k, i] != 0 and seen_b[k, i] != 0
                if not whole:
                    continue
                known[r - corner[0], c - corner[1]] = np.float32(1.0)
                for m in range(bands):
                    d = s = dd = ds = ss = np.float64(0.0)
                    for k in range(top, top + SAMPLE, 2):
                        for i in range(left, left + SAMPLE, 2):
                            one = np.float64(a[k, i, m]) + a[k, i + 1, m] + a[k + 1, i, m] + a[k + 1, i + 1, m]
                            other = np.float64(b[k, i, m]) + b[k, i + 1, m] + b[k + 1, i, m] + b[k + 1, i + 1, m]
                            apart = (one - other) * 0.25
                            mean = (one + other) * 0.125 - level[m]
                            d += apart
                            s += mean
                            dd += apart * apart
                            ds += apart * mean
                            ss += mean * mean
                    r0, c0 = r - corner[0], c - corner[1]
                    out[0, m, r0, c0] = d * 0.25
                    out[1, m, r0, c0] = s * 0.25
                    out[2, m, r0, c0] = dd * 0.25
                    out[3, m, r0, c0] = ds * 0.25
                    out[4, m, r0, c0] = ss * 0.25


@kernel
def deghost(a, b, seen_a, seen_b, weight_a, weight_b, factor, margin, indices, cells, corner, mismatch, label, total):
    """Removal of the other image's weight from a sum where both show different things.

    Parameters
    ----------
    a, b, seen_a, seen_b, weight_a, weight_b, factor, margin, indices, cells, corner, mismatch, label, total
        As `resample.agreement.deghost` has them.
    """
    height, width, bands = a.shape
    share, mean, slope, level = mismatch
    rows, cols = share.shape
    for p, q in np.ndindex(cells.shape):
        if not cells[p, q]:
            continue
        for k in range(p * CELL, min(p * CELL + CELL, height)):
            v = min(max((k + 0.5) / SAMPLE - 0.5 - corner[0], 0.0), rows - 1.0)
            j = min(int(v), rows - 2)
            fv = v - j
            wv = (k + 0.5) / factor - 0.5 + margin
            wj = int(wv)
            gv = np.float32(wv - wj)
            for c in range(q * CELL, min(q * CELL + CELL, width)):
                first = label[k, c] == indices[0]
                if not (first or label[k, c] == indices[1]) or not seen_a[k, c] or not seen_b[k, c]:
                    continue
                u = min(max((c + 0.5) / SAMPLE - 0.5 - corner[1], 0.0), cols - 1.0)
                i = min(int(u), cols - 2)
                fu = u - i
                upper = share[j, i] + (share[j, i + 1] - share[j, i]) * fu
                lower = share[j + 1, i] + (share[j + 1, i + 1] - share[j + 1, i]) * fu
                s = upper + (lower - upper) * fv
                if s <= 0.0:
                    continue
                weight = weight_b if first else weight_a
                wu = (c + 0.5) / factor - 0.5 + margin
                wi = int(wu)
                gu = np.float32(wu - wi)
                top = weight[wj, wi] + (weight[wj, wi + 1] - weight[wj, wi]) * gu
                low = weight[wj + 1, wi] + (weight[wj + 1, wi + 1] - weight[wj + 1, wi]) * gu
                w = np.float64(top + (low - top) * gv)
                if w <= 0.0:
                    continue
                for m in range(bands):
                    upper = mean[m, j, i] + (mean[m, j, i + 1] - mean[m, j, i]) * fu
                    lower = mean[m, j + 1, i] + (mean[m, j + 1, i + 1] - mean[m, j + 1, i]) * fu
                    x = np.float64(a[k, c, m])
                    y = np.float64(b[k, c, m])
                    half = slope[m] * 0.5 if first else -slope[m] * 0.5
                    own = x if first else y
                    expected = ((upper + (lower - upper) * fv) + slope[m] * (own - level[m])) / (1.0 + half)
                    off = (x - y) - expected
                    total[k, c, m] = total[k, c, m] + (w * s) * (off if first else -off)
