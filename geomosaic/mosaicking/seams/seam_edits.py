"""Edits of seams: areas given to another image, seams redrawn and dragged, shares cut by a line.

The shares of a mosaic are a coverage: neighbours have the same vertices along their common border. Each edit adds lines
to the borders of the shares that it touches, takes the faces of all these lines together, and gives each face to one
image. Neighbours then share their vertices again, so that no edit leaves a gap or an overlap.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from geomosaic.errors import InputError
from geomosaic.mosaicking.seams.seam_faces import SeamFaces
from geomosaic.mosaicking.seams.seam_graph import Edge, SeamGraph, edge_between
from geomosaic.mosaicking.seams.voronoi import polygonal
from geomosaic.types import FloatArray


def given(shares: Sequence[Any], area: Any, image: int, step: float) -> list[Any]:
    """Shares after an area was given to one image.

    Parameters
    ----------
    shares : sequence of Polygon or MultiPolygon
        One per image; they share no area. Their vertices lie on multiples of the step, see `partition.canonical`.
    area : Polygon or MultiPolygon
        In the same map. What no share covers stays without an image.
    image : int
        Number of the image.
    step : float
        Map units, a tiny part of a pixel: vertices lie on its multiples.

    Returns
    -------
    list of Polygon or MultiPolygon
        Shares that have not changed are the same objects.

    Raises
    ------
    InputError
        The area crosses itself, or the image shows all of it already.
    """
    import shapely

    if not area.is_valid or area.area <= 0:
        raise InputError("the outline of the area crosses itself", hint="draw it again, without crossing lines")
    faces = SeamFaces.of(shares, [area.boundary], step, within=area, also=(image,))
    inside = shapely.contains_xy(area, *faces.places.T)
    owners = [image if within else owner for owner, within in zip(faces.owners, inside, strict=True)]
    if owners == faces.owners:
        raise InputError("the image shows all of this area already", hint="choose another image, or another area")
    return faces.shares(shares, owners)


def cut(shares: Sequence[Any], line: Any, step: float) -> list[tuple[int, Any]]:
    """Pieces into which a line cuts the shares that it crosses.

    Parameters
    ----------
    shares : sequence of Polygon or MultiPolygon
    line : LineString
    step : float

    Returns
    -------
    list of (int, Polygon)
        Number of the image and the piece, the smallest first.

    Raises
    ------
    InputError
        The line divides no share.
    """
    faces = SeamFaces.of(shares, [line], step)
    added = faces.added
    found = [
        (owner, face)
        for owner, face, edges in zip(faces.owners, faces.faces, faces.edges, strict=True)
        if not added.isdisjoint(edges)
    ]
    if not found:
        raise InputError("the line divides no image's area", hint="draw it from border to border across one")
    return sorted(found, key=lambda piece: piece[1].area)


def redrawn(shares: Sequence[Any], line: Any, step: float) -> list[Any]:
    """Shares whose seams follow a line between the places where the line meets a seam first and last.

    It may begin on one seam and end on another. What lies between it and the shortest way along seams goes to the image
    on the other side of that way: where there are several, to the one at the seam on which the line begins.

    Parameters
    ----------
    shares : sequence of Polygon or MultiPolygon
    line : LineString
        Begins and ends on a seam or beyond it.
    step : float

    Returns
    -------
    list of Polygon or MultiPolygon

    Raises
    ------
    InputError
        The line encloses no area together with seams.
    """
    import shapely
    from shapely.ops import substring

    # Ways run along the borders of what the line crosses, thus also along those with images that it does not touch.
    crossed = shapely.STRtree(list(shares)).query(line, predicate="dwithin", distance=3 * step).tolist()
    area = shapely.union_all([shares[i] for i in crossed], grid_size=step)
    faces = SeamFaces.of(shares, [line], step, within=area)
    graph = SeamGraph.of(faces.seam_edges(set(crossed)), step)
    met = graph.on(line)
    way = graph.shortest(met[0], met[-1]) if len(met) > 1 else []
    if len(way) > 1:
        old = shapely.LineString([graph.place(vertex) for vertex in way])
        ends = [line.project(shapely.Point(graph.place(vertex))) for vertex in (way[0], way[-1])]
        after = _swept(shares, old, substring(line, *ends), step)
        if after is not None:
            return after
    raise InputError(
        "the line encloses nothing together with seams",
        hint="begin and end it on seams that meet, within the mosaic; or give an area to an image instead",
    )


def dragged(shares: Sequence[Any], place: FloatArray, to: FloatArray, reach: float, step: float) -> list[Any]:
    """Shares after a seam was taken at one place and dragged to another.

    It runs straight to the new place from `reach` away on either side, or from its end. The image from whose side it is
    dragged gets all that it sweeps over, also from third images. Where seams meet within `reach` / 4 of the place,
    their junction is dragged with all of them.

    Parameters
    ----------
    shares : sequence of Polygon or MultiPolygon
    place, to : float array (2,)
        In the map; the place is moved onto the nearest seam.
    reach : float
        Map units along the seam.
    step : float

    Returns
    -------
    list of Polygon or MultiPolygon

    Raises
    ------
    InputError
        There is no seam within `reach` of the place, or it sweeps over nothing.
    """
    import shapely

    faces = SeamFaces.of(shares, [], step, within=shapely.Point(place).buffer(reach))
    graph = SeamGraph.of(faces.seam_edges(), step)
    legs = graph.around(np.asarray(place, dtype=np.float64), reach)
    if len(legs) > 2:
        dropped = {edge_between(a, b) for leg in legs for a, b in pairwise(leg.vertices)}
        lines = [shapely.LineString([graph.place(leg.vertices[-1]), leg.end, to]) for leg in legs]
        return faces.rebuilt(shares, dropped, lines)
    one, other = legs
    if not set(one.vertices[1:]).isdisjoint(other.vertices[1:]):  # round an island: less of its border moves
        return dragged(shares, place, to, reach / 2, step)
    between = [graph.place(vertex) for vertex in one.vertices[-2:0:-1] + other.vertices[1:-1]]
    old = shapely.LineString([one.end, *between, other.end])
    after = _swept(shares, old, shapely.LineString([one.end, to, other.end]), step)
    if after is None:
        raise InputError("the seam runs there already", hint="drag it farther")
    return after


def _swept(shares: Sequence[Any], old: Any, new: Any, step: float) -> list[Any] | None:
    """Shares after a way along seams was moved to a line with the same ends; None where nothing changes."""
    import shapely

    ring = np.concatenate([shapely.get_coordinates(old), shapely.get_coordinates(new)[::-1]])
    faces = SeamFaces.of(shares, [new], step, within=shapely.MultiPoint(ring).convex_hull)
    of_edge = faces.faces_of_edges()
    way = {edge for edge in faces.edges_on(old) if len(of_edge[edge]) == 2}
    if not way:
        return None
    begun = {faces.owners[face] for face in of_edge[min(way, key=lambda edge: _along(old, edge, step))]}
    owners = list(faces.owners)
    for part in faces.parts(way | faces.edges_on(new)):
        if _winding(ring, faces.places[part[0]]) == 0:
            continue
        lengths: dict[int, float] = {}  # of the old seam, by the image on its other side
        for edge in way:
            sides = of_edge[edge]
            if len(set(part).intersection(sides)) == 1:
                image = faces.owners[sides[0] if sides[1] in part else sides[1]]
                lengths[image] = lengths.get(image, 0.0) + float(np.hypot(*np.subtract(*edge)))
        able = lengths.keys() & begun or lengths.keys()
        if able:
            image = max(sorted(able), key=lengths.__getitem__)
            for face in part:
                owners[face] = image
    return None if owners == faces.owners else faces.shares(shares, owners)


def _along(line: Any, edge: Edge, step: float) -> float:
    """Length along a line up to the middle of an edge."""
    import shapely

    return float(line.project(shapely.Point(np.mean(edge, axis=0) * step)))


def _winding(ring: FloatArray, place: FloatArray) -> int:
    """Winding number of a closed line, with vertices (N, 2), round a place."""
    x, y = (ring - place).T
    following_x, following_y = np.roll(x, -1), np.roll(y, -1)
    left = x * following_y - following_x * y
    up, down = (y <= 0) & (following_y > 0) & (left > 0), (y > 0) & (following_y <= 0) & (left < 0)
    return int(up.sum()) - int(down.sum())


def beyond_outlines(before: Sequence[Any], after: Sequence[Any], outlines: Sequence[Any]) -> dict[int, Any]:
    """Ground that images have got by an edit and do not show.

    Parameters
    ----------
    before, after : sequence of Polygon or MultiPolygon
        Shares.
    outlines : sequence of Polygon or MultiPolygon
        What each image shows.

    Returns
    -------
    dict of int to Polygon or MultiPolygon
        By number of the image, where there is any.
    """
    found = {}
    for number, (old, new, outline) in enumerate(zip(before, after, outlines, strict=True)):
        if new is not old:
            lost = polygonal(new.difference(old).difference(outline))
            if lost.area > 0:
                found[number] = lost
    return found
