"""Seams that halve overlaps: a place is shown by the image whose edge towards the others is farthest away."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from geomosaic.types import AnyArray, FloatArray, IntArray


def inner_edges(outlines: Sequence[Any]) -> list[Any]:
    """The parts of each footprint's edge at which others go on: what lies on the edge of all together is left out."""
    import shapely

    tree, found = shapely.STRtree(list(outlines)), []
    for i, outline in enumerate(outlines):
        near = [outlines[int(k)] for k in tree.query(outline, predicate="intersects") if int(k) != i]
        size = max(np.hypot(outline.bounds[2] - outline.bounds[0], outline.bounds[3] - outline.bounds[1]), 1e-300)
        hair = 1e-6 * size if not outline.is_empty else 0.0
        others = shapely.union_all(near).buffer(-hair) if near else shapely.Polygon()
        found.append(outline.boundary.intersection(others))
    return found


def shown_deepest(edges: Sequence[Any], places: FloatArray, covers: AnyArray) -> IntArray:
    """Which of some images shows each place.

    For two footprints the border is the line that is equally far from both inner edges: the overlap is halved. For
    more it is the same rule, so that no place is left over and none is claimed twice.

    Parameters
    ----------
    edges : sequence of geometry
        From `inner_edges`, one per image.
    places : array (N, 2)
    covers : bool array (K, N)
        Whether an image shows a place.

    Returns
    -------
    int array (N,)
        Number of the image; the first of equals; -1 where none shows the place.
    """
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
