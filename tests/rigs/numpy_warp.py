"""Oracle of the compiled kernels of resampling: the same operations in the same order, in NumPy."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from geomosaic.kernels.warp import Geometry, OutputScaling, Pixels
from geomosaic.types import AnyArray, FloatArray


def _nearest(source: AnyArray, valid: AnyArray, masked: bool, x: FloatArray, y: FloatArray) -> FloatArray:
    values: FloatArray = source[y.astype(np.int64), x.astype(np.int64)].astype(np.float64)
    return values


def _bilinear(source: AnyArray, valid: AnyArray, masked: bool, x: FloatArray, y: FloatArray) -> FloatArray:
    height, width, _ = source.shape
    i, j = (x + 0.5).astype(np.int64) - 1, (y + 0.5).astype(np.int64) - 1
    a, b = (x - 0.5 - i)[:, None], (y - 0.5 - j)[:, None]
    if source.itemsize == 1:  # eight bits need no finer weights, and these make every product exact
        a, b = np.floor(a * 2048.0 + 0.5) / 2048.0, np.floor(b * 2048.0 + 0.5) / 2048.0
    i0, j0, i1, j1 = np.maximum(i, 0), np.maximum(j, 0), np.minimum(i + 1, width - 1), np.minimum(j + 1, height - 1)
    taps = [(j0, i0), (j0, i1), (j1, i0), (j1, i1)]
    p00, p01, p10, p11 = (source[tap].astype(np.float64) for tap in taps)
    top, low = p00 + (p01 - p00) * a, p10 + (p11 - p10) * a
    values: FloatArray = top + (low - top) * b
    if masked:
        known = [valid[tap] > 0 for tap in taps]
        part = ~(known[0] & known[1] & known[2] & known[3])
        if part.any():
            weights = [(1.0 - a) * (1.0 - b), a * (1.0 - b), (1.0 - a) * b, a * b]
            total = np.zeros((int(part.sum()), 1))
            mean = np.zeros((int(part.sum()), source.shape[2]))
            for tap, w, k in zip(taps, weights, known, strict=True):
                share = (w * k[:, None])[part]
                total = total + share
                mean = mean + np.where(share > 0.0, share * source[tap][part], 0.0)
            values[part] = mean / total
    return values


def _convolved(
    source: AnyArray, valid: AnyArray, masked: bool, x: FloatArray, y: FloatArray, radius: int
) -> FloatArray:
    height, width, _ = source.shape
    values = _bilinear(source, valid, masked, x, y)
    i, j = (x + 0.5).astype(np.int64) - 1, (y + 0.5).astype(np.int64) - 1
    full = (i - radius + 1 >= 0) & (j - radius + 1 >= 0) & (i + radius < width) & (j + radius < height)
    span = range(1 - radius, radius + 1)
    if masked:
        for q in span:
            for p in span:
                full[full] = valid[j[full] + q, i[full] + p] > 0
    i, j = i[full], j[full]
    u = _WEIGHTS[radius](x[full] - 0.5 - i, source.itemsize == 1)
    v = _WEIGHTS[radius](y[full] - 0.5 - j, source.itemsize == 1)
    total = np.zeros((len(i), source.shape[2]))
    for q, down in zip(span, v, strict=True):
        line = np.zeros_like(total)
        for p, across in zip(span, u, strict=True):
            line = line + across[:, None] * source[j + q, i + p]
        total = total + down[:, None] * line
    values[full] = total
    return values


def _cubic_weights(t: FloatArray, coarse: bool) -> list[FloatArray]:
    weights = [
        ((-0.5 * t + 1.0) * t - 0.5) * t,
        (1.5 * t - 2.5) * t * t + 1.0,
        ((-1.5 * t + 2.0) * t + 0.5) * t,
        (0.5 * t - 0.5) * t * t,
    ]
    if coarse:
        w0, w3 = (np.trunc(weights[k] * 2048.0 - 0.5) / 2048.0 for k in (0, 3))
        w2 = np.floor(t * 2048.0 + 0.5) / 2048.0 + w0 - 2.0 * w3
        weights = [w0, 1.0 - w0 - w2 - w3, w2, w3]
    return weights


def _lanczos_weights(t: FloatArray, coarse: bool) -> list[FloatArray]:
    weights, s = [], t - 0.5
    r0, r1, r2, r3 = np.ones_like(s), s, s * s, s * s * s
    for p in range(6):
        d, q = np.pi * (t + 2.0 - p), p - 2.5
        with np.errstate(invalid="ignore", divide="ignore"):
            w = np.where(d == 0.0, 1.0, 3.0 * np.sin(d) * np.sin(d / 3.0) / (d * d))
        weights.append(w)
        r0, r1, r2, r3 = r0 - w, r1 - w * q, r2 - w * q * q, r3 - w * q * q * q
    c0, c1 = (88.375 * r0 - 17.5 * r2) / 224.0, (511.09375 * r1 - 88.375 * r3) / 1134.0
    c2, c3 = (6.0 * r2 - 17.5 * r0) / 224.0, (17.5 * r3 - 88.375 * r1) / 1134.0
    return [w + (((c3 * q + c2) * q + c1) * q + c0) for w, q in zip(weights, np.arange(6) - 2.5, strict=True)]


_WEIGHTS = {2: _cubic_weights, 3: _lanczos_weights}
VALUES: dict[str, Callable[..., FloatArray]] = {
    "nearest": _nearest,
    "bilinear": _bilinear,
    "cubic": partial(_convolved, radius=2),
    "lanczos": partial(_convolved, radius=3),
}


def coordinates(
    geometry: Geometry,
    first_row: int,
    n: int,
    size: tuple[int, int],
    need: AnyArray,
    cols: FloatArray,
    rows: FloatArray,
) -> tuple[int, int, int, int]:
    """As `kernels.warp.coordinates`."""
    nodes, places, heights, z_middle, z_inverse, flat, step = geometry
    height, width = cols.shape
    v = (first_row + (np.arange(height) + 0.5) / n) / step
    j = v.astype(np.int64)
    fv = (v - j)[:, None, None]
    i = np.arange(width) // (step * n)
    u = (np.arange(width) + 0.5) / n / step - i
    group = (first_row + np.arange(height) // n) // 64
    node_values, node_places = (_down(values, j, fv) for values in (nodes, places))
    for cell in range(-(-width // (64 * n))):
        part = slice(cell * 64 * n, min((cell + 1) * 64 * n, width))
        wanted = need[group, cell] > 0
        if not wanted.any():
            cols[:, part], rows[:, part] = np.nan, np.nan
            continue
        c = _Across(node_values, i[part], u[part])
        if flat:
            cols[:, part], rows[:, part] = c[0], c[4]
        else:
            place = _Across(node_places, i[part], u[part])
            t = (_heights(heights, place[0], place[1]) - z_middle) * z_inverse
            cols[:, part] = ((c[3] * t + c[2]) * t + c[1]) * t + c[0]
            rows[:, part] = ((c[7] * t + c[6]) * t + c[5]) * t + c[4]
        cols[~wanted, part], rows[~wanted, part] = np.nan, np.nan
    return _span(cols, rows, size)


def _down(values: FloatArray, j: AnyArray, fv: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Between rows of nodes: the left of each cell, and what is added to the right of it."""
    if len(values) == 1:  # no places where heights play no part
        return values, values
    down = values[j] + (values[j + 1] - values[j]) * fv
    return down[:, :-1], down[:, 1:] - down[:, :-1]


