"""Values at image coordinates, compiled: nearest, bilinear, cubic and Lanczos, and a fast path for interior blocks.

Interior blocks are the commonest case: three bands of eight bits, no heights, all pixels there, values as they are.
Where a map is brought to another CRS at about its own pixel size, neighbours in the output are neighbours in the image
for tens to thousands of pixels on end. Such a run is arithmetic on bytes that follow each other, which becomes vector
instructions; elsewhere every pixel is taken for itself. Both give what `image_coordinates.bilinear_rgb` gives.
"""

from __future__ import annotations

import math

import numpy as np

from geomosaic.resample.kernels.compiled import inlined, kernel, part
from geomosaic.types import AnyArray, ByteArray, FloatArray

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


@inlined
def _bilinear(source, valid, masked, x, y, values):
    """Weighted mean of the valid ones of four pixels; taps beyond the window repeat its edge."""
    height, width, bands = source.shape
    i = int(x + 0.5) - 1
    j = int(y + 0.5) - 1
    a = x - 0.5 - i
    b = y - 0.5 - j
    if source.itemsize == 1:
        a = math.floor(a * 2048.0 + 0.5) / 2048.0
        b = math.floor(b * 2048.0 + 0.5) / 2048.0
    i0 = np.uint64(max(i, 0))
    j0 = np.uint64(max(j, 0))
    i1 = np.uint64(min(i + 1, width - 1))
    j1 = np.uint64(min(j + 1, height - 1))
    if masked and not (valid[j0, i0] and valid[j0, i1] and valid[j1, i0] and valid[j1, i1]):
        w00 = (1.0 - a) * (1.0 - b) * valid[j0, i0]
        w01 = a * (1.0 - b) * valid[j0, i1]
        w10 = (1.0 - a) * b * valid[j1, i0]
        w11 = a * b * valid[j1, i1]
        total = w00 + w01 + w10 + w11
        for m in range(bands):
            value = 0.0
            if w00 > 0.0:
                value += w00 * source[j0, i0, m]
            if w01 > 0.0:
                value += w01 * source[j0, i1, m]
            if w10 > 0.0:
                value += w10 * source[j1, i0, m]
            if w11 > 0.0:
                value += w11 * source[j1, i1, m]
            values[m] = value / total
        return
    for m in range(bands):
        p00 = np.float64(source[j0, i0, m])
        p10 = np.float64(source[j1, i0, m])
        top = p00 + (np.float64(source[j0, i1, m]) - p00) * a
        low = p10 + (np.float64(source[j1, i1, m]) - p10) * a
        values[m] = top + (low - top) * b


@inlined
def _whole(valid, masked, width, height, i, j, radius):
    """Whether all taps i−radius+1 … i+radius in both directions are in the window and valid."""
    if i - radius + 1 < 0 or j - radius + 1 < 0 or i + radius >= width or j + radius >= height:
        return False
    if masked:
        for q in range(j - radius + 1, j + radius + 1):
            for p in range(i - radius + 1, i + radius + 1):
                if not valid[q, p]:
                    return False
    return True


@inlined
def _store(out, out_valid, k, c, values, gain, offset, low, high, whole):
    for m in range(out.shape[2]):
        value = values[m] * gain[m] + offset[m]
        if whole:
            value = math.floor(value + 0.5)
            value = min(max(value, low), high)
        out[k, c, m] = value
    out_valid[k, c] = 1


@kernel
def sample_nearest(source, valid, masked, cols, rows, n, place, gain, offset, low, high, whole, out, out_valid):
    """Value of the pixel that the point falls in; never averaged (n is 1).

    Parameters
    ----------
    source, valid, masked, cols, rows, n, place, gain, offset, low, high, whole, out, out_valid
        As `sample` has them.
    """
    col0, row0, shrink, width, height = place
    values = np.empty(source.shape[2])
    for k in range(out.shape[0]):
        for c in range(out.shape[1]):
            x = cols[k, c]
            y = rows[k, c]
            if not (x >= 0.0 and y >= 0.0 and x < width and y < height):
                continue
            i = int((x - col0) / shrink)
            j = int((y - row0) / shrink)
            if masked and not valid[j, i]:
                continue
            for m in range(source.shape[2]):
                values[m] = source[j, i, m]
            _store(out, out_valid, k, c, values, gain, offset, low, high, whole)


@inlined
def _cubic_whole(t):
    """Keys' weights in 2048ths, rounded; the outer two are negative, the inner two keep even ground and a slope."""
    w0 = np.int32(((-0.5 * t + 1.0) * t - 0.5) * t * 2048.0 - 0.5)
    w3 = np.int32((0.5 * t - 0.5) * t * t * 2048.0 - 0.5)
    # Each rounded for itself they would move a picture whose pixels all have the same t, by up to 0.0007 px.
    w2 = np.int32(t * 2048.0 + 0.5) + w0 - np.int32(2) * w3
    return w0, np.int32(2048 - w0 - w2 - w3), w2, w3


