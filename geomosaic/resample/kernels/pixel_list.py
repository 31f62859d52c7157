"""Image coordinates of single output pixels of a block: those that `image_coordinates` gives all of them."""

from __future__ import annotations

import numpy as np

from geomosaic.resample.kernels.compiled import kernel, part
from geomosaic.resample.kernels.image_coordinates import FAR, NONE, _span


@kernel
def coordinates_of(geometry, down, along, size, cols, rows):
    """Image coordinates of single output pixels of a block.

    Parameters
    ----------
    geometry, size
        As `image_coordinates.coordinates` has them.
    down, along : int array (N,)
        Rows and columns of the pixels.
    cols, rows : array (N,)
        Filled.

    Returns
    -------
    first col, first row, last col, last row : int
        Of those that fall in the image; last col is −1 where none does.
    """
    nodes, places, heights, z_middle, z_inverse, flat, step = geometry
    left, delta = np.empty(8), np.empty(8)
    for k in range(down.shape[0]):
        row, col = down[k], along[k]
        v = (row + 0.5) / step
        j, i = int(v), col // step
        fv, u = v - j, (col + 0.5) / step - i
        for m in range(8):
            left[m] = nodes[j, i, m] + (nodes[j + 1, i, m] - nodes[j, i, m]) * fv
            delta[m] = nodes[j, i + 1, m] + (nodes[j + 1, i + 1, m] - nodes[j, i + 1, m]) * fv - left[m]
        c0, c1, c2, c3, r0, r1, r2, r3 = left
        d0, d1, d2, d3, e0, e1, e2, e3 = delta
        if flat:
            cols[k] = c0 + d0 * u
            rows[k] = r0 + e0 * u
            continue
        xa = places[j, i, 0] + (places[j + 1, i, 0] - places[j, i, 0]) * fv
        xd = places[j, i + 1, 0] + (places[j + 1, i + 1, 0] - places[j, i + 1, 0]) * fv - xa
        ya = places[j, i, 1] + (places[j + 1, i, 1] - places[j, i, 1]) * fv
        yd = places[j, i + 1, 1] + (places[j + 1, i + 1, 1] - places[j, i + 1, 1]) * fv - ya
        t = (between(heights, xa + xd * u, ya + yd * u) - z_middle) * z_inverse
        cols[k] = (((c3 + d3 * u) * t + (c2 + d2 * u)) * t + (c1 + d1 * u)) * t + (c0 + d0 * u)
        rows[k] = (((r3 + e3 * u) * t + (r2 + e2 * u)) * t + (r1 + e1 * u)) * t + (r0 + e0 * u)
    span = np.array([FAR, FAR, NONE, NONE], dtype=np.int32)
    _span(cols, rows, np.float64(size[0]), np.float64(size[1]), span)
    return span[0], span[1], span[2], span[3]


@kernel
def listed(only, need, down, along):
    """Number of the wanted pixels of wanted cells, whose rows and columns are noted.

    Parameters
    ----------
    only : bool array (rows, cols)
        Pixels that are wanted.
    need : uint8 array (rows / 64, cols / 64)
        Cells that are wanted.
    down, along : int array (N,)
        Filled from the start with rows and columns.

    Returns
    -------
    int
    """
    number = 0
    for row in range(only.shape[0]):
        cells = need[row // 64]
        for cell in range(cells.shape[0]):
            if cells[cell]:
                for col in range(64 * cell, min(64 * cell + 64, only.shape[1])):
                    if only[row, col]:
                        down[number], along[number] = row, col
                        number += 1
    return number


@part
def between(heights, x, y):
    """Bilinear height; a tap of no weight may be unknown.

    Parameters
    ----------
    heights : float32 array (rows, cols)
    x, y : float
        Place, in nodes.

    Returns
    -------
    float
        Metres; NaN farther than half a node beyond the edge.
    """
    last_col, last_row = heights.shape[1] - 1, heights.shape[0] - 1
    if not (x >= -0.5 and y >= -0.5 and x <= last_col + 0.5 and y <= last_row + 0.5):
        return np.nan
    x, y = max(x, 0.0), max(y, 0.0)
    x0, y0 = min(int(x), last_col), min(int(y), last_row)
    fx, fy = x - x0, y - y0
    x1, y1 = min(x0 + 1, last_col), min(y0 + 1, last_row)
    first, second = np.float64(heights[y0, x0]), np.float64(heights[y0, x1])
    if fy > 0.0:
        first += (heights[y1, x0] - first) * fy
        second += (heights[y1, x1] - second) * fy
    return first + (second - first) * fx if fx > 0.0 else first
