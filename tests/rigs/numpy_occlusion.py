"""Lines of sight and upright walls in NumPy: what the compiled kernels are held against, to the byte."""

from __future__ import annotations

import numpy as np

from geomosaic.resample.occlusion import SHARE, STEP, TILE, WALL, Field, Relief, Way
from geomosaic.types import BoolArray, ByteArray, Float32Array, FloatArray, IntArray

# As `kernels/occlusion.cpp` has them.
NEAR, TOUCH = 4.0, 1e-6


def prepared(heights: Float32Array, longest: float, width: float) -> Relief:
    """What `Relief.of` makes, with rises that are too gentle for anything too."""
    cells, ranges = _cells(heights)
    walls = np.where(ranges > np.float64(min(SHARE / longest, WALL * width)), cells, np.float32(-np.inf))
    tiles = _highest(cells)
    rises = (np.fmax.reduce(np.abs(np.diff(heights, axis=k)), axis=None, initial=0.0) for k in (1, 0))
    return Relief(heights, tiles, _highest(walls), float(tiles.max()), float(np.hypot(*map(float, rises))))


def _cells(heights: Float32Array) -> tuple[Float32Array, Float32Array]:
    """Highest of the four nodes of each cell, −inf where none is known, and how far it is above the lowest."""
    pairs, lower = np.fmax(heights[1:], heights[:-1]), np.fmin(heights[1:], heights[:-1])
    cells = np.fmax(pairs[:, 1:], pairs[:, :-1])
    ranges = cells - np.fmin(lower[:, 1:], lower[:, :-1])
    unknown = np.isnan(cells)
    if unknown.any():
        cells[unknown], ranges[unknown] = -np.inf, 0.0
    return cells, ranges


