"""Weighted means of several images, in the cells of 64 x 64 pixels where more than one has weight."""

from __future__ import annotations

import math

import numpy as np

from geomosaic.resample.kernels.compiled import kernel

CELL = 64


@kernel
def accumulate(values, valid, weight, factor, margin, index, cells, total, sums, best, label):
    """Addition of one image's weighted values to a block.

    Parameters
    ----------
    values : array (rows, cols, bands)
    valid : uint8 array (rows, cols)
    weight : float32 array
        Weights of the image on a lattice of cells of `factor` x `factor` pixels, with `margin` cells around the block.
    factor, margin : int
    index : int
        What `label` calls the image.
    cells : uint8 array (rows / 64, cols / 64)
        Cells of 64 x 64 pixels that are wanted.
    total : float32 array (rows, cols, bands)
        Sum of weighted values.
    sums : float32 array (rows, cols)
        Sum of weights.
    best : float32 array (rows, cols)
        Largest weight so far.
    label : int array (rows, cols)
        Image of the largest weight.
    """
    height, width, bands = values.shape
    for p, q in np.ndindex(cells.shape):
        if not cells[p, q]:
            continue
        for k in range(p * CELL, min(p * CELL + CELL, height)):
            v = (k + 0.5) / factor - 0.5 + margin
            j = int(v)
            fv = np.float32(v - j)
            for c in range(q * CELL, min(q * CELL + CELL, width)):
                if not valid[k, c]:
                    continue
                u = (c + 0.5) / factor - 0.5 + margin
                i = int(u)
                fu = np.float32(u - i)
                top = weight[j, i] + (weight[j, i + 1] - weight[j, i]) * fu
                low = weight[j + 1, i] + (weight[j + 1, i + 1] - weight[j + 1, i]) * fu
                w = top + (low - top) * fv
                if w <= np.float32(0.0):
                    continue
                for m in range(bands):
                    total[k, c, m] += w * values[k, c, m]
                sums[k, c] += w
                if w > best[k, c]:
                    best[k, c] = w
                    label[k, c] = index


@kernel
def finish(total, sums, cells, low, high, whole, out, out_valid):
    """Weighted means of a block, rounded and stored.

    Parameters
    ----------
    total : float32 array (rows, cols, bands)
        Sum of weighted values.
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
    height, width, bands = out.shape
    for p, q in np.ndindex(cells.shape):
        if not cells[p, q]:
            continue
        for k in range(p * CELL, min(p * CELL + CELL, height)):
            for c in range(q * CELL, min(q * CELL + CELL, width)):
                if sums[k, c] > np.float32(0.0):
                    share = np.float32(1.0) / sums[k, c]
                    for m in range(bands):
                        value = np.float64(total[k, c, m] * share)
                        if whole:
                            value = np.float64(min(max(math.floor(value + 0.5), low), high))
                        out[k, c, m] = value
                    out_valid[k, c] = 1
