"""Shares of images by rank: the first shows all it has, the base only what no other shows."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from geomosaic.seam.voronoi import polygonal


def by_rank(outlines: Sequence[Any], order: Sequence[int]) -> list[Any]:
    """Share of each image where images lie upon each other.

    Parameters
    ----------
    outlines : sequence of Polygon or MultiPolygon
        What each image shows.
    order : sequence of int
        All images, the uppermost first.

    Returns
    -------
    list of Polygon or MultiPolygon
        They share no area, and together they cover the union of the outlines.
    """
    import shapely

    tree = shapely.STRtree(list(outlines))
    rank = {image: place for place, image in enumerate(order)}
    shares = []
    for i, outline in enumerate(outlines):
        above = [int(j) for j in tree.query(outline, predicate="intersects") if rank[int(j)] < rank[i]]
        covered = shapely.union_all([outlines[j] for j in sorted(above)])
        shares.append(polygonal(outline.difference(covered)) if above else outline)
    return shares


def under(shares: Sequence[Any], outlines: Sequence[Any], base: int) -> list[Any]:
    """Shares without a base, and what they leave of the base's outline.

    Parameters
    ----------
    shares : sequence of Polygon or MultiPolygon
        Of all images but the base, in their order.
    outlines : sequence of Polygon or MultiPolygon
        Of all images.
    base : int
        Number of the base among all.
    """
    import shapely

    rest = polygonal(outlines[base].difference(shapely.union_all(list(shares))))
    return [*shares[:base], rest, *shares[base:]]
