"""Spot heights: prominent summits and depressions at a minimum spacing.

Nodes are taken from the highest down. A node without a higher neighbour starts a hill; one that has several joins
their hills, of which the highest lives on. The prominence of the others is their height above that node, their key
saddle (E. W. Weisstein and others call it so; in computational topology it is the persistence of a maximum).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.errors import InputError
from geomosaic.kernels.library import native
from geomosaic.relief.contour_smoothing import Heights
from geomosaic.types import AnyArray, FloatArray

_prominences = native("prominences", "dliid")


def prominences(values: AnyArray) -> FloatArray:
    """Prominence of each node in the units of its height.

    Parameters
    ----------
    values : array (rows, cols), heights; NaN where unknown. Neighbours are the eight around a node.

    Returns
    -------
    array (rows, cols)
        0 for nodes that are no summit; for the highest summit of a connected component its height above the lowest
        node there. A plateau has one summit. Summits at the edge of known heights are 0: ground may rise beyond.
    """
    heights = np.ascontiguousarray(values, dtype=np.float64).ravel()
    rows, cols = values.shape
    known = np.flatnonzero(np.isfinite(heights))
    order = known[np.argsort(-heights[known], kind="stable")]
    found = np.zeros(heights.size)
    _prominences(heights, order, rows, cols, found)
    tops = np.flatnonzero(found > 0)
    row, col = np.divmod(tops, cols)
    inner = (row > 0) & (row < rows - 1) & (col > 0) & (col < cols - 1)
    for step in (-cols - 1, -cols, -cols + 1, -1, 1, cols - 1, cols, cols + 1):
        inner[inner] &= np.isfinite(heights[tops[inner] + step])
    found[tops[~inner]] = 0.0
    return found.reshape(rows, cols)


@dataclass(frozen=True)
class SpotHeight:
    """Summit or depression with its height and prominence.

    Attributes
    ----------
    x, y : float, map coordinates in the CRS of the heights
    height : float, height of the node, metres
    prominence : float
        Height difference in metres to the key saddle to higher ground (of a depression: to lower ground).
    hollow : bool, whether it is a depression
    """

    x: float
    y: float
    height: float
    prominence: float
    hollow: bool


def find_spots(heights: Heights, prominence: float, spacing: float) -> list[SpotHeight]:
    """Spot heights of a height grid, the most prominent first.

    Parameters
    ----------
    heights : Heights
    prominence : float, least prominence, metres. Summits and depressions at the edge of known heights are left out.
    spacing : float, least distance, map units; of two that are closer the more prominent one is kept

    Raises
    ------
    InputError
        The prominence is not positive.
    """
    if not (prominence > 0 and np.isfinite(prominence)):
        raise InputError(f"{prominence:g} is no prominence of spot heights", hint="give metres, such as 5")
    if not np.isfinite(heights.values).any():
        return []
    found: list[SpotHeight] = []
    t = heights.transform
    for hollow in (False, True):
        rise = prominences(-heights.values if hollow else heights.values)
        for row, col in np.argwhere(rise >= prominence).tolist():
            x, y = t.a * (col + 0.5) + t.b * (row + 0.5) + t.c, t.d * (col + 0.5) + t.e * (row + 0.5) + t.f
            found.append(SpotHeight(x, y, float(heights.values[row, col]), float(rise[row, col]), hollow))
    return _thinned(sorted(found, key=lambda spot: (-spot.prominence, spot.x, spot.y)), spacing)


def _thinned(spots: Sequence[SpotHeight], spacing: float) -> list[SpotHeight]:
    """Spot heights at least `spacing` (map units) from all that come before them."""
    kept: list[SpotHeight] = []
    places = np.empty((len(spots), 2))
    for spot in spots:
        place = np.array([spot.x, spot.y])
        if not kept or np.hypot(*(places[: len(kept)] - place).T).min() >= spacing:
            places[len(kept)] = place
            kept.append(spot)
    return kept
