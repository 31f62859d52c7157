"""Agreement of two images of the same ground, and weights taken back where they show different things.

The twins in NumPy are in `resample.agreement`: the same operations in the same order.
"""

from __future__ import annotations

import numpy as np

from geomosaic.resample.kernels.compiled import kernel

CELL, SAMPLE = 64, 4
PER = CELL // SAMPLE


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