@kernel
def sample_bilinear(source, valid, masked, cols, rows, n, place, gain, offset, low, high, whole, out, out_valid):
    """Bilinear values; with n > 1 the mean of n × n bilinear samples, which is an average over the footprint.

    Parameters
    ----------
    source, valid, masked, cols, rows, n, place, gain, offset, low, high, whole, out, out_valid
        As `sample` has them.
    """
    col0, row0, shrink, width, height = place
    values = np.empty(source.shape[2])
    if n == 1:
        for k in range(out.shape[0]):
            for c in range(out.shape[1]):
                x = cols[k, c]
                y = rows[k, c]
                if not (x >= 0.0 and y >= 0.0 and x < width and y < height):
                    continue
                x = (x - col0) / shrink
                y = (y - row0) / shrink
                if masked and not valid[int(y), int(x)]:
                    continue
                _bilinear(source, valid, masked, x, y, values)
                _store(out, out_valid, k, c, values, gain, offset, low, high, whole)
        return
    total = np.empty(source.shape[2])
    for k in range(out.shape[0]):
        for c in range(out.shape[1]):
            count = 0
            total[:] = 0.0
            for q in range(k * n, k * n + n):
                for p in range(c * n, c * n + n):
                    x = cols[q, p]
                    y = rows[q, p]
                    if not (x >= 0.0 and y >= 0.0 and x < width and y < height):
                        continue
                    x = (x - col0) / shrink
                    y = (y - row0) / shrink
                    if masked and not valid[int(y), int(x)]:
                        continue
                    _bilinear(source, valid, masked, x, y, values)
                    for m in range(source.shape[2]):
                        total[m] += values[m]
                    count += 1
            if 2 * count >= n * n:
                for m in range(source.shape[2]):
                    values[m] = total[m] / count
                _store(out, out_valid, k, c, values, gain, offset, low, high, whole)


@inlined
def _cubic(t, coarse):
    """Keys' weights; in 2048ths where the samples have eight bits."""
    if coarse:
        w0, w1, w2, w3 = _cubic_whole(t)
        return w0 / 2048.0, w1 / 2048.0, w2 / 2048.0, w3 / 2048.0
    return (
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    )


@kernel
def sample_cubic(source, valid, masked, cols, rows, n, place, gain, offset, low, high, whole, out, out_valid):
    """Cubic convolution with a = −0.5 (Keys 1981), bilinear where its 16 pixels are not all there.

    Parameters
    ----------
    source, valid, masked, cols, rows, n, place, gain, offset, low, high, whole, out, out_valid
        As `sample` has them.
    """
    col0, row0, shrink, width, height = place
    bands = source.shape[2]
    values = np.empty(bands)
    for k in range(out.shape[0]):
        for c in range(out.shape[1]):
            x = cols[k, c]
            y = rows[k, c]
            if not (x >= 0.0 and y >= 0.0 and x < width and y < height):
                continue
            x = (x - col0) / shrink
            y = (y - row0) / shrink
            if masked and not valid[int(y), int(x)]:
                continue
            i = int(x + 0.5) - 1
            j = int(y + 0.5) - 1
            if not _whole(valid, masked, source.shape[1], source.shape[0], i, j, 2):
                _bilinear(source, valid, masked, x, y, values)
                _store(out, out_valid, k, c, values, gain, offset, low, high, whole)
                continue
            u0, u1, u2, u3 = _cubic(x - 0.5 - i, source.itemsize == 1)
            v0, v1, v2, v3 = _cubic(y - 0.5 - j, source.itemsize == 1)
            s = source
            for m in range(bands):
                a = u0 * s[j - 1, i - 1, m] + u1 * s[j - 1, i, m] + u2 * s[j - 1, i + 1, m] + u3 * s[j - 1, i + 2, m]
                b = u0 * s[j, i - 1, m] + u1 * s[j, i, m] + u2 * s[j, i + 1, m] + u3 * s[j, i + 2, m]
                d = u0 * s[j + 1, i - 1, m] + u1 * s[j + 1, i, m] + u2 * s[j + 1, i + 1, m] + u3 * s[j + 1, i + 2, m]
                e = u0 * s[j + 2, i - 1, m] + u1 * s[j + 2, i, m] + u2 * s[j + 2, i + 1, m] + u3 * s[j + 2, i + 2, m]
                values[m] = v0 * a + v1 * b + v2 * d + v3 * e
            _store(out, out_valid, k, c, values, gain, offset, low, high, whole)


