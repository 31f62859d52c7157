"""Heights at the centres of output pixels, compiled; `resample.vertical_walls` says what is computed."""

from __future__ import annotations

import numpy as np

from geomosaic.resample.kernels.compiled import inlined, kernel, part
from geomosaic.resample.occlusion import TOUCH


@kernel
def upright(heights, way, wall, out):
    """Heights at the centres of output pixels over vertical walls.

    Parameters
    ----------
    heights, way, wall, out
        As `resample.vertical_walls.upright` has them.
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
