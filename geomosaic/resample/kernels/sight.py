"""Following lines of sight, compiled; `resample.sight` says what is computed, and does the same in NumPy."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from geomosaic.resample.sight import NEAR, SHARE, STEP, TILE, WALL

CELL = 64


@njit(cache=True, nogil=True, error_model="numpy")
def hidden(field, relief, wanted, out):
    """Set `out` to 1 where the surface hides what is `wanted`.

    `field` is (nodes, z_middle, z_inverse, width), `relief` (heights, cells, ranges, tiles, top): see
    `resample.sight.Field` and `Relief`.
    """
    nodes, z_middle, z_inverse, width = field
    heights, cells, ranges, tiles, top = relief
    low = z_middle - (1.0 / z_inverse if z_inverse > 0.0 else 0.0)
    left, right, at = np.empty(8), np.empty(8), np.empty(8)
    for first_row in range(0, wanted.shape[0], CELL):
        for first_col in range(0, wanted.shape[1], CELL):
            ni, nj = first_row // STEP, first_col // STEP
            near = highest(nodes, ni, nj, first_row, first_col, low, top, tiles, cells.shape)
            if not near > low:
                continue
            around = heights, cells, ranges, tiles, near
            for i in range(first_row, min(first_row + CELL, wanted.shape[0])):
                v = (i + 0.5) / STEP - ni
                for k in range(8):
                    left[k] = nodes[ni, nj, k] + (nodes[ni + 1, nj, k] - nodes[ni, nj, k]) * v
                    right[k] = nodes[ni, nj + 1, k] + (nodes[ni + 1, nj + 1, k] - nodes[ni, nj + 1, k]) * v
                for j in range(first_col, min(first_col + CELL, wanted.shape[1])):
                    if not wanted[i, j]:
                        continue
                    u = (j + 0.5) / STEP - nj
                    for k in range(8):
                        at[k] = left[k] + (right[k] - left[k]) * u
                    z = bilinear(heights, at[0], at[1])
                    if not z < near:
                        continue
                    t = (z - z_middle) * z_inverse
                    sx = at[2] + t * (at[3] + t * at[4])
                    sy = at[5] + t * (at[6] + t * at[7])
                    length = math.sqrt(sx * sx + sy * sy)
                    if length > 1e-12:
                        rise = 1.0 / length
                        out[i, j] = blocked(at[0], at[1], z, sx * rise, sy * rise, rise, width, around)


@njit(cache=True, nogil=True, error_model="numpy")
def highest(nodes, ni, nj, first_row, first_col, low, top, tiles, shape):
    """Highest place that lines of sight from 64 x 64 pixels may pass; it only saves looking, and changes no answer."""
    x_low, x_high, y_low, y_high = np.inf, -np.inf, np.inf, -np.inf
    climb = top - low
    for a in range(2):
        for b in range(2):
            v, u = (first_row + a * CELL) / STEP - ni, (first_col + b * CELL) / STEP - nj
            x, y = corner(nodes, ni, nj, v, u, 0), corner(nodes, ni, nj, v, u, 1)
            for t in (-1.0, 0.0, 1.0):
                sx = corner(nodes, ni, nj, v, u, 2) + t * (
                    corner(nodes, ni, nj, v, u, 3) + t * corner(nodes, ni, nj, v, u, 4)
                )
                sy = corner(nodes, ni, nj, v, u, 5) + t * (
                    corner(nodes, ni, nj, v, u, 6) + t * corner(nodes, ni, nj, v, u, 7)
                )
                if not (math.isfinite(x + sx) and math.isfinite(y + sy)):
                    return top
                x_low, x_high = min(x_low, x, x + sx * climb), max(x_high, x, x + sx * climb)
                y_low, y_high = min(y_low, y, y + sy * climb), max(y_high, y, y + sy * climb)
    # Between these heights a line of sight may go farther aside by a little: eight nodes.
    rows, cols = tiles.shape
    r0, r1 = max(0, math.floor((y_low - 8.0) / TILE)), min(rows - 1, math.floor((y_high + 8.0) / TILE))
    c0, c1 = max(0, math.floor((x_low - 8.0) / TILE)), min(cols - 1, math.floor((x_high + 8.0) / TILE))
    found = -np.inf
    for r in range(r0, r1 + 1):
        for c in range(c0, c1 + 1):
            found = max(found, tiles[r, c])
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def corner(nodes, ni, nj, v, u, k):
    """One number of a field between nodes."""
    left = nodes[ni, nj, k] + (nodes[ni + 1, nj, k] - nodes[ni, nj, k]) * v
    right = nodes[ni, nj + 1, k] + (nodes[ni + 1, nj + 1, k] - nodes[ni, nj + 1, k]) * v
    return left + (right - left) * u


@njit(cache=True, nogil=True, error_model="numpy")
def blocked(x, y, z, ux, uy, rise, width, relief):
    """1 where the surface is in the way of one line of sight, else 0."""
    _, cells, ranges, tiles, top = relief
    high, wide = cells.shape
    col, row = math.floor(x), math.floor(y)
    step_x, step_y = (1 if ux > 0.0 else -1), (1 if uy > 0.0 else -1)
    across, down = abs(1.0 / ux), abs(1.0 / uy)
    next_x = np.inf if ux == 0.0 else (col + (ux > 0.0) - x) / ux
    next_y = np.inf if uy == 0.0 else (row + (uy > 0.0) - y) / uy
    wall = min(SHARE * rise, WALL * width)
    tile_col, tile_row, empty = -1, -1, False
    t = 0.0
    while True:
        level = z + rise * t
        if not (col >= 0 and row >= 0 and col < wide and row < high and level < top):
            return 0
        if col // TILE != tile_col or row // TILE != tile_row:
            tile_col, tile_row = col // TILE, row // TILE
            empty = tiles[tile_row, tile_col] <= level
        leave = min(next_x, next_y)
        if not empty and leave > t and cells[row, col] > level and (t >= NEAR or ranges[row, col] > wall):
            return 1
        if next_x <= next_y:
            col += step_x
            next_x += across
        else:
            row += step_y
            next_y += down
        t = leave


@njit(cache=True, nogil=True, error_model="numpy")
def bilinear(heights, x, y):
    """Height between nodes; NaN beyond them."""
    if not (x >= 0.0 and y >= 0.0 and x < heights.shape[1] - 1 and y < heights.shape[0] - 1):
        return np.nan
    i, j = int(y), int(x)
    u, v = x - j, y - i
    above = heights[i, j] * (1.0 - u) + heights[i, j + 1] * u
    below = heights[i + 1, j] * (1.0 - u) + heights[i + 1, j + 1] * u
    return above * (1.0 - v) + below * v
