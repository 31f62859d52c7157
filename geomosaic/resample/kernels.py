"""Numba kernels: image coordinates of output pixels, and values at them.

Each has a plain NumPy twin in `reference.py` that computes the same operations in the same order, so both give the same
bytes; the twin serves small jobs and the tests. No fastmath: results must not depend on how loops are vectorised.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

NEAREST, BILINEAR, CUBIC, LANCZOS = 0, 1, 2, 3


@njit(cache=True, nogil=True, error_model="numpy")
def coordinates(nodes, places, heights, z_middle, z_inverse, flat, step, first_row, n, size, need, cols, rows):  # type: ignore[no-untyped-def]
    """Fill `cols`, `rows` (R·n, C·n) with image coordinates of the sub-pixels of R output rows from `first_row`.

    Cells of 64 x 64 output pixels that `need` (uint8) does not want are left NaN.

    Returns the first col, first row, last col, last row of those that fall in an image of `size`; last col is −1 where
    none does.

    `nodes` (ny, nx, 8) are cubic coefficients, `places` (ny, nx, 2) node positions in the height patch (0 = centre of
    the first height), `heights` the patch. All as `sensor.lattice.Lattice` has them.
    """
    height, width = cols.shape
    dem_rows, dem_cols = heights.shape
    most_x, most_y = dem_cols - 0.5, dem_rows - 0.5
    cells = nodes.shape[1] - 1
    image_width, image_height = np.float64(size[0]), np.float64(size[1])
    none, far = np.int32(-1), np.int32(2147483647)
    least_col, least_row, most_col, most_row = far, far, none, none
    z = np.empty(width)
    across = np.empty(width)  # place of a sub-pixel between the nodes of its cell
    for c in range(width):
        across[c] = (c + 0.5) / n / step - c // (step * n)
    left = np.empty(8)
    delta = np.empty(8)
    for k in range(height):
        v = (first_row + (k + 0.5) / n) / step
        j = int(v)
        fv = v - j
        for i in range(cells):
            start = i * step * n
            stop = min(start + step * n, width)
            if not need[(first_row + k // n) // 64, i * step // 64]:
                cols[k, start:stop] = np.nan
                rows[k, start:stop] = np.nan
                continue
            for m in range(8):
                a = nodes[j, i, m] + (nodes[j + 1, i, m] - nodes[j, i, m]) * fv
                b = nodes[j, i + 1, m] + (nodes[j + 1, i + 1, m] - nodes[j, i + 1, m]) * fv
                left[m] = a
                delta[m] = b - a
            c0, c1, c2, c3, r0, r1, r2, r3 = left
            d0, d1, d2, d3, e0, e1, e2, e3 = delta
            if flat:
                for c in range(start, stop):
                    cols[k, c] = c0 + d0 * across[c]
                    rows[k, c] = r0 + e0 * across[c]
                continue
            xa = places[j, i, 0] + (places[j + 1, i, 0] - places[j, i, 0]) * fv
            xd = places[j, i + 1, 0] + (places[j + 1, i + 1, 0] - places[j, i + 1, 0]) * fv - xa
            ya = places[j, i, 1] + (places[j + 1, i, 1] - places[j, i, 1]) * fv
            yd = places[j, i + 1, 1] + (places[j + 1, i + 1, 1] - places[j, i + 1, 1]) * fv - ya
            for c in range(start, stop):
                x = xa + xd * across[c]
                y = ya + yd * across[c]
                if not (x >= -0.5 and y >= -0.5 and x <= most_x and y <= most_y):
                    z[c] = np.nan
                    continue
                # Unsigned indices spare the test for negative ones.
                x = max(x, 0.0)
                y = max(y, 0.0)
                x0 = min(np.int32(x), dem_cols - 1)
                y0 = min(np.int32(y), dem_rows - 1)
                fx = x - x0
                fy = y - y0
                x1 = np.uint64(min(x0 + 1, dem_cols - 1))
                y1 = np.uint64(min(y0 + 1, dem_rows - 1))
                xl = np.uint64(x0)
                yl = np.uint64(y0)
                top = np.float64(heights[yl, xl])
                low = np.float64(heights[y1, xl])
                if fx > 0.0:
                    top += (heights[yl, x1] - top) * fx
                    low += (heights[y1, x1] - low) * fx
                if fy > 0.0:
                    top += (low - top) * fy
                z[c] = (top - z_middle) * z_inverse
            for c in range(start, stop):
                u = across[c]
                t = z[c]
                cols[k, c] = (((c3 + d3 * u) * t + (c2 + d2 * u)) * t + (c1 + d1 * u)) * t + (c0 + d0 * u)
                rows[k, c] = (((r3 + e3 * u) * t + (r2 + e2 * u)) * t + (r1 + e1 * u)) * t + (r0 + e0 * u)
        for c in range(width):  # whole numbers, so that the loop can be vectorised
            x = cols[k, c]
            y = rows[k, c]
            seen = (x >= 0.0) & (y >= 0.0) & (x < image_width) & (y < image_height)
            col = np.int32(x)
            row = np.int32(y)
            least_col = min(least_col, col if seen else far)
            least_row = min(least_row, row if seen else far)
            most_col = max(most_col, col if seen else none)
            most_row = max(most_row, row if seen else none)
    return least_col, least_row, most_col, most_row


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _bilinear(source, valid, masked, x, y, values):  # type: ignore[no-untyped-def]
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


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _whole(valid, masked, width, height, i, j, radius):  # type: ignore[no-untyped-def]
    """Whether all taps i−radius+1 … i+radius in both directions are in the window and valid."""
    if i - radius + 1 < 0 or j - radius + 1 < 0 or i + radius >= width or j + radius >= height:
        return False
    if masked:
        for q in range(j - radius + 1, j + radius + 1):
            for p in range(i - radius + 1, i + radius + 1):
                if not valid[q, p]:
                    return False
    return True


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _store(out, out_valid, k, c, values, gain, offset, low, high, whole):  # type: ignore[no-untyped-def]
    for m in range(out.shape[2]):
        value = values[m] * gain[m] + offset[m]
        if whole:
            value = math.floor(value + 0.5)
            value = min(max(value, low), high)
        out[k, c, m] = value
    out_valid[k, c] = 1


@njit(cache=True, nogil=True, error_model="numpy")
def sample_nearest(source, valid, masked, cols, rows, n, place, gain, offset, low, high, whole, out, out_valid):  # type: ignore[no-untyped-def]
    """Value of the pixel that the point falls in; never averaged (n is 1)."""
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


@njit(cache=True, nogil=True, error_model="numpy")
def bilinear_rgb(source, cols, rows, place, gain, offset, low, high, whole, out, out_valid):  # type: ignore[no-untyped-def]
    """The commonest case, three bands of uint8 all valid, in whole numbers: several times as fast as the general one.

    Weights of 11 bits make products of 30: exact, and the same as `_bilinear` has them.
    """
    col0, row0, _, width, height = place
    last_col, last_row = source.shape[1] - 1, source.shape[0] - 1
    stride = source.shape[1] * 3
    flat = source.reshape(-1)
    plain = whole and gain[0] == 1.0 and gain[1] == 1.0 and gain[2] == 1.0
    plain = plain and offset[0] == 0.0 and offset[1] == 0.0 and offset[2] == 0.0
    one, two = np.uint64(1), np.uint64(2)
    unit, full, half = np.int32(2048), np.int32(4194304), np.int32(2097152)
    g0, g1, g2 = gain[0] / 4194304.0, gain[1] / 4194304.0, gain[2] / 4194304.0
    h0, h1, h2 = offset[0], offset[1], offset[2]
    for k in range(out.shape[0]):
        for c in range(out.shape[1]):
            x = cols[k, c]
            y = rows[k, c]
            if not (x >= 0.0 and y >= 0.0 and x < width and y < height):
                continue
            x = x - col0
            y = y - row0
            i = int(x + 0.5) - 1
            j = int(y + 0.5) - 1
            a = np.int32((x - 0.5 - i) * 2048.0 + 0.5)
            b = np.int32((y - 0.5 - j) * 2048.0 + 0.5)
            left = np.uint64(max(i, 0) * 3)
            right = np.uint64(min(i + 1, last_col) * 3)
            top = np.uint64(max(j, 0) * stride)
            below = np.uint64(min(j + 1, last_row) * stride)
            p, q, r, s = top + left, top + right, below + left, below + right
            w11 = a * b
            w01 = a * unit - w11
            w10 = b * unit - w11
            w00 = full - w01 - w10 - w11
            v0 = flat[p] * w00 + flat[q] * w01 + flat[r] * w10 + flat[s] * w11
            v1 = flat[p + one] * w00 + flat[q + one] * w01 + flat[r + one] * w10 + flat[s + one] * w11
            v2 = flat[p + two] * w00 + flat[q + two] * w01 + flat[r + two] * w10 + flat[s + two] * w11
            if plain:
                out[k, c, 0] = (v0 + half) >> 22
                out[k, c, 1] = (v1 + half) >> 22
                out[k, c, 2] = (v2 + half) >> 22
            elif whole:
                out[k, c, 0] = min(max(math.floor(v0 * g0 + h0 + 0.5), low), high)
                out[k, c, 1] = min(max(math.floor(v1 * g1 + h1 + 0.5), low), high)
                out[k, c, 2] = min(max(math.floor(v2 * g2 + h2 + 0.5), low), high)
            else:
                out[k, c, 0] = v0 * g0 + h0
                out[k, c, 1] = v1 * g1 + h1
                out[k, c, 2] = v2 * g2 + h2
            out_valid[k, c] = 1


@njit(cache=True, nogil=True, error_model="numpy")
def cubic_rgb(source, cols, rows, place, gain, offset, low, high, whole, out, out_valid):  # type: ignore[no-untyped-def]
    """Cubic convolution of three bands of uint8, all valid, in whole numbers; see `bilinear_rgb`."""
    col0, row0, _, width, height = place
    last_col, last_row = source.shape[1] - 3, source.shape[0] - 3
    stride = np.uint64(source.shape[1] * 3)
    flat = source.reshape(-1)
    plain = whole and gain[0] == 1.0 and gain[1] == 1.0 and gain[2] == 1.0
    plain = plain and offset[0] == 0.0 and offset[1] == 0.0 and offset[2] == 0.0
    one, two, half = np.uint64(1), np.uint64(2), 2097152
    least, most = int(low), int(high)
    values = np.empty(3)
    none = np.ones((1, 1), dtype=np.uint8)
    for k in range(out.shape[0]):
        for c in range(out.shape[1]):
            x = cols[k, c]
            y = rows[k, c]
            if not (x >= 0.0 and y >= 0.0 and x < width and y < height):
                continue
            x = x - col0
            y = y - row0
            i = int(x + 0.5) - 1
            j = int(y + 0.5) - 1
            if i < 1 or j < 1 or i > last_col or j > last_row:
                _bilinear(source, none, False, x, y, values)
                _store(out, out_valid, k, c, values, gain, offset, low, high, whole)
                continue
            u0, u1, u2, u3 = _cubic_whole(x - 0.5 - i)
            w0, w1, w2, w3 = _cubic_whole(y - 0.5 - j)
            p = np.uint64(j - 1) * stride + np.uint64((i - 1) * 3)
            q = p + stride
            r = q + stride
            s = r + stride
            v0 = (
                w0 * _line(flat, p, u0, u1, u2, u3)
                + w1 * _line(flat, q, u0, u1, u2, u3)
                + w2 * _line(flat, r, u0, u1, u2, u3)
                + w3 * _line(flat, s, u0, u1, u2, u3)
            )
            v1 = (
                w0 * _line(flat, p + one, u0, u1, u2, u3)
                + w1 * _line(flat, q + one, u0, u1, u2, u3)
                + w2 * _line(flat, r + one, u0, u1, u2, u3)
                + w3 * _line(flat, s + one, u0, u1, u2, u3)
            )
            v2 = (
                w0 * _line(flat, p + two, u0, u1, u2, u3)
                + w1 * _line(flat, q + two, u0, u1, u2, u3)
                + w2 * _line(flat, r + two, u0, u1, u2, u3)
                + w3 * _line(flat, s + two, u0, u1, u2, u3)
            )
            if plain:
                out[k, c, 0] = min(max((v0 + half) >> 22, least), most)
                out[k, c, 1] = min(max((v1 + half) >> 22, least), most)
                out[k, c, 2] = min(max((v2 + half) >> 22, least), most)
                out_valid[k, c] = 1
                continue
            values[0] = v0 / 4194304.0
            values[1] = v1 / 4194304.0
            values[2] = v2 / 4194304.0
            _store(out, out_valid, k, c, values, gain, offset, low, high, whole)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _line(flat, p, u0, u1, u2, u3):  # type: ignore[no-untyped-def]
    """Four pixels of one band side by side, weighted."""
    return u0 * flat[p] + u1 * flat[p + np.uint64(3)] + u2 * flat[p + np.uint64(6)] + u3 * flat[p + np.uint64(9)]


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _cubic_whole(t):  # type: ignore[no-untyped-def]
    """Keys' weights in 2048ths that sum to 2048; the outer two are negative, so cutting rounds them as the others."""
    w0 = np.int32(((-0.5 * t + 1.0) * t - 0.5) * t * 2048.0 - 0.5)
    w2 = np.int32(((-1.5 * t + 2.0) * t + 0.5) * t * 2048.0 + 0.5)
    w3 = np.int32((0.5 * t - 0.5) * t * t * 2048.0 - 0.5)
    return w0, np.int32(2048 - w0 - w2 - w3), w2, w3


