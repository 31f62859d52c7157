"""Lines of sight followed, compiled; `resample.occlusion` says what is computed, and does the same in NumPy.

Most places see the sensor, and most of what a surface model holds is in nobody's way. So groups of places are judged
together first: where nothing along all of their lines of sight is high enough, none of them is followed.
"""

from __future__ import annotations

import math

import numpy as np

from geomosaic.resample.kernels.compiled import kernel
from geomosaic.resample.kernels.relief import cell
from geomosaic.resample.occlusion import NEAR, SHARE, STEP, TILE, TOUCH, WALL

# Pixels along a group's side; a divisor of `STEP`.
GROUP = 16
# Parts of their lines of sight that are looked at one by one.
PARTS = 6


@kernel
def hidden(field, relief, wanted, out):
    """Places of a block that the surface hides.

    Parameters
    ----------
    field : tuple
        (nodes, z_middle, z_inverse, width), see `resample.occlusion.Field`.
    relief : tuple
        (heights, tiles, walls, top), see `resample.occlusion.Relief`.
    wanted : uint8 array (rows, cols)
        Pixels that are looked at.
    out : uint8 array (rows, cols)
        Set to 1 where hidden.
    """
    left, right, at = np.empty(8), np.empty(8), np.empty(8)
    for first_row in range(0, wanted.shape[0], GROUP):
        last_row = min(first_row + GROUP, wanted.shape[0])
        for first_col in range(0, wanted.shape[1], GROUP):
            last_col = min(first_col + GROUP, wanted.shape[1])
            if not any_of(wanted, first_row, last_row, first_col, last_col):
                continue
            end = last_level(field, relief, first_row, first_col)
            if end > -np.inf:
                for row in range(first_row, last_row):
                    follow(field, relief, end, row, first_col, last_col, wanted, (left, right, at), out)


@kernel
def follow(field, relief, end, row, first_col, last_col, wanted, room, out):
    """Lines of sight of a row of pixels of one group.

    Parameters
    ----------
    field, relief, wanted, out
        As `hidden` has them.
    end : float
        Level in metres beyond which nothing is in the way.
    row, first_col, last_col : int
        Pixels of the block; the last is not looked at.
    room : tuple of array (8,)
        Three, to work in.
    """
    nodes, z_middle, z_inverse, width = field
    heights, tiles, _, top = relief
    left, right, at = room
    i, j = row // STEP, first_col // STEP
    v = (row + 0.5) / STEP - i
    for k in range(8):
        left[k] = nodes[i, j, k] + (nodes[i + 1, j, k] - nodes[i, j, k]) * v
        right[k] = nodes[i, j + 1, k] + (nodes[i + 1, j + 1, k] - nodes[i, j + 1, k]) * v
    for col in range(first_col, last_col):
        if not wanted[row, col]:
            continue
        u = (col + 0.5) / STEP - j
        for k in range(8):
            at[k] = left[k] + (right[k] - left[k]) * u
        z = bilinear(heights, at[0], at[1])
        if not z < top:  # nor where it is not known
            continue
        t = (z - z_middle) * z_inverse
        sx = at[2] + t * (at[3] + t * at[4])
        sy = at[5] + t * (at[6] + t * at[7])
        length = math.sqrt(sx * sx + sy * sy)
        if length > 1e-12:
            rise = 1.0 / length
            wall = min(SHARE * rise, WALL * width)
            low = foot(heights, at[0], at[1], wall)
            out[row, col] = blocked(at[0], at[1], z, low, sx * rise, sy * rise, rise, wall, end, heights, tiles)


@kernel
def any_of(wanted, first_row, last_row, first_col, last_col):
    """Whether any pixel of a group is wanted.

    Parameters
    ----------
    wanted : uint8 array (rows, cols)
    first_row, last_row, first_col, last_col : int
        Of the group; the last are not in it.

    Returns
    -------
    bool
    """
    for row in range(first_row, last_row):
        for col in range(first_col, last_col):
            if wanted[row, col]:
                return True
    return False


