"""Seams halfway between the places that images see best: Voronoi cells of the centres, cut by the footprints."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from shapely import Polygon

Geometry = Any
"""A shapely Polygon or MultiPolygon."""


def regions(outlines: list[Polygon], centres: list[tuple[float, float]]) -> list[Geometry]:
    """Each image's share of the ground: where it is the nearest of the images that show it.

    Parameters
    ----------
    outlines : list of Polygon
        Footprints in the output map.
    centres : list of (x, y)
        The place each image sees best. Of two images with the same centre the first has its way.

    Returns
    -------
    list of Polygon or MultiPolygon
        They share no area, and together they cover the union of the footprints.
    """
    import shapely

    tree = shapely.STRtree(outlines)
    shares = []
    for i, outline in enumerate(outlines):
        share = outline
        for j in sorted(int(k) for k in tree.query(outline, predicate="intersects")):
            if j == i:
                continue
            nearer = _nearer(centres[j], centres[i], outline.union(outlines[j]).bounds, first=j < i)
            if nearer is not None:
                share = share.difference(outlines[j].intersection(nearer))
        shares.append(polygonal(share))
    return shares


def _nearer(
    a: tuple[float, float], b: tuple[float, float], bounds: tuple[float, float, float, float], *, first: bool
) -> Polygon | None:
    """The part of a box that is nearer to a than to b."""
    import shapely

    left, bottom, right, top = bounds
    if a == b:
        return shapely.box(left - 1, bottom - 1, right + 1, top + 1) if first else None
    middle = (np.array(a) + np.array(b)) / 2
    along = np.array(a) - np.array(b)
    along = along / np.hypot(*along)
    across = np.array([-along[1], along[0]])
    reach = 4.0 * (np.hypot(right - left, top - bottom) + np.hypot(*(np.array(a) - middle)))
    corners = [middle - across * reach, middle + across * reach]
    return shapely.Polygon([*corners, corners[1] + along * reach, corners[0] + along * reach])


def polygonal(geometry: Geometry) -> Geometry:
    """Drop the points and lines that cutting may leave."""
    import shapely

    if geometry.geom_type in ("Polygon", "MultiPolygon"):
        return geometry
    parts = [part for part in getattr(geometry, "geoms", []) if part.geom_type in ("Polygon", "MultiPolygon")]
    return shapely.union_all(parts) if parts else shapely.Polygon()
