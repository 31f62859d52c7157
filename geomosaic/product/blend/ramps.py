"""Weights that rise along a line."""

from __future__ import annotations

import numpy as np

from geomosaic.types import AnyArray


def between(nodes: AnyArray, at: AnyArray, axis: int) -> AnyArray:
    """Values between nodes, linearly."""
    first = at.astype(np.int64)
    shape = [1, 1]
    shape[axis] = len(at)
    share = (at - first).reshape(shape)
    one, two = nodes.take(first, axis=axis), nodes.take(first + 1, axis=axis)
    between: AnyArray = one + (two - one) * share
    return between
