"""Interior blocks, the commonest case: three bands of eight bits, no heights, all pixels there, values as they are.

Where a map is brought to another CRS at about its own pixel size, neighbours in the output are neighbours in the image
for tens to thousands of pixels on end. Such a run is arithmetic on bytes that follow each other, which becomes vector
instructions; elsewhere every pixel is taken for itself. Both give what `image_coordinates.bilinear_rgb` gives.
"""

from __future__ import annotations

import numpy as np

from geomosaic.resample.kernels.compiled import kernel, part

UNIT, HALF, SHIFT = np.int32(2048), np.int32(2097152), np.int32(22)
BITS, PART = np.int32(11), np.int32(2047)
# Pixels of a run, on average over a row, from which on runs are sooner.
LONG = 12


@kernel
def bilinear_rgb_inner(nodes, step, source, corner, out):
    """Bilinear values of a block all of whose taps lie in a window.

    Parameters
    ----------
    nodes : array (ny, nx, 8)
        As `sensor.lattice.Lattice` has them, heights playing no part.
    step : int
        Output pixels between nodes.
    source : uint8 array (rows, cols, 3)
        The window.
    corner : (int, int)
        First column and row of the window in the image.
    out : uint8 array (rows, 3 · cols)

    Returns
    -------
    int
        Height of the block, as `bilinear_rgb` has it.
    """
    height, width = out.shape[0], out.shape[1] // 3
    values, stride = source.reshape(-1), np.int32(source.shape[1] * 3)
    col0, row0 = np.float64(corner[0]), np.float64(corner[1])
    across = np.empty(width)
    for c in range(width):
        across[c] = (c + 0.5) / step - c // step
    x, y = np.empty(width, np.int32), np.empty(width, np.int32)
    at, right, below = np.empty(width, np.int32), np.empty(width, np.int32), np.empty(width, np.int32)
    wide_right, wide_below = np.empty(3 * width, np.int32), np.empty(3 * width, np.int32)
    for k in range(height):
        v = (k + 0.5) / step
        j = int(v)
        fv = v - j
        for i in range(nodes.shape[1] - 1):
            c0 = nodes[j, i, 0] + (nodes[j + 1, i, 0] - nodes[j, i, 0]) * fv
            r0 = nodes[j, i, 4] + (nodes[j + 1, i, 4] - nodes[j, i, 4]) * fv
            d0 = nodes[j, i + 1, 0] + (nodes[j + 1, i + 1, 0] - nodes[j, i + 1, 0]) * fv - c0
            e0 = nodes[j, i + 1, 4] + (nodes[j + 1, i + 1, 4] - nodes[j, i + 1, 4]) * fv - r0
            _place(across[i * step : (i + 1) * step], c0, d0, col0, x[i * step : (i + 1) * step])
            _place(across[i * step : (i + 1) * step], r0, e0, row0, y[i * step : (i + 1) * step])
        for c in range(width):
            right[c] = x[c] & PART
            below[c] = y[c] & PART
            at[c] = (y[c] >> BITS) * stride + (x[c] >> BITS) * np.int32(3)
        breaks = 0
        for c in range(1, width):
            breaks += at[c] - at[c - 1] != 3
        line = out[k]
        if breaks * LONG > width:
            _single(values, stride, at, right, below, line)
            continue
        for c in range(width):
            wide_right[3 * c] = wide_right[3 * c + 1] = wide_right[3 * c + 2] = right[c]
            wide_below[3 * c] = wide_below[3 * c + 1] = wide_below[3 * c + 2] = below[c]
        start = 0
        while start < width:
            stop = start + 1
            while stop < width and at[stop] - at[stop - 1] == 3:
                stop += 1
            first, last = 3 * start, 3 * stop
            _run(values, stride, at[start], wide_right[first:last], wide_below[first:last], line[first:last])
            start = stop
    return height


@part
def _place(across, first, delta, corner, out):
    """Distance from the centre of the window's first pixel in 2048ths, rounded: pixel and weight in one number."""
    for c in range(out.shape[0]):
        # Less half a pixel, 1024, and half a unit more, so that the cast rounds.
        out[c] = np.int32((first + delta * across[c] - corner) * 2048.0 - 1023.5)


@part
def _run(values, stride, at, right, below, out):
    """Bytes side by side, each between itself and the third to its right, above and below."""
    number = out.shape[0]
    top, low = values[at : at + number + 3], values[at + stride : at + stride + number + 3]
    for k in range(number):
        first, second = np.int32(top[k]), np.int32(low[k])
        first = first * UNIT + (np.int32(top[k + 3]) - first) * right[k]
        second = second * UNIT + (np.int32(low[k + 3]) - second) * right[k]
        out[k] = (first * UNIT + (second - first) * below[k] + HALF) >> SHIFT


@part
def _single(values, stride, at, right, below, out):
    """Each pixel for itself."""
    for c in range(at.shape[0]):
        p = np.uint64(np.uint32(at[c]))
        r = p + np.uint64(np.uint32(stride))
        a, b = right[c], below[c]
        for m in range(3):
            n = np.uint64(m)
            first, second = np.int32(values[p + n]), np.int32(values[r + n])
            first = first * UNIT + (np.int32(values[p + n + np.uint64(3)]) - first) * a
            second = second * UNIT + (np.int32(values[r + n + np.uint64(3)]) - second) * a
            out[3 * c + m] = (first * UNIT + (second - first) * b + HALF) >> SHIFT