class _Across:
    """Coefficients (rows, cols) between columns of nodes, by number."""

    def __init__(self, down: tuple[FloatArray, FloatArray], cells: AnyArray, u: FloatArray) -> None:
        self.left, self.delta = down
        self.cells: AnyArray | slice = cells
        if cells[0] == cells[-1]:
            self.cells = slice(int(cells[0]), int(cells[0]) + 1)
        self.u = u

    def __getitem__(self, number: int) -> FloatArray:
        across: FloatArray = self.left[:, self.cells, number] + self.delta[:, self.cells, number] * self.u
        return across


def _span(cols: FloatArray, rows: FloatArray, size: tuple[int, int]) -> tuple[int, int, int, int]:
    with np.errstate(invalid="ignore"):
        seen = (cols >= 0.0) & (rows >= 0.0) & (cols < size[0]) & (rows < size[1])
    if not seen.any():
        return 2147483647, 2147483647, -1, -1
    c, r = cols[seen], rows[seen]
    return int(c.min()), int(r.min()), int(c.max()), int(r.max())


def _heights(heights: AnyArray, x: FloatArray, y: FloatArray) -> FloatArray:
    """Bilinear heights; a tap of no weight may be unknown."""
    dem_rows, dem_cols = heights.shape
    inside = (x >= -0.5) & (y >= -0.5) & (x <= dem_cols - 0.5) & (y <= dem_rows - 0.5)
    x, y = np.where(inside, np.maximum(x, 0.0), 0.0), np.where(inside, np.maximum(y, 0.0), 0.0)
    x0, y0 = np.minimum(x.astype(np.int64), dem_cols - 1), np.minimum(y.astype(np.int64), dem_rows - 1)
    fx, fy = x - x0, y - y0
    x1, y1 = np.minimum(x0 + 1, dem_cols - 1), np.minimum(y0 + 1, dem_rows - 1)
    first, second = heights[y0, x0].astype(np.float64), heights[y0, x1].astype(np.float64)
    first = np.where(fy > 0.0, first + (heights[y1, x0] - first) * fy, first)
    second = np.where(fy > 0.0, second + (heights[y1, x1] - second) * fy, second)
    first = np.where(fx > 0.0, first + (second - first) * fx, first)
    return np.where(inside, first, np.nan)