@njit(cache=True, nogil=True, error_model="numpy")
def sample_bilinear(source, valid, masked, cols, rows, n, place, gain, offset, low, high, whole, out, out_valid):  # type: ignore[no-untyped-def]
    """Bilinear values; with n > 1 the mean of n × n bilinear samples, which is an average over the footprint."""
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


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _cubic(t, coarse):  # type: ignore[no-untyped-def]
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


@njit(cache=True, nogil=True, error_model="numpy")
def sample_cubic(source, valid, masked, cols, rows, n, place, gain, offset, low, high, whole, out, out_valid):  # type: ignore[no-untyped-def]
    """Cubic convolution with a = −0.5 (Keys 1981), bilinear where its 16 pixels are not all there."""
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


@njit(cache=True, nogil=True, error_model="numpy")
def sample_lanczos(source, valid, masked, cols, rows, n, place, gain, offset, low, high, whole, out, out_valid):  # type: ignore[no-untyped-def]
    """Lanczos with three lobes, weights normalised to one, bilinear where its 36 pixels are not all there."""
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


@njit(cache=True, nogil=True, error_model="numpy")
def _lanczos_weights(t, weights):  # type: ignore[no-untyped-def]
    total = 0.0
    for p in range(6):
        d = math.pi * (t + 2.0 - p)
        w = 1.0 if d == 0.0 else 3.0 * math.sin(d) * math.sin(d / 3.0) / (d * d)
        weights[p] = w
        total += w
    for p in range(6):
        weights[p] /= total


@njit(cache=True, nogil=True, error_model="numpy")
def accumulate(values, valid, weight, factor, margin, index, total, sums, best, label):  # type: ignore[no-untyped-def]
    """Add one image's weighted values to a block; `weight` is a reduced lattice with `margin` cells around it."""
    height, width, bands = values.shape
    for k in range(height):
        v = (k + 0.5) / factor - 0.5 + margin
        j = int(v)
        fv = np.float32(v - j)
        for c in range(width):
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


@njit(cache=True, nogil=True, error_model="numpy")
def finish(total, sums, low, high, whole, out, out_valid):  # type: ignore[no-untyped-def]
    """Divide by the sum of weights, round, and store."""
    for k in range(out.shape[0]):
        for c in range(out.shape[1]):
            if sums[k, c] > np.float32(0.0):
                for m in range(out.shape[2]):
                    value = np.float64(total[k, c, m] / sums[k, c])
                    if whole:
                        value = np.float64(min(max(math.floor(value + 0.5), low), high))
                    out[k, c, m] = value
                out_valid[k, c] = 1
