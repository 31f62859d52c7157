"""Patches of heights prepared for lines of sight, and vertical walls, compiled."""

from __future__ import annotations

import numpy as np

from geomosaic.resample.kernels.compiled import inlined, kernel, part
from geomosaic.resample.occlusion import TILE, TOUCH


@kernel
def prepare(heights, least, gentle, tiles, walls):
    """Tiles and walls of a patch of heights, and its largest rises.

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
    # Most tiles are even: only of the others each cell is looked at.
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


@kernel
def upright(heights, way, wall, out):
    """Heights at the centres of output pixels over vertical walls.

    Parameters
    ----------
    heights, way, wall, out
        As `resample.occlusion.upright` has them.
    """
    a, b, c, d = way
    rows, cols = heights.shape
    first, last, u = _along(out.shape[1], a, b, cols)
    above, below, v = _along(out.shape[0], c, d, rows)
    for row in range(out.shape[0]):
        for col in range(out.shape[1]):
            if first[col] < 0 or above[row] < 0:
                out[row, col] = np.nan
                continue
            p, q = heights[above[row], first[col]], heights[above[row], last[col]]
            r, s = heights[below[row], first[col]], heights[below[row], last[col]]
            if p == q and p == r and p == s:
                out[row, col] = p
            else:
                out[row, col] = height(np.float64(p), np.float64(q), np.float64(r), np.float64(s), u[col], v[row], wall)


@part
def _along(number, step, start, nodes):
    """Nodes before and after each pixel and the way between them; −1 beyond all."""
    first, last, way = np.empty(number, dtype=np.int64), np.empty(number, dtype=np.int64), np.empty(number)
    for k in range(number):
        x = step * k + start
        inside = x >= -0.5 and x <= nodes - 0.5
        x = max(x, 0.0) if inside else 0.0
        i = min(int(x), nodes - 1)
        first[k], last[k] = (i if inside else -1), min(i + 1, nodes - 1)
        way[k] = x - i if x - i > TOUCH else 0.0
    return first, last, way


@inlined
def height(p, q, r, s, u, v, wall):
    """Height between four nodes that are not all the same; on either side of a wall that of its own side.

    Parameters
    ----------
    p, q, r, s : float
        Heights of the upper left, upper right, lower left and lower right node, metres.
    u, v : float
        Way to the right and down, 0 to 1.
    wall : float
        Metres between nodes beyond which a wall stands there.

    Returns
    -------
    float
        Metres; NaN where a node that counts is unknown.
    """
    taps = (p, (1.0 - u) * (1.0 - v)), (q, u * (1.0 - v)), (r, (1.0 - u) * v), (s, u * v)
    z, low, high = 0.0, np.inf, -np.inf
    for node, weight in taps:
        if weight > TOUCH:
            z += weight * node
            low, high = (node if node < low else low), (node if node > high else high)
    if not high - low > wall or z != z:
        return z
    middle = (low + high) / 2.0
    above = z > middle
    total, weights = 0.0, 0.0
    for node, weight in taps:
        if weight > TOUCH and (node > middle) == above:
            total += weight * node
            weights += weight
    return total / weights
