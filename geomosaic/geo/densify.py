"""Lines and areas under a transformation that bends them, with vertices where a straight line would miss it."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from geomosaic.errors import InputError
from geomosaic.types import BoolArray, FloatArray, IntArray

# Halvings of a segment at most, and vertices of all lines together.
ROUNDS, MOST = 20, 4_000_000
# Places of a segment whose distance from the chord is measured: the middle alone is blind to an inflection there.
PLACES = np.array([0.25, 0.5, 0.75])

Change = Callable[[FloatArray], FloatArray]


def transformed(geometries: Sequence[Any], change: Change, tolerance: float) -> tuple[list[Any], int]:
    """Geometries under a transformation, segments halved until each follows the bent line.

    Parameters
    ----------
    geometries : sequence of shapely geometry or None
        x and y, and z where there is one, which stays.
    change : callable
        From positions (M, 2) to positions (M, 2); NaN where there is none.
    tolerance : float
        Largest distance between the bent line and the straight one from vertex to vertex, units of the result.

    Returns
    -------
    geometries : list
        None where a vertex has no place.
    added : int
        Vertices that were put in.

    Raises
    ------
    InputError
        More than 4 million vertices would be needed.
    """
    lines = [line for geometry in geometries for line in _lines(geometry)]
    if not lines:
        return list(geometries), 0
    made, owner = _bent(lines, change, tolerance)
    stops = np.searchsorted(owner, np.arange(len(lines) + 1))
    pieces = iter([made[a:b] for a, b in itertools.pairwise(stops)])
    return [_rebuilt(geometry, pieces) for geometry in geometries], len(made) - sum(map(len, lines))


def _lines(geometry: Any) -> Iterator[FloatArray]:
    """Vertices of each point, line and ring, in their order."""
    import shapely

    if geometry is None or geometry.is_empty:
        return
    if hasattr(geometry, "geoms"):
        for part in geometry.geoms:
            yield from _lines(part)
        return
    rings = [geometry.exterior, *geometry.interiors] if geometry.geom_type == "Polygon" else [geometry]
    for ring in rings:
        vertices = shapely.get_coordinates(ring, include_z=geometry.has_z)
        # Without an area of its own, a z that is missing would be a vertex without a place.
        yield np.column_stack([vertices, np.zeros(len(vertices))]) if vertices.shape[1] == 2 else vertices


def _rebuilt(geometry: Any, pieces: Iterator[FloatArray]) -> Any:
    """Geometry of the same kind from its changed lines; None where one of them has no place."""
    if geometry is None or geometry.is_empty:
        return geometry
    if hasattr(geometry, "geoms"):
        parts = [_rebuilt(part, pieces) for part in geometry.geoms]
        return None if any(part is None for part in parts) else type(geometry)(parts)
    count = 1 + len(geometry.interiors) if geometry.geom_type == "Polygon" else 1
    rings = [next(pieces) for _ in range(count)]
    rings = [ring if geometry.has_z else ring[:, :2] for ring in rings]
    if not all(np.isfinite(ring[:, :2]).all() for ring in rings):
        return None
    if geometry.geom_type == "Polygon":
        return type(geometry)(rings[0], rings[1:])
    return type(geometry)(rings[0] if len(rings[0]) > 1 else rings[0][0])


def _bent(lines: Sequence[FloatArray], change: Change, tolerance: float) -> tuple[FloatArray, IntArray]:
    """Changed vertices (M, 3) of all lines, and the line that each is of."""
    before, line = np.vstack(lines), np.repeat(np.arange(len(lines)), [len(each) for each in lines])
    after = change(before[:, :2])
    pending: BoolArray = line[1:] == line[:-1]
    for _ in range(ROUNDS):
        first = np.flatnonzero(pending)
        if not len(first):
            break
        starts, steps = before[first], before[first + 1] - before[first]
        inner = change((starts[:, None, :2] + PLACES[:, None] * steps[:, None, :2]).reshape(-1, 2))
        inner = inner.reshape(-1, len(PLACES), 2)
        split = first[(_distance(inner, after[first], after[first + 1]) > tolerance).any(axis=1)]
        if len(before) + len(split) > MOST:
            raise InputError(
                f"lines would need more than {MOST} vertices to follow the fit",
                hint="allow a larger tolerance, or choose a fit that bends less",
            )
        middle = inner[np.isin(first, split, assume_unique=True), 1]
        half = before[split] + 0.5 * (before[split + 1] - before[split])
        before, after = np.insert(before, split + 1, half, axis=0), np.insert(after, split + 1, middle, axis=0)
        line = np.insert(line, split + 1, line[split])
        pending = np.zeros(len(before) - 1, dtype=bool)
        moved = split + np.arange(len(split))
        pending[moved] = pending[moved + 1] = True
    return np.column_stack([after, before[:, 2]]), line


def _distance(points: FloatArray, start: FloatArray, end: FloatArray) -> FloatArray:
    """Distance (K, P) of points (K, P, 2) from the segments between start and end (K, 2)."""
    along = (end - start)[:, None]
    length = np.maximum((along**2).sum(axis=-1), 1e-300)
    share = np.clip(((points - start[:, None]) * along).sum(axis=-1) / length, 0.0, 1.0)
    return np.asarray(np.linalg.norm(points - start[:, None] - share[..., None] * along, axis=-1))
