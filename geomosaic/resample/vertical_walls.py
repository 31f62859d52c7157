"""Heights at the centres of output pixels over vertical walls: those of the roof or of the ground, none between.

Between nodes of a roof and nodes of the ground a bilinear height is that of neither, and what an image shows there is a
wall. Where nodes around a place differ by more than a wall, it gets the weighted mean of those on its own side of their
middle height alone: walls stand upright, where the bilinear height crosses the middle. The kernel and the NumPy twin
here give the same answer.
"""

from __future__ import annotations

import numpy as np

from geomosaic.resample.occlusion import TOUCH
from geomosaic.types import Float32Array

Way = tuple[float, float, float, float]
"""From pixels to nodes: x = a · col + b, y = c · row + d."""


def upright(heights: Float32Array, way: Way, wall: float, out: Float32Array) -> None:
    """Fill `out` (rows, cols) with heights at whole cols and rows; NaN beyond the nodes and where one is unknown.

    Parameters
    ----------
    heights : float32 array (rows, cols)
        NaN where unknown.
    way : tuple of float
        From columns and rows of `out` to nodes.
    wall : float
        Metres between nodes beyond which a wall stands there.
    out : float32 array (rows, cols)
    """
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