def _highest(cells: Float32Array) -> Float32Array:
    """Highest of each tile of cells."""
    rows, cols = -(-cells.shape[0] // TILE), -(-cells.shape[1] // TILE)
    padded = np.full((rows * TILE, cols * TILE), np.float32(-np.inf))
    padded[: cells.shape[0], : cells.shape[1]] = cells
    by_rows = np.maximum.reduce(padded.reshape(rows, TILE, cols * TILE), axis=1)
    return np.asarray(np.maximum.reduce(by_rows.reshape(rows, cols, TILE), axis=2))


def hidden(field: Field, relief: Relief, wanted: ByteArray, out: ByteArray) -> None:
    """`resample.occlusion.hidden`, all lines in step."""
    rows, cols = np.nonzero(wanted)
    if not len(rows):
        return
    x, y, sx, sy, z = _lines(field, relief.heights, rows, cols)
    length = np.sqrt(sx * sx + sy * sy)
    on = np.flatnonzero(np.isfinite(z) & (length > 1e-12))
    rise = 1.0 / length[on]
    ux, uy = sx[on] * rise, sy[on] * rise
    col, row = np.floor(x[on]), np.floor(y[on])
    with np.errstate(divide="ignore", invalid="ignore"):
        across, down = np.abs(1.0 / ux), np.abs(1.0 / uy)
        next_x = np.where(ux == 0.0, np.inf, (col + (ux > 0.0) - x[on]) / ux)
        next_y = np.where(uy == 0.0, np.inf, (row + (uy > 0.0) - y[on]) / uy)
    wall = np.minimum(SHARE * rise, WALL * field.width)
    low = _foot(relief.heights, x[on], y[on], wall)
    beside = np.isfinite(low)
    step_x, step_y = np.where(ux > 0.0, 1.0, -1.0), np.where(uy > 0.0, 1.0, -1.0)
    # One row each, so that those still on their way are kept in one go.
    state = np.stack(
        [
            np.where(beside, low, z[on]), rise, wall, step_x, step_y, across, down, ux, uy,
            col, row, next_x, next_y, np.zeros(len(on)), beside,
        ]
    )  # fmt: skip
    cells, ranges = _cells(relief.heights)
    high, wide = cells.shape
    while len(on):
        z, rise, wall, step_x, step_y, across, down, ux, uy, col, row, next_x, next_y, t, beside = state
        level = z + rise * t
        inside = (col >= 0) & (row >= 0) & (col < wide) & (row < high) & (level < relief.top)
        i, j = np.where(inside, row, 0).astype(np.int64), np.where(inside, col, 0).astype(np.int64)
        leave = np.minimum(next_x, next_y)
        passed, first, by_x = leave > t + TOUCH, beside > 0.0, next_x <= next_y
        above = ((t >= NEAR) | (ranges[i, j] > wall)) & (cells[i, j] > level)
        blocked = inside & passed & np.where(first, _shut(relief.heights, i, j, by_x, ux, uy, z + wall), above)
        out[rows[on[blocked]], cols[on[blocked]]] = 1
        state[9:] = (
            np.where(by_x, col + step_x, col),
            np.where(by_x, row, row + step_y),
            np.where(by_x, next_x + across, next_x),
            np.where(by_x, next_y, next_y + down),
            leave,
            first & ~passed,
        )
        keep = inside & ~blocked
        on, state = on[keep], state[:, keep]


def _lines(field: Field, heights: Float32Array, rows: IntArray, cols: IntArray) -> tuple[FloatArray, ...]:
    """Place, direction and height of the lines of sight of some pixels."""
    v, u = (rows + 0.5) / STEP, (cols + 0.5) / STEP
    i, j = v.astype(np.int64), u.astype(np.int64)
    v, u = v - i, u - j
    left, right = (field.nodes[i, k] + (field.nodes[i + 1, k] - field.nodes[i, k]) * v[:, None] for k in (j, j + 1))
    at = left + (right - left) * u[:, None]
    z = _bilinear(heights, at[:, 0], at[:, 1])
    t = (z - field.z_middle) * field.z_inverse
    sx = at[:, 2] + t * (at[:, 3] + t * at[:, 4])
    sy = at[:, 5] + t * (at[:, 6] + t * at[:, 7])
    return at[:, 0], at[:, 1], sx, sy, z


def _foot(heights: Float32Array, x: FloatArray, y: FloatArray, wall: FloatArray) -> FloatArray:
    """Lowest of the nodes around places where a wall stands between them; NaN where none does."""
    i, j = y.astype(np.int64), x.astype(np.int64)
    low, high = np.full(x.shape, np.inf), np.full(x.shape, -np.inf)
    for a in (0, 1):
        for b in (0, 1):
            weighs = ((y - i if a else 1.0 - (y - i)) > TOUCH) & ((x - j if b else 1.0 - (x - j)) > TOUCH)
            node = heights[i + a, j + b].astype(np.float64)
            low, high = np.where(weighs, np.minimum(low, node), low), np.where(weighs, np.maximum(high, node), high)
    return np.where(high - low > wall, low, np.nan)


def _shut(
    heights: Float32Array,
    row: IntArray,
    col: IntArray,
    by_x: BoolArray,
    ux: FloatArray,
    uy: FloatArray,
    least: FloatArray,
) -> BoolArray:
    """Whether what rises above `least` may keep lines of sight from leaving the cells that they start in."""
    # It may at the edge by which they leave; and if it is a corner alone, wherever they do not go away from it.
    (a, b), (c, d) = ((heights[row + k, col] > least, heights[row + k, col + 1] > least) for k in (0, 1))
    right, lower = b | d, c | d
    way = np.where(by_x, np.where(ux > 0.0, right, a | c), np.where(uy > 0.0, lower, a | b))
    corner = a.astype(np.int64) + b + c + d == 1
    ahead = ((ux != 0.0) & (right == (ux > 0.0))) | ((uy != 0.0) & (lower == (uy > 0.0)))
    return np.asarray(way | (corner & ahead))


def _bilinear(heights: Float32Array, x: FloatArray, y: FloatArray) -> FloatArray:
    """Bilinear heights in the kernel's order of operations; NaN beyond the nodes, or where one of four is unknown."""
    inside = (x >= 0.0) & (y >= 0.0) & (x < heights.shape[1] - 1) & (y < heights.shape[0] - 1)
    i, j = np.where(inside, y, 0.0).astype(np.int64), np.where(inside, x, 0.0).astype(np.int64)
    u, v = x - j, y - i
    above = heights[i, j] * (1.0 - u) + heights[i, j + 1] * u
    below = heights[i + 1, j] * (1.0 - u) + heights[i + 1, j + 1] * u
    return np.where(inside, above * (1.0 - v) + below * v, np.nan)


def upright(heights: Float32Array, way: Way, wall: float, out: Float32Array) -> None:
    """`resample.occlusion.upright`."""
    a, b, c, d = way
    col, row = np.meshgrid(np.arange(out.shape[1]), np.arange(out.shape[0]))
    x, y = a * col + b, c * row + d
    rows, cols = heights.shape
    inside = (x >= -0.5) & (y >= -0.5) & (x <= cols - 0.5) & (y <= rows - 0.5)
    x, y = np.where(inside, np.maximum(x, 0.0), 0.0), np.where(inside, np.maximum(y, 0.0), 0.0)
    x0, y0 = np.minimum(x.astype(np.int64), cols - 1), np.minimum(y.astype(np.int64), rows - 1)
    x1, y1 = np.minimum(x0 + 1, cols - 1), np.minimum(y0 + 1, rows - 1)
    u, v = x - x0, y - y0
    u, v = np.where(u > TOUCH, u, 0.0), np.where(v > TOUCH, v, 0.0)
    taps = [
        (heights[y0, x0].astype(np.float64), (1.0 - u) * (1.0 - v)),
        (heights[y0, x1].astype(np.float64), u * (1.0 - v)),
        (heights[y1, x0].astype(np.float64), (1.0 - u) * v),
        (heights[y1, x1].astype(np.float64), u * v),
    ]
    z, low, high = np.zeros(x.shape), np.full(x.shape, np.inf), np.full(x.shape, -np.inf)
    for node, weight in taps:
        counts = weight > TOUCH
        z = z + np.where(counts, weight * node, 0.0)
        low, high = np.where(counts, np.fmin(low, node), low), np.where(counts, np.fmax(high, node), high)
        inside = inside & ~(counts & np.isnan(node))
    low, high = np.where(inside, low, 0.0), np.where(inside, high, 0.0)
    middle = (low + high) / 2.0
    above = z > middle
    total, weights = np.zeros(x.shape), np.zeros(x.shape)
    for node, weight in taps:
        own = (weight > TOUCH) & ((node > middle) == above)
        total, weights = total + np.where(own, weight * node, 0.0), weights + np.where(own, weight, 0.0)
    with np.errstate(invalid="ignore", divide="ignore"):
        out[:] = np.where(inside, np.where(high - low > wall, total / weights, z), np.nan)
