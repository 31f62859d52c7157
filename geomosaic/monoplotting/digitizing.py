"""Features digitized in a picture: vertices of a layer shown in it, and what is drawn in it brought to the layer.

Vertices that come back as they were shown keep the coordinates they have in the layer, to the bit: what was not moved
does not move, and borders that features share stay shared whatever the picture's geometry.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
import shapely

from geomosaic.errors import InputError
from geomosaic.monoplotting.pictures import Picture
from geomosaic.types import FloatArray

Place = tuple[float, float]
# A jump over hidden ground: times the median distance of a line's samples on the ground.
_JUMP = 12.0
_MOST = 200_000


@dataclass(frozen=True, eq=False)
class ShownLayer:
    """Vertices of a layer in a picture.

    Attributes
    ----------
    picture : Picture
    shapes : object array (K,)
        Geometries of the layer.
    xy : array (V, 2)
        Their vertices, equal ones once.
    places : array (V, 2)
        Picture coordinates of these; not finite where there are none.
    numbers : int array (N,)
        Number of each coordinate of the shapes among the vertices.
    """

    picture: Picture
    shapes: Any
    xy: FloatArray
    places: FloatArray
    numbers: Any

    @classmethod
    def of(cls, picture: Picture, geometries: Iterable[Any]) -> ShownLayer:
        """Layer with some geometries.

        Parameters
        ----------
        picture : Picture
        geometries : iterable of shapely geometry
        """
        shapes = np.array([*geometries, None], dtype=object)[:-1]  # an array of objects, whatever their number
        # Equal vertices are carried once: vectorised arithmetic may differ in the last bit by the place in an array.
        own = np.ascontiguousarray(shapely.get_coordinates(shapes)).view(np.complex128).ravel()
        unique, numbers = np.unique(own, return_inverse=True)
        xy = unique.view(np.float64).reshape(-1, 2)
        return cls(picture, shapes, xy, picture.shown(xy) if len(xy) else xy, numbers)

    @cached_property
    def vertices(self) -> dict[Place, Place]:
        """Vertices of the layer by their picture coordinates."""
        return dict(zip(map(_pair, self.places.tolist()), map(_pair, self.xy.tolist()), strict=True))

    @cached_property
    def edges(self) -> frozenset[frozenset[Place]]:
        """Ends of the layer's edges, in either order."""
        lines = (line for shape in self.shapes for line in _lines(shape))
        return frozenset(frozenset(pair) for line in lines for pair in itertools.pairwise(line))

    def shown(self) -> list[Any]:
        """Geometries in the picture; None for those of which a vertex has no place there."""
        places = self.places[self.numbers]
        lost = ~np.isfinite(places).all(axis=1)
        _, shape = shapely.get_coordinates(self.shapes, return_index=True)
        found = shapely.set_coordinates(self.shapes.copy(), np.where(lost[:, None], 0.0, places))
        found[np.unique(shape[lost])] = None
        return list(found)

    def carried(self, geometries: Iterable[Any]) -> tuple[list[Any], list[str]]:
        """Geometries drawn in the picture, in the layer.

        Parameters
        ----------
        geometries : iterable of shapely geometry
            In picture coordinates. In a photo a straight line follows the relief: it is sampled, and samples that move
            it by less than the picture's tolerance are left out.

        Returns
        -------
        list of shapely geometry
        list of str
            Notes on what was drawn.

        Raises
        ------
        InputError
            A place in the picture shows no known ground.
        """
        requested = list(geometries)
        lines = [line for geometry in requested for line in _lines(geometry)]
        known = dict(self.vertices)
        new = list(dict.fromkeys(place for line in lines for place in line if place not in known))
        for place, vertex in zip(new, self._drawn(new), strict=True):
            known[place] = vertex
        between, notes = self._between(lines, known)

        def carry(line: list[Place]) -> list[Place]:
            out = [known[line[0]]]
            for first, last in itertools.pairwise(line):
                samples = between.get(frozenset((first, last)), [])
                out += [*(samples if first < last else reversed(samples)), known[last]]
            return out

        return [_mapped(geometry, carry) for geometry in requested], notes

    def _drawn(self, places: list[Place]) -> list[Place]:
        if not places:
            return []
        if len(places) > _MOST:
            raise InputError(f"more than {_MOST:,} vertices", hint="draw it in parts")
        found = self.picture.drawn(np.array(places))
        lost = np.flatnonzero(~np.isfinite(found).all(axis=1))
        if len(lost):
            col, row = places[lost[0]]
            raise InputError(
                f"the place {col:.1f}, {row:.1f} of the picture shows no known ground: nothing was saved",
                hint="it lies outside of the photo, above the horizon or beyond the DEM: move the vertex",
            )
        return list(map(_pair, found.tolist()))

    def _between(
        self, lines: Iterable[list[Place]], known: Mapping[Place, Place]
    ) -> tuple[dict[frozenset[Place], list[Place]], list[str]]:
        """Vertices between the ends of each segment that is no edge of the layer, from the smaller end on."""
        step = self.picture.sampling
        if step is None:
            return {}, []
        segments = {frozenset(pair) for line in lines for pair in itertools.pairwise(line) if pair[0] != pair[1]}
        new = [sorted(one) for one in segments if frozenset(known[end] for end in one) not in self.edges]
        counts = [int(np.hypot(b[0] - a[0], b[1] - a[1]) / step) for a, b in new]
        ends = np.array(new).reshape(-1, 2, 2)
        samples = [
            ends[i, 0] + np.linspace(0.0, 1.0, count + 2)[1:-1, None] * (ends[i, 1] - ends[i, 0])
            for i, count in enumerate(counts)
        ]
        found = iter(self._drawn([_pair(place) for some in samples for place in some.tolist()]))
        between, notes = {}, []
        for (first, last), count in zip(new, counts, strict=True):
            line = np.array([known[first], *itertools.islice(found, count), known[last]])
            lengths = np.hypot(*np.diff(line, axis=0).T)
            if count > 2 and lengths.max() > _JUMP * np.median(lengths):
                x, y = line[int(lengths.argmax())]
                notes.append(f"the line passes over ground that is hidden in this photo at {x:.8g}, {y:.8g}")
            kept = shapely.LineString(line).simplify(self.picture.tolerance, preserve_topology=False)
            between[frozenset((first, last))] = list(map(_pair, np.asarray(kept.coords)[1:-1].tolist()))
        return between, notes


