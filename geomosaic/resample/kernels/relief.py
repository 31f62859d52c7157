"""A patch of heights prepared for lines of sight, compiled; `resample.sight.Relief` says what is computed."""

from __future__ import annotations

import numpy as np
from numba import njit

from geomosaic.resample.sight import TILE


@njit(cache=True, nogil=True, error_model="numpy")
def prepare(heights, least, cells, ranges, tiles, walls):
    """Fill cells, ranges, tiles and walls; returns the largest rise along columns and rows.

    Cells that rise by more than `least` may be walls.
    """
    rises = np.zeros(2, dtype=np.float32)
    tiles[:] = -np.inf
    walls[:] = -np.inf
    for row in range(cells.shape[0]):
        for col in range(cells.shape[1]):
            p, q, r, s = heights[row, col], heights[row, col + 1], heights[row + 1, col], heights[row + 1, col + 1]
            high, low = np.float32(-np.inf), np.float32(np.inf)
            for node in (p, q, r, s):
                high, low = (node if node > high else high), (node if node < low else low)
            across, below = abs(q - p), abs(s - r)
            rises[0] = across if across > rises[0] else rises[0]
            rises[0] = below if below > rises[0] else rises[0]
            left, right = abs(r - p), abs(s - q)
            rises[1] = left if left > rises[1] else rises[1]
            rises[1] = right if right > rises[1] else rises[1]
            cells[row, col] = high
            known = high >= low
            ranges[row, col] = high - low if known else np.float32(0.0)
            i, j = row // TILE, col // TILE
            tiles[i, j] = max(tiles[i, j], high)
            if ranges[row, col] > least:
                walls[i, j] = max(walls[i, j], high)
    return rises[0], rises[1]
