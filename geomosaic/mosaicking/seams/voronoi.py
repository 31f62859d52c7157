"""Voronoi regions of image centres, halved overlaps, and regions of images that lie upon each other."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from geomosaic.types import AnyArray, FloatArray, IntArray

if TYPE_CHECKING:
    from shapely import Polygon


# A shapely Polygon or MultiPolygon.
Geometry = Any


def voronoi_regions(outlines: Sequence[Polygon], centres: Sequence[tuple[float, float]]) -> list[Geometry]:
    """Voronoi regions of image centres within footprints: where each image is the nearest that shows the ground.

    Parameters
    ----------
    outlines : sequence of Polygon
        Footprints in the output map.
    centres : list of (x, y)
        The place each image sees best. Of two images with the same centre the first has precedence.

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
    """Part of a box that is nearer to a than to b: one side of the perpendicular bisector."""
    import shapely

    left, bottom, right, top = bounds
    if a == b:
        return shapely.box(left - 1, bottom - 1, right + 1, top + 1) if first else None
    middle = (np.array(a) + np.array(b)) / 2
    along = np.array(a) - np.array(b)
    along = along / np.hypot(*along)
    across = np.array([-along[1], along[0]])
    # Long enough that the far ends of the half-plane lie beyond the box, wherever the bisector crosses it.
    reach = 4.0 * (np.hypot(right - left, top - bottom) + np.hypot(*(np.array(a) - middle)))
    corners = [middle - across * reach, middle + across * reach]
    return shapely.Polygon([*corners, corners[1] + along * reach, corners[0] + along * reach])


def polygonal(geometry: Geometry) -> Geometry:
    """Polygons of a geometry, without the points and lines that an overlay may leave.

    Parameters
    ----------
    geometry : geometry
        Of any type.

    Returns
    -------
    Polygon or MultiPolygon
        Empty where the geometry has no area.
    """
    import shapely

    if geometry.geom_type in ("Polygon", "MultiPolygon"):
        return geometry
    parts = [part for part in getattr(geometry, "geoms", []) if part.geom_type in ("Polygon", "MultiPolygon")]
    return shapely.union_all(parts) if parts else shapely.Polygon()


def inner_edges(outlines: Sequence[Any]) -> list[Any]:
    """Parts of each footprint's edge that lie within others; the edge of the whole block is left out.

    Parameters
    ----------
    outlines : sequence of Polygon
        Footprints in the output map.

    Returns
    -------
    list of geometry
        One per image; empty where no other image overlaps.
    """
    import shapely

    tree, found = shapely.STRtree(list(outlines)), []
    for i, outline in enumerate(outlines):
        near = [outlines[int(k)] for k in tree.query(outline, predicate="intersects") if int(k) != i]
        # The others shrunk by a hair: where edges coincide, the edge of the block stays outside despite rounding.
        others = shapely.union_all(near).buffer(-_hair(outline)) if near else shapely.Polygon()
        found.append(outline.boundary.intersection(others))
    return found


def shared_edges(polygons: Sequence[Any]) -> list[Any]:
    """Parts of each polygon's edge along which others lie: seams without the edge of the whole block.

    Parameters
    ----------
    polygons : sequence of Polygon or MultiPolygon
        Seam polygons in the output map; they share no area.

    Returns
    -------
    list of geometry
        One per image; empty where no other image adjoins.
    """
    import shapely

    tree, found = shapely.STRtree(list(polygons)), []
    for i, polygon in enumerate(polygons):
        near = [polygons[int(k)] for k in tree.query(polygon, predicate="intersects") if int(k) != i]
        # Widened by a hair: borders were computed from either side.
        others = shapely.union_all(near).buffer(_hair(polygon)) if near else shapely.Polygon()
        found.append(polygon.boundary.intersection(others))
    return found


def _hair(outline: Any) -> float:
    """Length in map units beside which rounding is nothing, and which is nothing beside a footprint."""
    if outline.is_empty:
        return 0.0
    left, bottom, right, top = outline.bounds
    return 1e-6 * max(float(np.hypot(right - left, top - bottom)), 1e-300)


def farthest_inside(edges: Sequence[Any], places: FloatArray, covers: AnyArray) -> IntArray:
    """Image in which each place lies deepest: farthest from the inner edges of its footprint.

    Parameters
    ----------
    edges : sequence of geometry
        From `inner_edges`, one per image.
    places : array (N, 2)
        In the output map.
    covers : bool array (K, N)
        Whether an image shows a place.

    Returns
    -------
    int array (N,)
        Number of the image; the first of equals; -1 where none shows the place.
    """
    # For two footprints the border is the line that is equally far from both inner edges: the overlap is halved. For
    # more it is the same rule, so that no place is left over and none is claimed twice.
    import shapely

    points = shapely.points(places)
    depth = np.full(covers.shape, -1.0)
    for k, edge in enumerate(edges):
        if edge.is_empty:
            depth[k, covers[k]] = np.inf
            continue
        shapely.prepare(edge)
        depth[k, covers[k]] = shapely.distance(points[covers[k]], edge)
    return np.where(covers.any(axis=0), depth.argmax(axis=0), -1)


# Candidate images of a cell: seams meet in junctions of three.
MAX_CANDIDATES = 3


def nearest_images(
    centres: FloatArray, places: FloatArray, covers: AnyArray, reach: float, most: int = MAX_CANDIDATES
) -> IntArray:
    """Candidate images of cells, the nearest first.

    Parameters
    ----------
    centres : array (K, 2)
        Of the images at hand, in map units.
    places : array (N, 2)
        Of the cells, in map units.
    covers : bool array (K, N)
        Whether an image shows a cell.
    reach : float
        Width of the zone in which a seam may run, as a part of the distance of two image centres.
    most : int
        Largest number of candidates of a cell.

    Returns
    -------
    int array (most, N)
        Numbers among the images, -1 where there are no more. A cell with one candidate is surely that one's.
    """
    found = np.full((most, len(places)), -1)
    distance = np.hypot(*(places[None] - centres[:, None]).transpose(2, 0, 1))
    # Images that do not show a cell come last, and are no candidates.
    distance = np.where(covers, distance, np.inf)
    order, each = np.argsort(distance, axis=0, kind="stable"), np.arange(len(places))
    for rank in range(min(most, len(centres))):
        spacing = np.hypot(*(centres[order[0]] - centres[order[rank]]).T)
        with np.errstate(invalid="ignore"):  # where no image is left, all distances are infinite
            excess = distance[order[rank], each] - distance[order[0], each]
            allowed = np.isfinite(distance[order[rank], each]) & (excess <= reach * spacing)
        found[rank] = np.where(allowed, order[rank], -1)
    # The second may be beyond reach where the third is not: candidates close up, so that -1 ends the list.
    closed = np.argsort(found < 0, axis=0, kind="stable")
    return np.take_along_axis(found, closed, axis=0)


def visible_regions(outlines: Sequence[Any], order: Sequence[int]) -> list[Any]:
    """Visible part of each image where images lie upon each other.

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
