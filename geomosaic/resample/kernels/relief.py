"""Patch of heights prepared for lines of sight, compiled; `resample.occlusion.Relief` says what is computed."""

from __future__ import annotations

import numpy as np

from geomosaic.resample.kernels.compiled import inlined, kernel, part
from geomosaic.resample.occlusion import TILE


@kernel
def prepare(heights, least, gentle, tiles, walls):
    """Tiles and walls of a patch of heights, and its largest rises.

    Most tiles are even: only of the others each cell is looked at.

    Parameters
    ----------
    heights : float32 array (rows, cols)
    least : float
        Metres by which a cell must rise that may be a wall.
    gentle : float
        Metres between neighbours; smaller rises need not be known.
    tiles, walls : float32 array
        Filled, see `resample.occlusion.Relief`.

    Returns
    -------
    float32 array (2,)
        Largest rises along columns and rows, metres per node, or 0 where they are below `gentle`.
    """
    rows, cols = heights.shape
    rises = np.zeros(2, dtype=np.float32)
    high, low = np.empty(cols, dtype=np.float32), np.empty(cols, dtype=np.float32)
    for i in range(tiles.shape[0]):
        first, last = i * TILE, min(i * TILE + TILE + 1, rows)
        high[:] = -np.inf
        low[:] = np.inf
        for row in range(first, last):
            line = heights[row]
            for col in range(cols):
                z = line[col]
                high[col] = z if z > high[col] else high[col]
                low[col] = z if z < low[col] else low[col]
        for j in range(tiles.shape[1]):
            most, least_of = np.float32(-np.inf), np.float32(np.inf)
            for col in range(j * TILE, min(j * TILE + TILE + 1, cols)):
                most = high[col] if high[col] > most else most
                least_of = low[col] if low[col] < least_of else least_of
            tiles[i, j] = most
            walls[i, j] = -np.inf
            rise = np.float64(most) - least_of
            if rise > least or rise > gentle:
                end = min(j * TILE + TILE + 1, cols)
                walls[i, j] = look_at(heights, first, last, j * TILE, end, least, rises)
    return rises[0], rises[1]


@part
def look_at(heights, first_row, last_row, first_col, last_col, least, rises):
    """Highest of a tile's cells that may be walls.

    Parameters
    ----------
    heights : float32 array (rows, cols)
    first_row, last_row, first_col, last_col : int
        Nodes of the tile; the last are not in it.
    least : float
        Metres by which a cell must rise that may be a wall.
    rises : float32 array (2,)
        Largest rises so far, brought up to date.

    Returns
    -------
    float32
        Metres; −inf where there are none.
    """
    wall = np.float32(-np.inf)
    for row in range(first_row, last_row - 1):
        for col in range(first_col, last_col - 1):
            p, q = heights[row, col], heights[row, col + 1]
            r, s = heights[row + 1, col], heights[row + 1, col + 1]
            across, below, left, right = abs(q - p), abs(s - r), abs(r - p), abs(s - q)
            rises[0] = across if across > rises[0] else rises[0]
            rises[0] = below if below > rises[0] else rises[0]
            rises[1] = left if left > rises[1] else rises[1]
            rises[1] = right if right > rises[1] else rises[1]
            high, rise = cell(heights, row, col)
            if rise > least and high > wall:
                wall = high
    return wall


@inlined
def cell(heights, row, col):
    """Highest of a cell's four nodes, and its height above the lowest.

    Parameters
    ----------
    heights : float32 array (rows, cols)
    row, col : int
        First node of the cell.

    Returns
    -------
    high, rise : float32
        Metres; `high` is −inf where no node is known.
    """
    high, low = np.float32(-np.inf), np.float32(np.inf)
    for k in range(2):
        for m in range(2):
            node = heights[row + k, col + m]
            high = node if node > high else high
            low = node if node < low else low
    return high, high - low
