"""Graph of seams: vertices and the edges between them, ways along it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from geomosaic.errors import InputError
from geomosaic.types import FloatArray

# Vertex on multiples of the step, and an edge between two of them in either direction.
Vertex = tuple[int, int]
Edge = tuple[Vertex, Vertex]


def edge_between(a: Vertex, b: Vertex) -> Edge:
    """Edge of two vertices, the same in either direction.

    Parameters
    ----------
    a, b : tuple of int
    """
    return (a, b) if a < b else (b, a)


@dataclass(frozen=True)
class SeamPath:
    """Way along a seam.

    Attributes
    ----------
    vertices : list of tuple of int
    end : array (2,)
        Place on it, before the last vertex, where it ends.
    """

    vertices: list[Vertex]
    end: FloatArray


@dataclass(frozen=True)
class SeamGraph:
    """Seams as a graph of vertices.

    Attributes
    ----------
    near : dict of tuple to list
        Neighbours of each vertex.
    step : float
        Map units of which vertices are multiples.
    """

    near: dict[Vertex, list[Vertex]]
    step: float

    @classmethod
    def of(cls, edges: Iterable[Edge], step: float) -> SeamGraph:
        """Graph of edges.

        Parameters
        ----------
        edges : iterable of Edge
        step : float
        """
        near: dict[Vertex, list[Vertex]] = {}
        for a, b in edges:
            near.setdefault(a, []).append(b)
            near.setdefault(b, []).append(a)
        return cls(near, step)

    def place(self, vertex: Vertex) -> FloatArray:
        """Place (2,) of a vertex in the map.

        Parameters
        ----------
        vertex : tuple of int
        """
        return np.array(vertex, dtype=np.float64) * self.step

    def on(self, line: Any) -> list[Vertex]:
        """Vertices on a line, in its order.

        Parameters
        ----------
        line : LineString
        """
        import shapely

        vertices = sorted(self.near)
        points = shapely.points(np.array(vertices, dtype=np.float64).reshape(-1, 2) * self.step)
        shapely.prepare(line)
        met = np.flatnonzero(shapely.dwithin(line, points, 3 * self.step))
        return [vertices[i] for i in met[np.argsort(shapely.line_locate_point(line, points[met]), kind="stable")]]

    def shortest(self, start: Vertex, end: Vertex) -> list[Vertex]:
        """Shortest way along the seams, by Dijkstra; empty where none leads from one vertex to the other.

        Parameters
        ----------
        start, end : tuple of int
        """
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

    def around(self, place: FloatArray, reach: float) -> list[SeamPath]:
        """Ways from a place along the seams: two, or one along each seam of a junction that is near.

        Parameters
        ----------
        place : array (2,)
        reach : float
            Length of the ways, map units.

        Raises
        ------
        InputError
            No seam is within reach.
        """
        import shapely

        edges = sorted({edge_between(a, b) for a, others in self.near.items() for b in others})
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

    def _along(self, before: Vertex, first: Vertex, place: FloatArray, reach: float) -> SeamPath:
        """Way from a place between two vertices over the second on."""
        way, start, left = [before, first], place, reach
        while True:
            end = self.place(way[-1])
            length = float(np.hypot(*(end - start)))
            if length >= left:
                return SeamPath(way, start + (end - start) * (left / length))
            following = [v for v in self.near[way[-1]] if v != way[-2]]
            if len(following) != 1 or following[0] in way:
                return SeamPath(way, end)
            way.append(following[0])
            start, left = end, left - length