@kernel
def last_level(field, relief, first_row, first_col):
    """Level beyond which nothing is in the way of the lines of sight from a group of places.

    Parameters
    ----------
    field, relief
        As `hidden` has them.
    first_row, first_col : int
        First pixel of the group.

    Returns
    -------
    float
        Metres; −inf where nothing is in the way at all.
    """
    # What all lines pass between two heights lies in a box. Up to `NEAR` nodes away only walls count.
    nodes, z_middle, z_inverse, _ = field
    tiles, walls, top = relief[1], relief[2], relief[3]
    ni, nj = first_row // STEP, first_col // STEP
    v, u = first_row / STEP - ni, first_col / STEP - nj
    size = GROUP / STEP
    x_low, x_high, y_low, y_high = np.inf, -np.inf, np.inf, -np.inf
    for a in range(2):
        for b in range(2):
            q, p = v + a * size, u + b * size
            x, y = corner(nodes, ni, nj, q, p, 0), corner(nodes, ni, nj, q, p, 1)
            x_low, x_high, y_low, y_high = min(x_low, x), max(x_high, x), min(y_low, y), max(y_high, y)
    if not (math.isfinite(x_low + x_high) and math.isfinite(y_low + y_high)):
        return top
    lowest, highest = between(relief[0], x_low, x_high, y_low, y_high)
    if not lowest < top:
        return -np.inf
    sx_low, sx_high, sy_low, sy_high = np.inf, -np.inf, np.inf, -np.inf
    first, last = (lowest - z_middle) * z_inverse, (highest - z_middle) * z_inverse
    # A quadratic leaves its chord over an interval h by at most h² / 4 times its leading coefficient.
    bulge = (last - first) ** 2 / 4.0
    for a in range(2):
        for b in range(2):
            q, p = v + a * size, u + b * size
            x0, x1, x2 = corner(nodes, ni, nj, q, p, 2), corner(nodes, ni, nj, q, p, 3), corner(nodes, ni, nj, q, p, 4)
            y0, y1, y2 = corner(nodes, ni, nj, q, p, 5), corner(nodes, ni, nj, q, p, 6), corner(nodes, ni, nj, q, p, 7)
            for t in (first, last):
                sx, sy = x0 + t * (x1 + t * x2), y0 + t * (y1 + t * y2)
                if not (math.isfinite(sx) and math.isfinite(sy)):
                    return top
                sx_low, sx_high = min(sx_low, sx - bulge * abs(x2)), max(sx_high, sx + bulge * abs(x2))
                sy_low, sy_high = min(sy_low, sy - bulge * abs(y2)), max(sy_high, sy + bulge * abs(y2))
    longest = math.hypot(max(abs(sx_low), abs(sx_high)), max(abs(sy_low), abs(sy_high)))
    start = lowest + (NEAR / longest if longest > 1e-12 else np.inf)
    part = (top - start) / PARTS
    for k in range(PARTS - 1, -1, -1):
        level = start + k * part
        if not level < top:
            continue
        least, most = max(0.0, level - highest), level + part - lowest
        if over(
            tiles,
            x_low + min(sx_low * least, sx_low * most),
            x_high + max(sx_high * least, sx_high * most),
            y_low + min(sy_low * least, sy_low * most),
            y_high + max(sy_high * least, sy_high * most),
            level,
        ):
            # A millimetre more, for rounding: who follows a line too far loses time only.
            return min(top, level + part + 1e-3)
    if over(walls, x_low - NEAR, x_high + NEAR, y_low - NEAR, y_high + NEAR, lowest):
        return min(top, start + 1e-3)
    return -np.inf


@kernel
def between(heights, x_low, x_high, y_low, y_high):
    """Range of the nodes that heights within a box are interpolated from.

    Parameters
    ----------
    heights : float32 array (rows, cols)
    x_low, x_high, y_low, y_high : float
        The box, in nodes.

    Returns
    -------
    lowest, highest : float
        Metres; inf and −inf where none is known.
    """
    rows, cols = heights.shape
    lowest, highest = np.inf, -np.inf
    for i in range(max(0, math.floor(y_low - 1e-6)), min(rows, math.floor(y_high + 1e-6) + 2)):
        for j in range(max(0, math.floor(x_low - 1e-6)), min(cols, math.floor(x_high + 1e-6) + 2)):
            z = heights[i, j]
            lowest, highest = (z if z < lowest else lowest), (z if z > highest else highest)
    return lowest, highest


@kernel
def over(tiles, x_low, x_high, y_low, y_high, level):
    """Whether a tile that meets a box is above a level.

    Parameters
    ----------
    tiles : float32 array
        Of `Relief`.
    x_low, x_high, y_low, y_high : float
        The box, in nodes; a cell around it counts too, for the sake of rounding.
    level : float
        Metres.

    Returns
    -------
    bool
    """
    rows, cols = tiles.shape
    r0, r1 = max(0, math.floor((y_low - 1.0) / TILE)), min(rows - 1, math.floor((y_high + 1.0) / TILE))
    c0, c1 = max(0, math.floor((x_low - 1.0) / TILE)), min(cols - 1, math.floor((x_high + 1.0) / TILE))
    for r in range(r0, r1 + 1):
        for c in range(c0, c1 + 1):
            if tiles[r, c] > level - 1e-3:
                return True
    return False


@kernel
def corner(nodes, ni, nj, v, u, k):
    """Value of a field between its nodes, bilinear.

    Parameters
    ----------
    nodes : array (rows, cols, 8)
    ni, nj : int
        Row and column of the node before.
    v, u : float
        Way to the next node, down and across, 0 to 1.
    k : int
        Which of the eight numbers.

    Returns
    -------
    float
    """
    left = nodes[ni, nj, k] + (nodes[ni + 1, nj, k] - nodes[ni, nj, k]) * v
    right = nodes[ni, nj + 1, k] + (nodes[ni + 1, nj + 1, k] - nodes[ni, nj + 1, k]) * v
    return left + (right - left) * u


