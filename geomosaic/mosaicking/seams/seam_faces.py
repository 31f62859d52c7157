"""Faces between the borders of shares and further lines, each with the image that has it."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from geomosaic.mosaicking.seams.partition import canonical
from geomosaic.mosaicking.seams.seam_graph import Edge, edge_between
from geomosaic.mosaicking.seams.voronoi import polygonal
from geomosaic.types import FloatArray


def _edges_of(geometry: Any, step: float) -> set[Edge]:
    """Edges of a line or of all rings of a polygon, whose vertices are multiples of `step` map units."""
    import shapely

    parts = shapely.get_parts(geometry)
    parts = shapely.get_rings(parts) if "Polygon" in geometry.geom_type else parts
    found: set[Edge] = set()
    for part in parts:
        vertices = [tuple(vertex) for vertex in np.rint(shapely.get_coordinates(part) / step).astype(np.int64).tolist()]
        found.update(edge_between(a, b) for a, b in pairwise(vertices) if a != b)
    return found


def _edges_on_lines(edges: Iterable[Edge], lines: Any, step: float) -> set[Edge]:
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
class SeamFaces:
    """Faces of the borders of some shares and of further lines, with the image that each has now.

    Attributes
    ----------
    numbers : list of int
        Images whose shares take part.
    faces : list of Polygon
    owners : list of int
        Image of each face.
    edges : list of set of Edge
        Of each face.
    places : array (N, 2)
        A place inside of each face.
    borders : set of Edge
        Of the shares.
    step : float
        Map units of which vertices are multiples.
    """

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
    ) -> SeamFaces:
        """Faces of lines and of the borders of the shares that these, or an area, touch.

        Parameters
        ----------
        shares : sequence of Polygon or MultiPolygon
            One per image.
        lines : sequence of LineString
        step : float
        within : Polygon, optional
            Area that touches the shares, in place of the lines.
        also : iterable of int
            Images whose shares take part in any case.
        """
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
            [_edges_of(faces[i], step) for i in kept],
            places[kept].reshape(-1, 2),
            # With the vertices that the lines have put on them.
            _edges_on_lines(_edges_of(network, step), borders, step),
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
        """Edges of faces that lie on a line.

        Parameters
        ----------
        line : LineString
        """
        return _edges_on_lines({edge for edges in self.edges for edge in edges}, line, self.step)

    def parts(self, borders: set[Edge]) -> list[list[int]]:
        """Groups of faces that hang together without crossing some edges.

        Parameters
        ----------
        borders : set of Edge
        """
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components

        joined = [faces for edge, faces in self.faces_of_edges().items() if len(faces) == 2 and edge not in borders]
        one, other = np.array(joined, dtype=np.int64).reshape(-1, 2).T
        size = len(self.faces)
        _, part = connected_components(coo_array((np.ones(len(one)), (one, other)), shape=(size, size)), directed=False)
        return [np.flatnonzero(part == number).tolist() for number in range(part.max(initial=-1) + 1)]

    def seam_edges(self, images: Collection[int] | None = None) -> set[Edge]:
        """Edges between two images, one of which is given.

        Parameters
        ----------
        images : collection of int, optional
            All unless given.
        """
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
        """Shares with faces given to other images.

        Parameters
        ----------
        before : sequence of Polygon or MultiPolygon
        owners : sequence of int
            Image of each face.
        """
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
            if _edges_of(share, self.step) != _edges_of(before[number], self.step):
                found[number] = share
        return found

    def rebuilt(self, before: Sequence[Any], dropped: set[Edge], lines: Sequence[Any]) -> list[Any]:
        """Shares bounded by all edges but some, and by further lines: each face goes to the image that has most of it.

        Parameters
        ----------
        before : sequence of Polygon or MultiPolygon
        dropped : set of Edge
        lines : sequence of LineString
        """
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