@kernel
def sample_lanczos(source, valid, masked, cols, rows, n, place, gain, offset, low, high, whole, out, out_valid):
    """Lanczos with three lobes that keeps cubic polynomials, bilinear where its 36 pixels are not all there.

    Parameters
    ----------
    source, valid, masked, cols, rows, n, place, gain, offset, low, high, whole, out, out_valid
        As `sample` has them.
    """
    col0, row0, shrink, width, height = place
    bands = source.shape[2]
    values = np.empty(bands)
    u = np.empty(6)
    v = np.empty(6)
    for k in range(out.shape[0]):
        for c in range(out.shape[1]):
            x = cols[k, c]
            y = rows[k, c]
            if not (x >= 0.0 and y >= 0.0 and x < width and y < height):
                continue
            x = (x - col0) / shrink
            y = (y - row0) / shrink
            if masked and not valid[int(y), int(x)]:
                continue
            i = int(x + 0.5) - 1
            j = int(y + 0.5) - 1
            if not _whole(valid, masked, source.shape[1], source.shape[0], i, j, 3):
                _bilinear(source, valid, masked, x, y, values)
                _store(out, out_valid, k, c, values, gain, offset, low, high, whole)
                continue
            _lanczos_weights(x - 0.5 - i, u)
            _lanczos_weights(y - 0.5 - j, v)
            for m in range(bands):
                total = 0.0
                for q in range(6):
                    line = 0.0
                    for p in range(6):
                        line += u[p] * source[j - 2 + q, i - 2 + p, m]
                    total += v[q] * line
                values[m] = total
            _store(out, out_valid, k, c, values, gain, offset, low, high, whole)


@part
def _lanczos_weights(t, weights):
    """Lanczos' weights with the least change that lets them keep polynomials of third degree.

    Cut off after three lobes the sinc does not keep a slope, even with weights that sum to one: where t is the same at
    every pixel, smooth pictures move by up to 0.02 px. Σ w qᵏ = sᵏ, k = 0 … 3, with q the taps and s the place, both
    from the middle of the six, moves none below a quarter of a cycle per pixel by more than 0.006 px, and amplitudes
    stay. Fourth degree (0.02 px) and slopes alone (0.012 px) are worse there.
    """
    s = t - 0.5
    r0 = 1.0
    r1 = s
    r2 = s * s
    r3 = s * s * s
    for p in range(6):
        d = math.pi * (t + 2.0 - p)
        q = p - 2.5
        w = 1.0 if d == 0.0 else 3.0 * math.sin(d) * math.sin(d / 3.0) / (d * d)
        weights[p] = w
        r0 -= w
        r1 -= w * q
        r2 -= w * q * q
        r3 -= w * q * q * q
    # Least squares over the six taps: Σ q² = 17.5, Σ q⁴ = 88.375, Σ q⁶ = 511.09375; even and odd powers fall apart.
    c0 = (88.375 * r0 - 17.5 * r2) / 224.0
    c1 = (511.09375 * r1 - 88.375 * r3) / 1134.0
    c2 = (6.0 * r2 - 17.5 * r0) / 224.0
    c3 = (17.5 * r3 - 88.375 * r1) / 1134.0
    for p in range(6):
        q = p - 2.5
        weights[p] += ((c3 * q + c2) * q + c1) * q + c0


_BY_NAME = {
    "nearest": sample_nearest,
    "bilinear": sample_bilinear,
    "cubic": sample_cubic,
    "lanczos": sample_lanczos,
}


def sample(
    name: str, source: AnyArray, valid: ByteArray, masked: bool, cols: FloatArray, rows: FloatArray, n: int,
    place: tuple[float, float, float, int, int], gain: FloatArray, offset: FloatArray,
    low: float, high: float, whole: bool, out: AnyArray, out_valid: ByteArray,
) -> None:  # fmt: skip
    """Values at image coordinates, where the image is seen.

    Parameters
    ----------
    name : str
        Interpolation: 'nearest', 'bilinear', 'cubic' or 'lanczos'.
    source : array (rows, cols, bands)
        Window of the image.
    valid : uint8 array (rows, cols)
        Of the window; looked at only if `masked`.
    masked : bool
    cols, rows : array (R·n, C·n)
        Image coordinates of the sub-pixels; NaN where not wanted.
    n : int
        Sub-pixels per output pixel along each axis.
    place : tuple
        First column and row of the window, reduction on reading, width and height of the image.
    gain, offset : array (bands,)
    low, high : float
        Range of the output's type.
    whole : bool
        Whether values are rounded.
    out : array (R, C, bands)
    out_valid : uint8 array (R, C)
    """
    _BY_NAME[name](source, valid, masked, cols, rows, n, place, gain, offset, low, high, whole, out, out_valid)