@kernel
def blocked(x, y, z, low, ux, uy, rise, wall, end, heights, tiles):
    """Whether the surface is in the way of one line of sight.

    Parameters
    ----------
    x, y : float
        Place, in nodes.
    z : float
        Its height, metres.
    low : float
        Height of the foot of a wall that it may stand on, NaN where there is none.
    ux, uy : float
        Direction of the line over the ground, of unit length.
    rise : float
        Metres per node along it.
    wall : float
        Metres by which a cell must rise to be a wall.
    end : float
        Level in metres beyond which nothing is in the way.
    heights, tiles
        Of `Relief`.

    Returns
    -------
    int
        1 where it is, else 0.
    """
    high, wide = heights.shape[0] - 1, heights.shape[1] - 1
    beside = low == low
    z = low if beside else z
    col, row = math.floor(x), math.floor(y)
    step_x, step_y = (1 if ux > 0.0 else -1), (1 if uy > 0.0 else -1)
    across, down = abs(1.0 / ux), abs(1.0 / uy)
    next_x = np.inf if ux == 0.0 else (col + (ux > 0.0) - x) / ux
    next_y = np.inf if uy == 0.0 else (row + (uy > 0.0) - y) / uy
    tile_col, tile_row, empty = -1, -1, False
    t = 0.0
    while True:
        level = z + rise * t
        if not (col >= 0 and row >= 0 and col < wide and row < high and level < end):
            return 0
        if col // TILE != tile_col or row // TILE != tile_row:
            tile_col, tile_row = col // TILE, row // TILE
            empty = tiles[tile_row, tile_col] <= level
        leave = min(next_x, next_y)
        if leave > t + TOUCH:
            if beside:
                beside = False
                if shut(heights, row, col, next_x <= next_y, ux, uy, low + wall):
                    return 1
            elif not empty:
                above, rises = cell(heights, row, col)
                if above > level and (t >= NEAR or rises > wall):
                    return 1
        if next_x <= next_y:
            col += step_x
            next_x += across
        else:
            row += step_y
            next_y += down
        t = leave


@kernel
def foot(heights, x, y, wall):
    """Foot of the wall that a place may stand on: the lowest of the nodes around it.

    Parameters
    ----------
    heights : float32 array (rows, cols)
    x, y : float
        Place, in nodes.
    wall : float
        Metres between nodes beyond which a wall stands there.

    Returns
    -------
    float
        Metres; NaN where no wall stands there.
    """
    i, j = int(y), int(x)
    low, high = np.inf, -np.inf
    for a in range(2):
        for b in range(2):
            if (y - i if a else 1.0 - (y - i)) > TOUCH and (x - j if b else 1.0 - (x - j)) > TOUCH:
                node = np.float64(heights[i + a, j + b])
                low, high = min(low, node), max(high, node)
    return low if high - low > wall else np.nan


@kernel
def shut(heights, row, col, by_x, ux, uy, least):
    """Whether what rises above a level may keep a line of sight from leaving the cell that it starts in.

    Parameters
    ----------
    heights : float32 array (rows, cols)
    row, col : int
        First node of the cell.
    by_x : bool
        Whether the line leaves by an edge across x.
    ux, uy : float
        Direction of the line over the ground.
    least : float
        The level, metres.

    Returns
    -------
    bool
    """
    a, b = heights[row, col] > least, heights[row, col + 1] > least
    c, d = heights[row + 1, col] > least, heights[row + 1, col + 1] > least
    if by_x:
        way = (b or d) if ux > 0.0 else (a or c)
    else:
        way = (c or d) if uy > 0.0 else (a or b)
    if way:
        return True
    if int(a) + int(b) + int(c) + int(d) != 1:
        return False
    return (ux != 0.0 and (b or d) == (ux > 0.0)) or (uy != 0.0 and (c or d) == (uy > 0.0))


@kernel
def bilinear(heights, x, y):
    """Height between nodes.

    Parameters
    ----------
    heights : float32 array (rows, cols)
    x, y : float
        Place, in nodes.

    Returns
    -------
    float
        Metres; NaN beyond the nodes and where one is unknown.
    """
    if not (x >= 0.0 and y >= 0.0 and x < heights.shape[1] - 1 and y < heights.shape[0] - 1):
        return np.nan
    i, j = int(y), int(x)
    u, v = x - j, y - i
    above = heights[i, j] * (1.0 - u) + heights[i, j + 1] * u
    below = heights[i + 1, j] * (1.0 - u) + heights[i + 1, j + 1] * u
    return above * (1.0 - v) + below * v
