"""Image coordinates of output pixels; whole blocks of three bands of eight bits, all valid, down to the value.

A row is placed, then sampled, while its coordinates are still in the processor's nearest cache; loops are split so that
those over arithmetic alone become vector instructions.
"""

from __future__ import annotations

import math

import numpy as np

from geomosaic.resample.kernels.compiled import inlined, kernel, part

NONE, EDGE, FAR = np.int32(-1), np.int32(-2), np.int32(2147483647)
UNIT, HALF, SHIFT = np.int32(2048), np.int32(2097152), 22
ONE, TWO, THREE, FOUR, FIVE = np.uint64(1), np.uint64(2), np.uint64(3), np.uint64(4), np.uint64(5)
# Three signed sums of 21 bits in a word of 64, made positive by what is added.
LANE = np.int64(2097151)
LIFT = np.int64((1 << 19) | (1 << 40) | (1 << 61))
LIFTED = np.int64(2048 << 19)


@kernel
def coordinates(geometry, first_row, n, size, need, cols, rows):
    """Image coordinates of the sub-pixels of output rows.

    Parameters
    ----------
    geometry : tuple
        (nodes, places, heights, z_middle, z_inverse, flat, step), as `sensor.lattice.Lattice` has them: `nodes`
        (ny, nx, 8) are cubic coefficients, `places` (ny, nx, 2) node positions in the height patch (0 = centre of the
        first height), `heights` the patch.
    first_row : int
        First output row.
    n : int
        Sub-pixels per output pixel along each axis.
    size : (int, int)
        Width and height of the image.
    need : uint8 array
        Cells of 64 x 64 output pixels that are wanted; the others are left NaN.
    cols, rows : array (R·n, C·n)
        Filled; (0.5, 0.5) is the centre of the first pixel of the image.

    Returns
    -------
    first col, first row, last col, last row : int
        Of those that fall in the image; last col is −1 where none does.
    """
    height, width = cols.shape
    room = _room(geometry, width, n)
    span = np.array([FAR, FAR, NONE, NONE], dtype=np.int32)
    for k in range(height):
        down, wanted = (first_row + (k + 0.5) / n) / geometry[6], need[(first_row + k // n) // 64]
        _row(geometry, n, down, wanted, room, cols[k], rows[k])
        _span(cols[k], rows[k], np.float64(size[0]), np.float64(size[1]), span)
    return span[0], span[1], span[2], span[3]


@kernel
def bilinear_rgb(geometry, size, need, source, corner, ending, out, out_valid):
    """Bilinear values of a whole block, placed and sampled row by row.

    Parameters
    ----------
    geometry, size, need
        As `coordinates` has them.
    source : uint8 array (rows, cols, 3)
        Window of the image.
    corner : (int, int)
        First column and row of the window.
    ending : tuple
        (gain, offset, low, high, whole).
    out : array (rows, cols, 3)
    out_valid : uint8 array (rows, cols)

    Returns
    -------
    int
        First row of the block that reaches beyond the window; the block's height if none does.
    """
    # Weights of 11 bits make products of 30: exact, and the same as the general kernel has them.
    height, width = out_valid.shape
    room, taps = _room(geometry, width, 1), np.empty((3, width), dtype=np.int32)
    x, y = np.empty(width), np.empty(width)
    values, plain = source.reshape(-1), _plain(ending)
    for k in range(height):
        a, b = _wanted(need[k // 64], width)
        if a == b:
            continue
        _row(geometry, 1, (k + 0.5) / geometry[6], need[k // 64], room, x, y)
        inside = _inside(x[a:b], y[a:b], size, source.shape, corner, 1)
        if inside < 0:
            return k
        if inside > 0:
            _bilinear_taps(x[a:b], y[a:b], size, source.shape, corner, taps[:, a:b])
            _bilinear_values(values, source.shape[1], taps[:, a:b], plain, ending, out[k, a:b], out_valid[k, a:b])
    return height


@kernel
def cubic_rgb(geometry, size, need, source, corner, ending, out, out_valid):
    """Cubic convolution of a whole block in whole numbers, bilinear where its 16 pixels are not all there.

    Parameters
    ----------
    geometry, size, need, source, corner, ending, out, out_valid
        As `bilinear_rgb` has them.

    Returns
    -------
    int
        First row of the block that reaches beyond the window; the block's height if none does.
    """
    height, width = out_valid.shape
    room, taps = _room(geometry, width, 1), np.empty((3, width), dtype=np.int32)
    x, y = np.empty(width), np.empty(width)
    at, across, down = np.empty(width, dtype=np.int32), np.empty((4, width), np.int32), np.empty((4, width), np.int32)
    values, packed, plain = source.reshape(-1), _packed(source), _plain(ending)
    for k in range(height):
        a, b = _wanted(need[k // 64], width)
        if a == b:
            continue
        _row(geometry, 1, (k + 0.5) / geometry[6], need[k // 64], room, x, y)
        inside = _inside(x[a:b], y[a:b], size, source.shape, corner, 2)
        if inside < 0:
            return k
        if inside == 0:
            continue
        edge = _cubic_taps(x[a:b], y[a:b], size, source.shape, corner, at[a:b], across[:, a:b], down[:, a:b])
        _cubic_values(
            packed,
            source.shape[1],
            at[a:b],
            across[:, a:b],
            down[:, a:b],
            plain,
            ending,
            out[k, a:b],
            out_valid[k, a:b],
        )
        if edge:
            _bilinear_taps(x[a:b], y[a:b], size, source.shape, corner, taps[:, a:b])
            for c in range(a, b):
                taps[0, c] = taps[0, c] if at[c] == EDGE else NONE
            _bilinear_values(values, source.shape[1], taps[:, a:b], plain, ending, out[k, a:b], out_valid[k, a:b])
    return height


@part
def _wanted(need, width):
    """First column of the first of the cells that are wanted, and where the last of them stops."""
    first, stop = 0, 0
    for cell in range(need.shape[0]):
        if need[cell]:
            first, stop = (first if stop else cell), cell + 1
    return 64 * first, min(64 * stop, width)


@part
def _room(geometry, width, n):
    """Place of each sub-pixel between the nodes of its cell; room for a row of heights; for the height of each."""
    step = geometry[6]
    across = np.empty(width)
    for c in range(width):
        across[c] = (c + 0.5) / n / step - c // (step * n)
    return across, np.empty(geometry[2].shape[1]), np.empty(width)


@part
def _row(geometry, n, v, wanted, room, cols, rows):
    """Place one row of sub-pixels, `v` steps down."""
    nodes, places, heights, z_middle, z_inverse, flat, step = geometry
    across, line, z = room
    width, wide = cols.shape[0], step * n
    j = int(v)
    fv = v - j
    left, delta = np.empty(8), np.empty(8)
    for i in range(nodes.shape[1] - 1):
        start = i * wide
        stop = min(start + wide, width)
        if not wanted[i * step // 64]:
            cols[start:stop] = np.nan
            rows[start:stop] = np.nan
            continue
        for m in range(8):
            left[m] = nodes[j, i, m] + (nodes[j + 1, i, m] - nodes[j, i, m]) * fv
            delta[m] = nodes[j, i + 1, m] + (nodes[j + 1, i + 1, m] - nodes[j, i + 1, m]) * fv - left[m]
        c0, c1, c2, c3, r0, r1, r2, r3 = left
        d0, d1, d2, d3, e0, e1, e2, e3 = delta
        if flat:
            for c in range(start, stop):
                cols[c] = c0 + d0 * across[c]
                rows[c] = r0 + e0 * across[c]
            continue
        xa = places[j, i, 0] + (places[j + 1, i, 0] - places[j, i, 0]) * fv
        xd = places[j, i + 1, 0] + (places[j + 1, i + 1, 0] - places[j, i + 1, 0]) * fv - xa
        ya = places[j, i, 1] + (places[j + 1, i, 1] - places[j, i, 1]) * fv
        yd = places[j, i + 1, 1] + (places[j + 1, i + 1, 1] - places[j, i + 1, 1]) * fv - ya
        xb = xa + xd * across[stop - 1]
        along = yd == 0.0 and ya >= 0.0 and ya <= heights.shape[0] - 0.5
        if along and min(xa, xb) >= 0.0 and max(xa, xb) < heights.shape[1] - 1:
            _heights_along(heights, xa, xd, xb, ya, across[start:stop], line, z[start:stop])
        else:
            _heights(heights, xa, xd, ya, yd, across[start:stop], z[start:stop])
        for c in range(start, stop):
            u = across[c]
            t = (z[c] - z_middle) * z_inverse
            cols[c] = (((c3 + d3 * u) * t + (c2 + d2 * u)) * t + (c1 + d1 * u)) * t + (c0 + d0 * u)
            rows[c] = (((r3 + e3 * u) * t + (r2 + e2 * u)) * t + (r1 + e1 * u)) * t + (r0 + e0 * u)


@part
def _heights_along(heights, xa, xd, xb, y, across, line, z):
    """Heights of sub-pixels that lie along a row of heights: down once per height, then across once per sub-pixel."""
    y0 = min(np.int32(y), heights.shape[0] - 1)
    y1 = min(y0 + 1, heights.shape[0] - 1)
    fy = y - y0
    for x in range(int(min(xa, xb)), int(max(xa, xb)) + 2):
        top = np.float64(heights[y0, x])
        line[x] = top + (heights[y1, x] - top) * fy if fy > 0.0 else top
    for c in range(across.shape[0]):
        x = xa + xd * across[c]
        x0 = np.int32(x)
        fx = x - x0
        at = np.uint64(np.uint32(x0))
        first = line[at]
        second = first + (line[at + ONE] - first) * fx
        z[c] = second if fx > 0.0 else first


@part
def _heights(heights, xa, xd, ya, yd, across, z):
    """Bilinear heights; a tap of no weight may be unknown."""
    dem_rows, dem_cols = heights.shape
    most_x, most_y = dem_cols - 0.5, dem_rows - 0.5
    for c in range(across.shape[0]):
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
        first = np.float64(heights[yl, xl])
        second = np.float64(heights[yl, x1])
        if fy > 0.0:
            first += (heights[y1, xl] - first) * fy
            second += (heights[y1, x1] - second) * fy
        z[c] = first + (second - first) * fx if fx > 0.0 else first


@part
def _span(cols, rows, width, height, span):
    """Widen `span` by what falls in the image; in whole numbers, so that the loop can be vectorised."""
    least_col, least_row, most_col, most_row = span[0], span[1], span[2], span[3]
    for c in range(cols.shape[0]):
        x = cols[c]
        y = rows[c]
        seen = (x >= 0.0) & (y >= 0.0) & (x < width) & (y < height)
        col = np.int32(x)
        row = np.int32(y)
        least_col = min(least_col, col if seen else FAR)
        least_row = min(least_row, row if seen else FAR)
        most_col = max(most_col, col if seen else NONE)
        most_row = max(most_row, row if seen else NONE)
    span[0], span[1], span[2], span[3] = least_col, least_row, most_col, most_row


@part
def _inside(x, y, size, shape, corner, radius):
    """Judge a row: 1 if all its taps lie in the window, or beyond the image; −1 if not; 0 if it is not seen."""
    span = np.array([FAR, FAR, NONE, NONE], dtype=np.int32)
    _span(x, y, np.float64(size[0]), np.float64(size[1]), span)
    if span[2] < 0:
        return 0
    first_col, first_row = max(span[0] - radius, 0), max(span[1] - radius, 0)
    last_col, last_row = min(span[2] + radius, size[0] - 1), min(span[3] + radius, size[1] - 1)
    here = first_col >= corner[0] and first_row >= corner[1]
    here = here and last_col < corner[0] + shape[1] and last_row < corner[1] + shape[0]
    return 1 if here else -1


@part
def _plain(ending):
    """Whether values stay what they are."""
    gain, offset, _, _, whole = ending
    for k in range(gain.shape[0]):
        whole &= gain[k] == 1.0 and offset[k] == 0.0
    return whole


@part
def _bilinear_taps(xs, ys, size, shape, corner, taps):
    """Upper-left of four pixels in the flat window, −1 outside the image; weights right and below in 2048ths."""
    # The window's edge repeats: a point beyond its last pixel centres gets all the weight of the nearest.
    width, height = np.float64(size[0]), np.float64(size[1])
    stride, last_col, last_row = np.int32(shape[1] * 3), np.int32(shape[1] - 2), np.int32(shape[0] - 2)
    col0, row0 = np.float64(corner[0]), np.float64(corner[1])
    at, a, b = taps
    for c in range(xs.shape[0]):
        x = xs[c]
        y = ys[c]
        seen = (x >= 0.0) & (y >= 0.0) & (x < width) & (y < height)
        x = x - col0
        y = y - row0
        i = np.int32(x + 0.5) - np.int32(1)
        j = np.int32(y + 0.5) - np.int32(1)
        inner_i = min(max(i, np.int32(0)), last_col)
        inner_j = min(max(j, np.int32(0)), last_row)
        right = np.int32((x - 0.5 - i) * 2048.0 + 0.5)
        below = np.int32((y - 0.5 - j) * 2048.0 + 0.5)
        a[c] = right if i == inner_i else (UNIT if i > inner_i else np.int32(0))
        b[c] = below if j == inner_j else (UNIT if j > inner_j else np.int32(0))
        at[c] = inner_j * stride + inner_i * np.int32(3) if seen else NONE


@inlined
def _between(values, p, q, r, s, a, b):
    """Bilinear value in units of 2⁻²²."""
    first = np.int32(values[p])
    second = np.int32(values[r])
    first = first * UNIT + (np.int32(values[q]) - first) * a
    second = second * UNIT + (np.int32(values[s]) - second) * a
    return first * UNIT + (second - first) * b


@part
def _bilinear_values(values, columns, taps, plain, ending, out, out_valid):
    stride = np.uint64(columns * 3)
    at, a, b = taps
    for c in range(at.shape[0]):
        if at[c] < 0:
            continue
        p = np.uint64(np.uint32(at[c]))
        r = p + stride
        v0 = _between(values, p, p + THREE, r, r + THREE, a[c], b[c])
        v1 = _between(values, p + ONE, p + FOUR, r + ONE, r + FOUR, a[c], b[c])
        v2 = _between(values, p + TWO, p + FIVE, r + TWO, r + FIVE, a[c], b[c])
        if plain:
            out[c, 0] = (v0 + HALF) >> SHIFT
            out[c, 1] = (v1 + HALF) >> SHIFT
            out[c, 2] = (v2 + HALF) >> SHIFT
        else:
            _put(v0, v1, v2, ending, out, c)
        out_valid[c] = 1


@inlined
def _put(v0, v1, v2, ending, out, c):
    """Store three values in units of 2⁻²² with gain and offset."""
    gain, offset, low, high, whole = ending
    w0 = v0 / 4194304.0 * gain[0] + offset[0]
    w1 = v1 / 4194304.0 * gain[1] + offset[1]
    w2 = v2 / 4194304.0 * gain[2] + offset[2]
    if whole:
        out[c, 0] = min(max(math.floor(w0 + 0.5), low), high)
        out[c, 1] = min(max(math.floor(w1 + 0.5), low), high)
        out[c, 2] = min(max(math.floor(w2 + 0.5), low), high)
    else:
        out[c, 0] = w0
        out[c, 1] = w1
        out[c, 2] = w2


@part
def _packed(source):
    """Three bands of a pixel in one word, 21 bits apart, so that one product serves all three."""
    packed = np.empty(source.shape[0] * source.shape[1], dtype=np.int64)
    values = source.reshape(-1)
    for p in range(packed.shape[0]):
        q = np.uint64(3 * p)
        packed[p] = np.int64(values[q]) | np.int64(values[q + ONE]) << 21 | np.int64(values[q + TWO]) << 42
    return packed


@inlined
def _keys(t):
    """Keys' weights in 2048ths, rounded; the outer two are negative, the inner two keep even ground and a slope."""
    w0 = np.int32(((-0.5 * t + 1.0) * t - 0.5) * t * 2048.0 - 0.5)
    w3 = np.int32((0.5 * t - 0.5) * t * t * 2048.0 - 0.5)
    w2 = np.int32(t * 2048.0 + 0.5) + w0 - np.int32(2) * w3
    return w0, UNIT - w0 - w2 - w3, w2, w3


@part
def _cubic_taps(xs, ys, size, shape, corner, at, u, w):
    """First of 16 pixels in the packed window, −1 outside the image, −2 where some are missing; weights both ways."""
    width, height = np.float64(size[0]), np.float64(size[1])
    stride, last_col, last_row = np.int32(shape[1]), np.int32(shape[1] - 3), np.int32(shape[0] - 3)
    col0, row0 = np.float64(corner[0]), np.float64(corner[1])
    edge = np.int32(0)
    for c in range(xs.shape[0]):
        x = xs[c]
        y = ys[c]
        seen = (x >= 0.0) & (y >= 0.0) & (x < width) & (y < height)
        x = x - col0
        y = y - row0
        i = np.int32(x + 0.5) - np.int32(1)
        j = np.int32(y + 0.5) - np.int32(1)
        full = (i >= 1) & (j >= 1) & (i <= last_col) & (j <= last_row)
        first = (j - np.int32(1)) * stride + i - np.int32(1)
        at[c] = (first if full else EDGE) if seen else NONE
        edge += np.int32(seen & (not full))
        u[0, c], u[1, c], u[2, c], u[3, c] = _keys(x - 0.5 - i)
        w[0, c], w[1, c], w[2, c], w[3, c] = _keys(y - 0.5 - j)
    return edge


@inlined
def _sums(packed, p, u0, u1, u2, u3):
    """Weighted sums over four pixels side by side, all three bands at once."""
    return packed[p] * u0 + packed[p + ONE] * u1 + packed[p + TWO] * u2 + packed[p + THREE] * u3 + LIFT


@part
def _cubic_values(packed, columns, at, u, w, plain, ending, out, out_valid):
    stride = np.uint64(columns)
    least, most = int(max(ending[2], -2147483648.0)), int(min(ending[3], 2147483647.0))
    for c in range(at.shape[0]):
        if at[c] < 0:
            continue
        p = np.uint64(np.uint32(at[c]))
        u0, u1, u2, u3 = np.int64(u[0, c]), np.int64(u[1, c]), np.int64(u[2, c]), np.int64(u[3, c])
        w0, w1, w2, w3 = np.int64(w[0, c]), np.int64(w[1, c]), np.int64(w[2, c]), np.int64(w[3, c])
        q = p + stride
        r = q + stride
        s0, s1 = _sums(packed, p, u0, u1, u2, u3), _sums(packed, q, u0, u1, u2, u3)
        s2, s3 = _sums(packed, r, u0, u1, u2, u3), _sums(packed, r + stride, u0, u1, u2, u3)
        v0 = (s0 & LANE) * w0 + (s1 & LANE) * w1 + (s2 & LANE) * w2 + (s3 & LANE) * w3 - LIFTED
        v1 = (s0 >> 21 & LANE) * w0 + (s1 >> 21 & LANE) * w1 + (s2 >> 21 & LANE) * w2 + (s3 >> 21 & LANE) * w3 - LIFTED
        v2 = (s0 >> 42 & LANE) * w0 + (s1 >> 42 & LANE) * w1 + (s2 >> 42 & LANE) * w2 + (s3 >> 42 & LANE) * w3 - LIFTED
        if plain:
            out[c, 0] = min(max((v0 + HALF) >> SHIFT, least), most)
            out[c, 1] = min(max((v1 + HALF) >> SHIFT, least), most)
            out[c, 2] = min(max((v2 + HALF) >> SHIFT, least), most)
        else:
            _put(v0, v1, v2, ending, out, c)
        out_valid[c] = 1