def with_shared_vertices(edited: Mapping[int, Any], layer: Mapping[int, Any], tolerance: float) -> dict[int, Any]:
    """Features whose edges get the vertices of others that lie on them, so that borders are shared vertex by vertex.

    Parameters
    ----------
    edited : mapping of int to shapely geometry
        Features whose vertices and edges count.
    layer : mapping of int to shapely geometry
        All features, the edited ones with their new geometries.
    tolerance : float
        Distance from an edge, layer units.

    Returns
    -------
    dict
        Geometries of those that get any, edited ones or their neighbours.
    """
    keys = [key for key, geometry in layer.items() if geometry is not None and not geometry.is_empty]
    tree = shapely.STRtree([layer[key] for key in keys])
    out: dict[int, Any] = {}
    for key, geometry in edited.items():
        for index in tree.query(geometry, predicate="dwithin", distance=tolerance).tolist():
            other = keys[index]
            if other == key:
                continue
            for one, its in ((other, key), (key, other)):
                vertices = list(dict.fromkeys(place for line in _lines(layer[its]) for place in line))
                before = out.get(one, layer[one])
                near = shapely.dwithin(before, shapely.points(vertices), tolerance).tolist()
                some = [place for place, is_near in zip(vertices, near, strict=True) if is_near]
                after = _mapped(before, partial(_with_vertices, places=some, tolerance=tolerance))
                if shapely.count_coordinates(after) != shapely.count_coordinates(before):
                    out[one] = after
    return out


def _with_vertices(line: list[Place], places: Iterable[Place], tolerance: float) -> list[Place]:
    """Line with those of the places that lie within one of its edges."""
    have = set(line)
    todo = np.array([place for place in places if place not in have]).reshape(-1, 2)
    if not len(todo) or len(line) < 2:
        return line
    vertices = np.array(line)
    start, along = vertices[:-1], np.diff(vertices, axis=0)
    squared = np.maximum((along**2).sum(axis=1), 1e-300)
    share = ((todo[:, None] - start) * along).sum(axis=2) / squared  # (places, edges)
    foot = start + np.clip(share, 0.0, 1.0)[..., None] * along
    apart = np.hypot(*np.moveaxis(todo[:, None] - foot, 2, 0))
    edge = apart.argmin(axis=1)
    each = np.arange(len(todo))
    within = (apart[each, edge] <= tolerance) & (share[each, edge] > 0.0) & (share[each, edge] < 1.0)
    order = sorted(zip(edge[within].tolist(), share[each, edge][within].tolist(), todo[within].tolist(), strict=True))
    out: list[Place] = []
    for index, vertex in enumerate(line):
        out += [vertex, *(_pair(place) for at, _, place in order if at == index)]
    return out


def _pair(values: list[float]) -> Place:
    return values[0], values[1]


def _lines(geometry: Any) -> list[list[Place]]:
    """Vertices of the lines that a geometry is made of; a point is a line of one vertex."""
    if hasattr(geometry, "geoms"):
        return [line for part in geometry.geoms for line in _lines(part)]
    if geometry.geom_type == "Polygon":
        return [_vertices(ring) for ring in (geometry.exterior, *geometry.interiors) if not ring.is_empty]
    return [] if geometry.is_empty else [_vertices(geometry)]


def _vertices(line: Any) -> list[Place]:
    return list(map(_pair, np.asarray(line.coords)[:, :2].tolist()))


def _mapped(geometry: Any, change: Callable[[list[Place]], list[Place]]) -> Any:
    """Geometry whose lines are changed."""
    if geometry.is_empty:
        return geometry
    if hasattr(geometry, "geoms"):
        return type(geometry)([_mapped(part, change) for part in geometry.geoms])
    if geometry.geom_type == "Polygon":
        outer, *inner = (change(_vertices(ring)) for ring in (geometry.exterior, *geometry.interiors))
        return shapely.Polygon(outer, inner)
    changed = change(_vertices(geometry))
    return shapely.Point(changed[0]) if geometry.geom_type == "Point" else shapely.LineString(changed)
