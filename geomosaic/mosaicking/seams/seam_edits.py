"""Edits of seams: areas given to another image, seams redrawn and dragged, shares cut by a line.

The shares of a mosaic are a coverage: neighbours have the same vertices along their common border. Each edit adds lines
to the borders of the shares that it touches, takes the faces of all these lines together, and gives each face to one
image. Neighbours then share their vertices again, so that no edit leaves a gap or an overlap.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
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
    plan = _Plan.of(shares, [line], step, within=area)
    ways = _Ways.of(plan.seam_edges(set(crossed)), step)
    met = ways.on(line)
    way = ways.shortest(met[0], met[-1]) if len(met) > 1 else []
    if len(way) > 1:
        old = shapely.LineString([ways.place(vertex) for vertex in way])
        ends = [line.project(shapely.Point(ways.place(vertex))) for vertex in (way[0], way[-1])]
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

    plan = _Plan.of(shares, [], step, within=shapely.Point(place).buffer(reach))
    ways = _Ways.of(plan.seam_edges(), step)
    legs = ways.around(np.asarray(place, dtype=np.float64), reach)
    if len(legs) > 2:
        dropped = {_edge(a, b) for leg in legs for a, b in pairwise(leg.vertices)}
        lines = [shapely.LineString([ways.place(leg.vertices[-1]), leg.end, to]) for leg in legs]
        return plan.rebuilt(shares, dropped, lines)
    one, other = legs
    if not set(one.vertices[1:]).isdisjoint(other.vertices[1:]):  # round an island: less of its border moves
        return dragged(shares, place, to, reach / 2, step)
    between = [ways.place(vertex) for vertex in one.vertices[-2:0:-1] + other.vertices[1:-1]]
    old = shapely.LineString([one.end, *between, other.end])
    after = _swept(shares, old, shapely.LineString([one.end, to, other.end]), step)
    if after is None:
        raise InputError("the seam runs there already", hint="drag it farther")
    return after


def _swept(shares: Sequence[Any], old: Any, new: Any, step: float) -> list[Any] | None:
    """Shares after a way along seams was moved to a line with the same ends; None where nothing changes."""
    import shapely

    ring = np.concatenate([shapely.get_coordinates(old), shapely.get_coordinates(new)[::-1]])
    plan = _Plan.of(shares, [new], step, within=shapely.MultiPoint(ring).convex_hull)
    of_edge = plan.faces_of_edges()
    way = {edge for edge in plan.edges_on(old) if len(of_edge[edge]) == 2}
    if not way:
        return None
    begun = {plan.owners[face] for face in of_edge[min(way, key=lambda edge: _along(old, edge, step))]}
    owners = list(plan.owners)
    for part in plan.parts(way | plan.edges_on(new)):
        if _winding(ring, plan.places[part[0]]) == 0:
            continue
        lengths: dict[int, float] = {}  # of the old seam, by the image on its other side
        for edge in way:
            sides = of_edge[edge]
            if len(set(part).intersection(sides)) == 1:
                image = plan.owners[sides[0] if sides[1] in part else sides[1]]
                lengths[image] = lengths.get(image, 0.0) + float(np.hypot(*np.subtract(*edge)))
        able = lengths.keys() & begun or lengths.keys()
        if able:
            image = max(sorted(able), key=lengths.__getitem__)
            for face in part:
                owners[face] = image
    return None if owners == plan.owners else plan.shares(shares, owners)


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
            _edges_on(_edges(network, step), borders, step),
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

    def edges_on(self, line: Any) -> set[Edge]:
        """Edges of faces that lie on a line."""
        return _edges_on({edge for edges in self.edges for edge in edges}, line, self.step)

    def parts(self, borders: set[Edge]) -> list[list[int]]:
        """Faces that hang together without crossing some edges."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        joined = [faces for edge, faces in self.faces_of_edges().items() if len(faces) == 2 and edge not in borders]
        one, other = np.array(joined, dtype=np.int64).reshape(-1, 2).T
        size = len(self.faces)
        _, part = connected_components(coo_array((np.ones(len(one)), (one, other)), shape=(size, size)), directed=False)
        return [np.flatnonzero(part == number).tolist() for number in range(part.max(initial=-1) + 1)]

    def seam_edges(self, images: Collection[int] | None = None) -> set[Edge]:
        """Edges between two images, one of which is given."""
        sides = {
            edge: {self.owners[face] for face in faces}
            for edge, faces in self.faces_of_edges().items()
            if len(faces) == 2
        }
        return {
            edge
            for edge, owners in sides.items()
            if len(owners) == 2 and (images is None or not owners.isdisjoint(images))
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


def _edges_on(edges: Iterable[Edge], lines: Any, step: float) -> set[Edge]:
    """Edges that lie on lines with vertices at all their ends there."""
    import shapely

    edges = list(edges)
    if not edges:
        return set()
    ends = np.array(edges, dtype=np.float64) * step
    middles = shapely.points(ends.mean(axis=1))
    shapely.prepare(lines)
    on = shapely.dwithin(lines, middles, 3 * step)
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

    def on(self, line: Any) -> list[Vertex]:
        """Vertices on a line, in its order."""
        import shapely

        vertices = sorted(self.near)
        points = shapely.points(np.array(vertices, dtype=np.float64).reshape(-1, 2) * self.step)
        shapely.prepare(line)
        met = np.flatnonzero(shapely.dwithin(line, points, 3 * self.step))
        return [vertices[i] for i in met[np.argsort(shapely.line_locate_point(line, points[met]), kind="stable")]]

    def shortest(self, start: Vertex, end: Vertex) -> list[Vertex]:
        """Shortest way along the seams, by Dijkstra; empty where none leads from one vertex to the other."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import dijkstra

        vertices = sorted(self.near)
        number = {vertex: i for i, vertex in enumerate(vertices)}
        one, other = np.array([(number[a], number[b]) for a in vertices for b in self.near[a]]).T
        places = np.array(vertices, dtype=np.float64)
        lengths = np.hypot(*(places[one] - places[other]).T)
        graph = coo_array((lengths, (one, other)), shape=(len(vertices), len(vertices))).tocsr()
        _, before = dijkstra(graph, indices=number[start], return_predecessors=True)
        way = [number[end]]
        while before[way[-1]] >= 0:
            way.append(int(before[way[-1]]))
        return [vertices[i] for i in way[::-1]] if way[-1] == number[start] else []

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