def warp(
    geometry: Geometry,
    start: int,
    n: int,
    need: AnyArray,
    pixels: Pixels,
    method: str,
    ending: OutputScaling,
    out: AnyArray,
    out_valid: AnyArray,
) -> int:
    """As `kernels.warp.warp`."""
    reach = {"nearest": 1, "bilinear": 1, "cubic": 2, "lanczos": 3}[method] * pixels.shrink
    (height, width, _), row = pixels.values.shape, start
    while row < out.shape[0]:
        for number in (min(32, out.shape[0] - row), 1):  # several rows at once, or the first of them
            places = np.empty((2, n * number, out.shape[1] * n))
            first_col, first_row, last_col, last_row = coordinates(geometry, row, n, pixels.size, need, *places)
            left, top = max(first_col - reach, 0), max(first_row - reach, 0)
            right, bottom = min(last_col + reach, pixels.size[0] - 1), min(last_row + reach, pixels.size[1] - 1)
            covered = left >= pixels.col and top >= pixels.row
            covered &= right < pixels.col + width * pixels.shrink and bottom < pixels.row + height * pixels.shrink
            if covered or last_col < 0:
                break
        else:
            return row
        rows = slice(row, row + number)
        if last_col >= 0:
            _sample(places[0], places[1], n, pixels, method, ending, out[rows], out_valid[rows])
        row += number
    return out.shape[0]


def sample(
    cols: FloatArray,
    rows: FloatArray,
    pixels: Pixels,
    method: str,
    ending: OutputScaling,
    out: AnyArray,
    out_valid: AnyArray,
) -> None:
    """As `kernels.warp.sample`."""
    _sample(cols, rows, 1, pixels, method, ending, out, out_valid)


def _sample(
    cols: FloatArray,
    rows: FloatArray,
    n: int,
    pixels: Pixels,
    name: str,
    ending: OutputScaling,
    out: AnyArray,
    out_valid: AnyArray,
) -> None:
    source, valid, col0, row0, shrink, (width, height) = pixels
    gain, offset, low, high, whole = ending
    with np.errstate(invalid="ignore"):
        inside = (cols >= 0.0) & (rows >= 0.0) & (cols < width) & (rows < height)
    x, y = (cols[inside] - col0) / shrink, (rows[inside] - row0) / shrink
    if valid is not None:
        known = valid[y.astype(np.int64), x.astype(np.int64)] > 0
        inside[inside] = known
        x, y = x[known], y[known]
    values = VALUES[name](source, valid, valid is not None, x, y)
    if n > 1:
        bands, (sub_rows, sub_cols) = source.shape[2], cols.shape
        total = np.zeros((sub_rows // n, sub_cols // n, bands))
        count = np.zeros((sub_rows // n, sub_cols // n), dtype=np.int64)
        spread = np.zeros((sub_rows, sub_cols, bands))
        spread[inside] = values
        for q in range(n):  # the same order of summation as the kernel
            for p in range(n):
                total += spread[q::n, p::n]
                count += inside[q::n, p::n]
        inside = 2 * count >= n * n
        values = total[inside] / count[inside][:, None]
    values = values * gain + offset
    if whole:
        values = np.clip(np.floor(values + 0.5), low, high)
    out[inside] = values
    out_valid[inside] = 1
