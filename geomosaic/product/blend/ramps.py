"""Weights that rise along a line."""

from __future__ import annotations

import numpy as np

from geomosaic.seam.feather import signed_distance
from geomosaic.types import AnyArray, BoolArray


def between(nodes: AnyArray, at: AnyArray, axis: int) -> AnyArray:
    """Values between nodes, linearly."""
    first = at.astype(np.int64)
    shape = [1, 1]
    shape[axis] = len(at)
    share = (at - first).reshape(shape)
    one, two = nodes.take(first, axis=axis), nodes.take(first + 1, axis=axis)
    between: AnyArray = one + (two - one) * share
    return between


def ramp(own: BoolArray, width: float) -> AnyArray:
    """0 to 1 across the edge of a mask."""
    if width <= 0:
        return own.astype(np.float64)
    weight: AnyArray = np.clip(0.5 + signed_distance(own, width / 2) / width, 0.0, 1.0)
    return weight
