"""Linear and bilinear interpolation between the nodes of a grid."""

from __future__ import annotations

import numpy as np

from geomosaic.types import AnyArray, BoolArray, FloatArray, IntArray


def interval(at: AnyArray, count: int) -> tuple[IntArray, FloatArray]:
    """Interval between nodes, and the part of it, in which places along an axis lie.

    Parameters
    ----------
    at : array (N,)
        Places in node numbers; those beyond the `count` nodes count as the ends.
    count : int

    Returns
    -------
    first : int array
        Number of the node before each place, 0 to count − 2.
    part : array
        0 at that node, 1 at the next.
    """
    inside = np.minimum(np.maximum(at, 0.0), count - 1.0)
    first = np.minimum(inside.astype(np.int64), count - 2)
    return first, inside - first


def bilinear(nodes: AnyArray, first: IntArray, weight: FloatArray, least: float = 0.0) -> FloatArray:
    """Bilinear values from nodes of which some may be unknown.

    Parameters
    ----------
    nodes : array (rows, cols)
        NaN where unknown.
    first : int array (N, 2)
        Column and row of the upper-left of the four nodes.
    weight : array (N, 2)
        Of the right and the lower nodes, 0 to 1.
    least : float
        A node of at most this weight does not count, known or not.

    Returns
    -------
    array (N,)
        NaN where a node that counts is unknown.
    """
    rows, cols = nodes.shape
    col, row = first[:, 0], first[:, 1]
    right, lower = np.minimum(col + 1, cols - 1), np.minimum(row + 1, rows - 1)
    u, v = weight[:, 0], weight[:, 1]
    total: FloatArray = np.zeros(len(first))
    for r, c, share in (
        (row, col, (1 - u) * (1 - v)),
        (row, right, u * (1 - v)),
        (lower, col, (1 - u) * v),
        (lower, right, u * v),
    ):
        counts: BoolArray = share > least
        total += np.where(counts, nodes[r, c] * share, 0.0)
    return total
