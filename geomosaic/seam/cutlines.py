"""Shares that a person has drawn: they win, and the seams laid before fill what they leave."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from geomosaic.seam.voronoi import polygonal


def with_cutlines(shares: Sequence[Any], drawn: Mapping[int, Any]) -> list[Any]:
    """Shares with some of them drawn anew.

    Parameters
    ----------
    shares : sequence of Polygon or MultiPolygon
        One per image; they share no area.
    drawn : mapping of int to Polygon or MultiPolygon
        By number of the image. Where two overlap, the image of the lower number has it.

    Returns
    -------
    list of Polygon or MultiPolygon
        They share no area. An image without a drawn share keeps what no drawn one takes.
    """
    import shapely

    taken: Any = shapely.Polygon()
    result: list[Any] = [shapely.Polygon()] * len(shares)
    for number in sorted(drawn):
        own = shapely.make_valid(drawn[number])
        # Cutting without need would move vertices by a hair, and with them what was computed before.
        result[number] = polygonal(own.difference(taken)) if matters(own.intersection(taken), own) else own
        taken = taken.union(result[number])
    tree = shapely.STRtree(list(shares))
    for number, share in enumerate(shares):
        rest = polygonal(share.difference(taken)) if len(tree.query(taken)) else share
        if matters(rest, share):
            result[number] = polygonal(result[number].union(rest))
    return result


def matters(part: Any, whole: Any) -> bool:
    """Whether an area is more than what cutting and rounding leave: a part in 10⁸ of another."""
    return bool(part.area > 1e-8 * whole.area)


def covers(drawn: Mapping[int, Any], outlines: Sequence[Any]) -> bool:
    """Whether drawn shares leave hardly anything (a millionth) of the footprints to others."""
    import shapely

    if not drawn:
        return False
    everything = shapely.union_all(list(outlines))
    return bool(everything.difference(shapely.union_all(list(drawn.values()))).area <= 1e-6 * everything.area)
