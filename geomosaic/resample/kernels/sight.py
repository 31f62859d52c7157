"""Following lines of sight, compiled; `resample.sight` says what is computed, and does the same in NumPy."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from geomosaic.resample.sight import NEAR, SHARE, STEP, TILE, WALL


@njit(cache=True, nogil=True, error_model="numpy")
def hidden(field, relief, wanted, out):
    """Set `out` to 1 where the surface hides what is `wanted`.

    `field` is (nodes, z_middle, z_inverse, width), `relief` (heights, cells, ranges, tiles, top): see
    `resample.sight.Field` and `Relief`.
    """
    nodes, z_middle, z_inverse, width = field
    left, at = np.empty((nodes.shape[1], 8)), np.empty(8)
    for i in range(wanted.shape[0]):
        v = (i + 0.5) / STEP
        ni = int(v)
        v -= ni
        for n in range(nodes.shape[1]):
            for k in range(8):
                left[n, k] = nodes[ni, n, k] + (nodes[ni + 1, n, k] - nodes[ni, n, k]) * v
        for j in range(wanted.shape[1]):
            if not wanted[i, j]:
                continue
            u = (j + 0.5) / STEP
            nj = int(u)
            u -= nj
            for k in range(8):
                at[k] = left[nj, k] + (left[nj + 1, k] - left[nj, k]) * u
            z = bilinear(relief[0], at[0], at[1])
            t = (z - z_middle) * z_inverse
            sx = at[2] + t * (at[3] + t * at[4])
            sy = at[5] + t * (at[6] + t * at[7])
            length = math.sqrt(sx * sx + sy * sy)
            if math.isfinite(z) and length > 1e-12:
                rise = 1.0 / length
                out[i, j] = blocked(at[0], at[1], z, sx * rise, sy * rise, rise, width, relief)


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
