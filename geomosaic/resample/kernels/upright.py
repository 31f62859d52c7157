"""Heights at the centres of output pixels, compiled; `resample.upright` says what is computed."""

from __future__ import annotations

import numpy as np
from numba import njit

from geomosaic.resample.sight import TOUCH


@njit(cache=True, nogil=True, error_model="numpy")
def upright(heights, way, wall, out):
    """Fill `out` (rows, cols) with heights at whole cols and rows."""
    a, b, c, d, e, f = way
    rows, cols = heights.shape
    for row in range(out.shape[0]):
        for col in range(out.shape[1]):
            x, y = a * col + b * row + c, d * col + e * row + f
            if not (x >= -0.5 and y >= -0.5 and x <= cols - 0.5 and y <= rows - 0.5):
                out[row, col] = np.nan
                continue
            x, y = max(x, 0.0), max(y, 0.0)
            x0, y0 = min(int(x), cols - 1), min(int(y), rows - 1)
            x1, y1 = min(x0 + 1, cols - 1), min(y0 + 1, rows - 1)
            u, v = x - x0, y - y0
            u, v = (u if u > TOUCH else 0.0), (v if v > TOUCH else 0.0)
            p, q = np.float64(heights[y0, x0]), np.float64(heights[y0, x1])
            r, s = np.float64(heights[y1, x0]), np.float64(heights[y1, x1])
            if p == q == r == s:
                out[row, col] = p
            else:
                out[row, col] = height(p, q, r, s, u, v, wall)


@njit(nogil=True, error_model="numpy", inline="always")
def height(p, q, r, s, u, v, wall):
    """Height between four nodes that are not all the same."""
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
