"""Weighted means of several images, and corrections of values by table or by gains on a coarse net, compiled."""

from __future__ import annotations

import math

import numpy as np

from geomosaic.options.render import CELL
from geomosaic.resample.kernels.compiled import kernel


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


@kernel
def lookup(values, table, wanted, choose, out, out_valid):
    """Values by table: table[band, value] of each value.

    Parameters
    ----------
    values : array (rows, cols, bands)
        Whole numbers without sign.
    table : array (bands, values)
    wanted : uint8 array (rows, cols)
        Pixels that are wanted, looked at only if `choose`.
    choose : bool
    out : array (rows, cols, bands)
    out_valid : uint8 array (rows, cols)
        Set to 1 where a value is put.
    """
    # Band by band within a row: a third of the time of pixel by pixel, since the inner loops are long.
    rows, cols, bands = values.shape
    for k in range(rows):
        line, target, seen = values[k], out[k], out_valid[k]
        pick = wanted[k if choose else 0]
        for m in range(bands):
            becomes = table[m]
            if choose:
                for c in range(cols):
                    if pick[c] != 0:
                        target[c, m] = becomes[line[c, m]]
            else:
                for c in range(cols):
                    target[c, m] = becomes[line[c, m]]
        if choose:
            for c in range(cols):
                if pick[c] != 0:
                    seen[c] = 1
        else:
            seen[:] = 1


@kernel
def shade(
    values, seen, net, path, haze, place, dark, curve, reach, offset, low, high, whole, out, out_valid
):  # fmt: skip
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
    height, width, bands = values.shape
    node_rows, node_cols, _ = net.shape
    u0, v0, du, dv = place
    steps = curve.shape[1] - 1
    scale = steps / reach
    line, ways = np.empty((node_cols, bands)), np.zeros(node_cols)
    hazy = path.size > 0
    for k in range(height):
        v = min(max(v0 + k * dv, 0.0), node_rows - 1.0)
        j = min(int(v), node_rows - 2)
        fv = v - j
        for i in range(node_cols):
            if hazy:
                ways[i] = path[j, i] + (path[j + 1, i] - path[j, i]) * fv
            for m in range(bands):
                line[i, m] = net[j, i, m] + (net[j + 1, i, m] - net[j, i, m]) * fv
        for c in range(width):
            if not seen[k, c]:
                continue
            u = min(max(u0 + c * du, 0.0), node_cols - 1.0)
            i = min(int(u), node_cols - 2)
            fu = u - i
            way = ways[i] + (ways[i + 1] - ways[i]) * fu
            for m in range(bands):
                gain = line[i, m] + (line[i + 1, m] - line[i, m]) * fu
                plain = np.float64(values[k, c, m]) + dark[m]
                if hazy:
                    plain -= haze[m] * way
                if steps > 0:
                    at = max(plain * scale, 0.0)
                    s = min(int(at), steps - 1)
                    plain = curve[m, s] + (curve[m, s + 1] - curve[m, s]) * (at - s)
                value = gain * plain + offset[m]
                if whole:
                    value = min(max(math.floor(value + 0.5), low), high)
                out[k, c, m] = value
            out_valid[k, c] = 1
