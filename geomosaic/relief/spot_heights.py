"""Spot heights: prominent summits and depressions at a minimum spacing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.errors import InputError
from geomosaic.relief.contours import Heights


@dataclass(frozen=True)
class SpotHeight:
    """Summit or depression with its height and prominence.

    Attributes
    ----------
    x, y : float
        Map coordinates in the CRS of the heights.
    height : float
        Height of the node, metres.
    prominence : float
        Height difference in metres to the key saddle to higher ground (of a depression: to lower ground).
    hollow : bool
        Whether it is a depression.
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
    prominence : float
        Least prominence, metres. Summits and depressions at the edge of known heights are left out.
    spacing : float
        Least distance, map units; of two that are closer the more prominent one is kept.

    Raises
    ------
    InputError
        The prominence is not positive.
    """
    from geomosaic.relief.prominence import prominences

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
    return thinned(sorted(found, key=lambda spot: (-spot.prominence, spot.x, spot.y)), spacing)


def thinned(spots: Sequence[SpotHeight], spacing: float) -> list[SpotHeight]:
    """Spot heights at least `spacing` (map units) from all that come before them."""
    kept: list[SpotHeight] = []
    places = np.empty((len(spots), 2))
    for spot in spots:
        place = np.array([spot.x, spot.y])
        if not kept or np.hypot(*(places[: len(kept)] - place).T).min() >= spacing:
            places[len(kept)] = place
            kept.append(spot)
    return kept
