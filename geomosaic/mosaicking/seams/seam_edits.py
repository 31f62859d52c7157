"""Edits of seams: areas given to another image, seams redrawn and dragged, shares cut by a line.

The shares of a mosaic are a coverage: neighbours have the same vertices along their common border. Each edit adds lines
to the borders of the shares that it touches, takes the faces of all these lines together, and gives each face to one
image. Neighbours then share their vertices again, so that no edit leaves a gap or an overlap.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from geomosaic.errors import InputError
from geomosaic.mosaicking.seams.partition import canonical
from geomosaic.mosaicking.seams.voronoi import polygonal
from geomosaic.types import FloatArray

# Vertex on multiples of the step, and an edge between two of them in either direction.
Vertex = tuple[int, int]
Edge = tuple[Vertex, Vertex]


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
    plan = _Plan.of(shares, [area.boundary], step, within=area, also=(image,))
    inside = shapely.contains_xy(area, *plan.places.T)
    owners = [image if within else owner for owner, within in zip(plan.owners, inside, strict=True)]
    if owners == plan.owners:
        raise InputError("the image shows all of this area already", hint="choose another image, or another area")
    return plan.shares(shares, owners)


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
    plan = _Plan.of(shares, [line], step)
    added = plan.added
    found = [
        (owner, face)
        for owner, face, edges in zip(plan.owners, plan.faces, plan.edges, strict=True)
        if not added.isdisjoint(edges)
    ]
    if not found:
        raise InputError("the line divides no image's area", hint="draw it from border to border across one")
    return sorted(found, key=lambda piece: piece[1].area)


def redrawn(shares: Sequence[Any], line: Any, step: float) -> list[Any]:
    """Shares whose seam follows a line between the places where the line meets it first and last.

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
        The line encloses no area together with a seam.
    """
    plan = _Plan.of(shares, [line], step)
    added, of_edge = plan.added, plan.faces_of_edges()
    owners = list(plan.owners)
    for face, edges in enumerate(plan.edges):
        # Between the line and a seam lies what the line cuts off a share and what borders on one other image alone.
        beyond = {plan.owners[other] for edge in edges for other in of_edge[edge] if edge not in added} - {owners[face]}
        outer = any(len(of_edge[edge]) == 1 for edge in edges)
        if len(beyond) == 1 and not outer and not added.isdisjoint(edges):
            owners[face] = beyond.pop()
    for image in set(plan.owners) - set(owners):  # an island would vanish: its largest face stays
        own = [face for face, owner in enumerate(plan.owners) if owner == image]
        owners[max(own, key=lambda face: plan.faces[face].area)] = image
    if owners == plan.owners:
        raise InputError(
            "the line encloses nothing together with a seam",
            hint="begin and end it on the same seam, within the mosaic; or give an area to an image instead",
        )
    return plan.shares(shares, owners)


def dragged(shares: Sequence[Any], place: FloatArray, to: FloatArray, reach: float, step: float) -> list[Any]:
    """Shares after a seam was taken at one place and dragged to another.

    It runs straight to the new place from `reach` away on either side, or from its end. Where seams meet within
    `reach` / 4 of the place, their junction is dragged with all of them.

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
        There is no seam within `reach` of the place.
    """
    import shapely

    plan = _Plan.of(shares, [], step, within=shapely.Point(place).buffer(reach))
    ways = _Ways.of(plan.seam_edges(), step)
    legs = ways.around(np.asarray(place, dtype=np.float64), reach)
    if len(legs) == 2:
        return redrawn(shares, shapely.LineString([legs[0].end, to, legs[1].end]), step)
    dropped = {_edge(a, b) for leg in legs for a, b in pairwise(leg.vertices)}
    lines = [shapely.LineString([ways.place(leg.vertices[-1]), leg.end, to]) for leg in legs]
    return plan.rebuilt(shares, dropped, lines)


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


def _edge(a: Vertex, b: Vertex) -> Edge:
    return (a, b) if a < b else (b, a)


def _edges(geometry: Any, step: float) -> set[Edge]:
    """Edges of a line or of all rings of a polygon."""
    import shapely

    parts = shapely.get_parts(geometry)
    parts = shapely.get_rings(parts) if "Polygon" in geometry.geom_type else parts
    found: set[Edge] = set()
    for part in parts:
        vertices = [tuple(vertex) for vertex in np.rint(shapely.get_coordinates(part) / step).astype(np.int64).tolist()]
        found.update(_edge(a, b) for a, b in pairwise(vertices) if a != b)
    return found


@dataclass(frozen=True)
class _Plan:
    """Faces of the borders of some shares and of further lines, with the image that each has now."""

    numbers: list[int]
    faces: list[Any]
    owners: list[int]
    edges: list[set[Edge]]
    places: FloatArray
    borders: set[Edge]
    step: float

    @classmethod
    def of(
        cls, shares: Sequence[Any], lines: Sequence[Any], step: float, *, within: Any = None, also: Iterable[int] = ()
    ) -> _Plan:
        """Faces of lines and of the borders of the shares that these, or an area, touch."""
        import shapely

        place = shapely.union_all(list(lines)) if within is None else within
        # A line that ends on a border touches the shares on both sides, whatever the last digits say.
        near = {int(i) for i in shapely.STRtree(list(shares)).query(place, predicate="dwithin", distance=3 * step)}
        numbers = sorted(near | {i for i in also if not shares[i].is_empty})
        own = [shares[i] for i in numbers]
        # Rounded to the step: borders that differ in their last digits become one.
        borders = shapely.union_all([share.boundary for share in own], grid_size=step)
        network = shapely.union_all([borders, *lines], grid_size=step) if lines else borders
        faces = list(shapely.get_parts(shapely.polygonize(shapely.get_parts(network))))
        points = shapely.point_on_surface(np.array(faces, dtype=object))
        places = shapely.get_coordinates(points)
        found = shapely.STRtree(own).query(points, predicate="within")
        owner = {int(face): numbers[int(k)] for face, k in found.T[::-1]}
        kept = sorted(owner)
        return cls(
            numbers,
            [faces[i] for i in kept],
            [owner[i] for i in kept],
            [_edges(faces[i], step) for i in kept],
            places[kept].reshape(-1, 2),
            # With the vertices that the lines have put on them.
            _edges_on(network, borders, step),
            step,
        )

    @property
    def added(self) -> set[Edge]:
        """Edges of the lines alone, within shares."""
        return {edge for edges in self.edges for edge in edges} - self.borders

    def faces_of_edges(self) -> dict[Edge, list[int]]:
        """Faces on the sides of each edge: one or two."""
        found: dict[Edge, list[int]] = {}
        for face, edges in enumerate(self.edges):
            for edge in edges:
                found.setdefault(edge, []).append(face)
        return found

    def seam_edges(self) -> set[Edge]:
        """Edges between two images."""
        return {
            edge
            for edge, faces in self.faces_of_edges().items()
            if len(faces) == 2 and self.owners[faces[0]] != self.owners[faces[1]]
        }

    def shares(self, before: Sequence[Any], owners: Sequence[int]) -> list[Any]:
        """Shares with faces given to other images."""
        return self._with(before, zip(owners, self.faces, strict=True))

    def _with(self, before: Sequence[Any], faces: Iterable[tuple[int, Any]]) -> list[Any]:
        """Shares made of faces; one that has the edges it had stays the same object."""
        import shapely

        own: dict[int, list[Any]] = {}
        for number, face in faces:
            own.setdefault(number, []).append(face)
        found = list(before)
        for number in {*self.numbers, *own}:
            share = canonical(polygonal(shapely.union_all(own.get(number, []))), self.step)
            if _edges(share, self.step) != _edges(before[number], self.step):
                found[number] = share
        return found

    def rebuilt(self, before: Sequence[Any], dropped: set[Edge], lines: Sequence[Any]) -> list[Any]:
        """Shares bounded by all edges but some, and by further lines: each face goes to who has most of it."""
        import shapely

        kept = {edge for edges in self.edges for edge in edges} - dropped
        borders = shapely.multilinestrings([shapely.linestrings(np.array(edge) * self.step) for edge in sorted(kept)])
        network = shapely.union_all([borders, *lines], grid_size=self.step)
        own = np.array([before[i] for i in self.numbers], dtype=object)
        faces = shapely.get_parts(shapely.polygonize(shapely.get_parts(network)))
        areas = [shapely.area(shapely.intersection(own, face)) for face in faces]
        parts = [
            (self.numbers[int(shown.argmax())], face)
            for face, shown in zip(faces, areas, strict=True)
            if shown.max() > 0.5 * face.area
        ]
        return self._with(before, parts)


def _edges_on(network: Any, borders: Any, step: float) -> set[Edge]:
    """Edges of a network that lie on borders which are a part of it."""
    import shapely

    edges = sorted(_edges(network, step))
    if not edges:
        return set()
    ends = np.array(edges, dtype=np.float64) * step
    middles = shapely.points(ends.mean(axis=1))
    shapely.prepare(borders)
    on = shapely.dwithin(borders, middles, 3 * step)
    return {edge for edge, within in zip(edges, on, strict=True) if within}


@dataclass(frozen=True)
class _Ways:
    """Seams as a graph of vertices."""

    near: dict[Vertex, list[Vertex]]
    step: float

    @classmethod
    def of(cls, edges: Iterable[Edge], step: float) -> _Ways:
        near: dict[Vertex, list[Vertex]] = {}
        for a, b in edges:
            near.setdefault(a, []).append(b)
            near.setdefault(b, []).append(a)
        return cls(near, step)

    def place(self, vertex: Vertex) -> FloatArray:
        """Vertex in the map."""
        return np.array(vertex, dtype=np.float64) * self.step

    def around(self, place: FloatArray, reach: float) -> list[_Leg]:
        """Ways from a place along the seams: two, or one along each seam of a junction that is near."""
        import shapely

        edges = sorted({_edge(a, b) for a, others in self.near.items() for b in others})
        lines = shapely.linestrings(np.array(edges, dtype=np.float64).reshape(-1, 2, 2) * self.step)
        here = shapely.Point(place)
        distances = shapely.distance(lines, here) if len(edges) else np.array([np.inf])
        if distances.min() > reach:
            raise InputError("there is no seam at this place", hint="take a seam where it is drawn")
        nearest = int(distances.argmin())
        a, b = edges[nearest]
        junctions = [v for v in self.near if len(self.near[v]) > 2]
        if junctions:
            away = np.hypot(*(np.array(junctions, dtype=np.float64) * self.step - place).T)
            if away.min() <= reach / 4:
                start = junctions[int(away.argmin())]
                return [self._along(start, other, self.place(start), reach) for other in self.near[start]]
        on = shapely.get_coordinates(lines[nearest].interpolate(lines[nearest].project(here)))[0]
        return [self._along(b, a, on, reach), self._along(a, b, on, reach)]

    def _along(self, before: Vertex, first: Vertex, place: FloatArray, reach: float) -> _Leg:
        """Way from a place between two vertices over the second on."""
        way, start, left = [before, first], place, reach
        while True:
            end = self.place(way[-1])
            length = float(np.hypot(*(end - start)))
            if length >= left:
                return _Leg(way, start + (end - start) * (left / length))
            following = [v for v in self.near[way[-1]] if v != way[-2]]
            if len(following) != 1 or following[0] in way:
                return _Leg(way, end)
            way.append(following[0])
            start, left = end, left - length


@dataclass(frozen=True)
class _Leg:
    """Way along a seam: its vertices, and the place on it, before the last one, where it ends."""

    vertices: list[Vertex]
    end: FloatArray
