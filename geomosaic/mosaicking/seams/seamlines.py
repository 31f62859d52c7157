"""Seamlines: what divides the shares of two images, in pieces that can be judged one by one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

HAIR = 1e-5
"""Pixels: the common edge of two shares is found although they were cut in floating point."""


@dataclass(frozen=True)
class Segment:
    """A piece of the seam between two images.

    Attributes
    ----------
    first, second : int
        Numbers of the images, first < second.
    number : int
        Among the pieces between these two, from 1, from west to east.
    line : LineString
    """

    first: int
    second: int
    number: int
    line: Any


def segments(shares: Sequence[Any], pixel: float, longest: float) -> list[Segment]:
    """Seams between all shares, in pieces of equal length that are not longer than is asked.

    Parameters
    ----------
    shares : sequence of Polygon or MultiPolygon
        One per image; they share no area.
    pixel : float
        Size of a pixel in map units.
    longest : float
        Length of a piece in map units.
    """
    import shapely

    hair = HAIR * pixel
    tree = shapely.STRtree(list(shares))
    found = []
    for i, share in enumerate(shares):
        if share.is_empty:
            continue
        for j in sorted(int(k) for k in tree.query(share, predicate="dwithin", distance=hair)):
            if j <= i or shares[j].is_empty:
                continue
            common = share.boundary.intersection(shares[j].buffer(hair))
            if common.length <= 100 * hair:
                continue
            parts = [part for part in shapely.get_parts(common) if part.geom_type == "LineString"]
            merged = shapely.get_parts(shapely.line_merge(shapely.MultiLineString(parts)))
            lines = sorted((shapely.normalize(part) for part in merged), key=lambda part: part.bounds)
            pieces = [piece for line in lines for piece in _cut(line, longest)]
            found += [Segment(i, j, number, piece) for number, piece in enumerate(pieces, start=1)]
    return found


def _cut(line: Any, longest: float) -> list[Any]:
    from shapely.ops import substring

    count = max(1, int(np.ceil(line.length / longest - 1e-9)))
    if count == 1:
        return [line]
    return [substring(line, k / count, (k + 1) / count, normalized=True) for k in range(count)]
