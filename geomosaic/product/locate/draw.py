"""Lines of a map drawn into a photo: densified so that they follow the ground, cut at the frame and where hidden."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from geomosaic.errors import InputError
from geomosaic.product.locate.view import HIDDEN, SEEN, UNSEEN, View
from geomosaic.types import FloatArray, IntArray

STEP = 8.0
"""Pixels between the places of a line that are looked at."""
SIMPLE = 0.02
"""Pixels by which a drawn line may be simplified."""
MOST = 4_000_000
_BISECTIONS = 24


@dataclass(frozen=True)
class Drawing:
    """What a photo shows of some features.

    Attributes
    ----------
    geometries : list of shapely geometry
        In pixels, (col, row).
    feature : list of int
        The feature each is of, from 0; a feature may have several, or none.
    hidden : list of bool
        Whether ground stands before it.
    """

    geometries: list[Any]
    feature: list[int]
    hidden: list[bool]


def draw(view: View, geometries: Sequence[Any], bounds: tuple[float, float, float, float], *, hidden: bool) -> Drawing:
    """Draw features of the map into the photo.

    Parameters
    ----------
    view : View
    geometries : sequence of shapely geometry
        In `view.crs`; heights of their own do not count, they are draped on the surface.
    bounds : tuple of float
        Left, bottom, right, top on the map, somewhat more than the photo shows; what lies beyond is not drawn.
    hidden : bool
        Draw hidden parts too, marked; else they are left out.

    Returns
    -------
    Drawing
        Points, lines, and polygons. A polygon of whose outline a part is hidden or beyond the known heights is drawn
        as the lines of its outline.
    """
    import shapely

    area = shapely.box(*bounds)
    out = Drawing([], [], [])
    for number, geometry in enumerate(geometries):
        if geometry is None or geometry.is_empty:
            continue
        flat = shapely.force_2d(geometry)
        if not flat.is_valid:
            flat = shapely.make_valid(flat)
        for part in _parts(flat.intersection(area)):
            for drawn, covered in _drawn(view, part):
                if covered and not hidden:
                    continue
                out.geometries.append(drawn)
                out.feature.append(number)
                out.hidden.append(covered)
    return out


def _parts(geometry: Any) -> Iterator[Any]:
    for part in getattr(geometry, "geoms", [geometry]):
        if hasattr(part, "geoms"):
            yield from _parts(part)
        elif not part.is_empty:
            yield part


def _drawn(view: View, part: Any) -> Iterator[tuple[Any, bool]]:
    """Pieces of one simple geometry, and whether they are hidden."""
    import shapely

    if part.geom_type == "Point":
        image, state = view.look(np.array([[part.x, part.y]]))
        if state[0] != UNSEEN and view.within(image)[0]:
            yield shapely.Point(image[0]), bool(state[0] == HIDDEN)
        return
    frame = shapely.box(0.0, 0.0, *view.model.size)
    if part.geom_type == "Polygon":
        rings = [trace(view, np.asarray(ring.coords)[:, :2]) for ring in (part.exterior, *part.interiors)]
        if all(len(pieces) == 1 and pieces[0][1] == SEEN for pieces in rings):
            (outer, *holes) = [pieces[0][0] for pieces in rings]
            area = shapely.make_valid(shapely.Polygon(outer, holes)).intersection(frame)
            for piece in _parts(area):
                if piece.geom_type == "Polygon":
                    yield _simple(piece), False
            return
        lines = [line for ring in rings for line in ring]
    else:
        lines = trace(view, np.asarray(part.coords)[:, :2])
    for image, what in lines:
        if what == UNSEEN or len(image) < 2:
            continue
        for piece in _parts(shapely.LineString(image).intersection(frame)):
            if piece.geom_type == "LineString":
                yield _simple(piece), what == HIDDEN


def _simple(geometry: Any) -> Any:
    simple = geometry.simplify(SIMPLE)
    return geometry if simple.is_empty or not simple.is_valid else simple


def trace(view: View, xy: FloatArray) -> list[tuple[FloatArray, int]]:
    """Follow a line of the map over the ground.

    Parameters
    ----------
    view : View
    xy : array (N, 2)
        Vertices in `view.crs`.

    Returns
    -------
    list of (array (M, 2), int)
        Pieces in image coordinates, each wholly seen, hidden or unseen (`SEEN`, `HIDDEN`, `UNSEEN`), in order. Ends
        between them are found to 1e-6 of the distance of the places looked at.
    """
    xy = _densified(xy, max(min(view.spacing, 4.0 * STEP * view.sampling), view.sampling))
    image = view.image(view.ground(xy))
    for _ in range(3):  # near the camera of an oblique photo a step on the ground is many pixels
        xy, more = _closer(view, xy, image)
        if not more:
            break
        image = view.image(view.ground(xy))
    image, state = view.look(xy)
    changes = np.flatnonzero(state[1:] != state[:-1])
    before, after = _borders(view, xy, state, changes)
    pieces = []
    starts, stops = [0, *(changes + 1)], [*(changes + 1), len(xy)]
    for k, (start, stop) in enumerate(zip(starts, stops, strict=True)):
        points = [image[start:stop]]
        if k > 0:
            points.insert(0, after[k - 1 : k])
        if k < len(changes):
            points.append(before[k : k + 1])
        whole = np.vstack(points)
        pieces.append((whole[np.isfinite(whole).all(axis=1)] if state[start] != UNSEEN else whole, int(state[start])))
    return pieces


def _densified(xy: FloatArray, step: float) -> FloatArray:
    length = np.hypot(*np.diff(xy, axis=0).T)
    counts = np.maximum(np.ceil(length / step), 1.0)
    return _cut(xy, counts)


def _closer(view: View, xy: FloatArray, image: FloatArray) -> tuple[FloatArray, bool]:
    """Cut what is longer than a step in the image, as far as it is near the frame; and whether there was any."""
    with np.errstate(invalid="ignore"):
        length = np.hypot(*np.diff(image, axis=0).T)
        low, high = np.minimum(image[1:], image[:-1]), np.maximum(image[1:], image[:-1])
        near = ((high >= 0.0) & (low <= np.array(view.model.size))).all(axis=1)
        counts = np.where(near & (length > 1.5 * STEP), np.minimum(np.ceil(length / STEP), 1000.0), 1.0)
    if not (counts > 1.0).any():
        return xy, False
    return _cut(xy, counts), True


def _cut(xy: FloatArray, counts: FloatArray) -> FloatArray:
    """Cut each of N − 1 segments into so many equal parts."""
    if counts.sum() > MOST:
        raise InputError(
            f"a line would need {counts.sum():.2g} points to follow the ground",
            mend="cut the vectors to what the photo shows, or use a DEM with larger pixels",
        )
    whole: IntArray = counts.astype(np.int64)
    segment = np.repeat(np.arange(len(whole)), whole)
    first = np.repeat(np.cumsum(whole) - whole, whole)
    share = (np.arange(len(segment)) - first) / whole[segment]
    points = xy[segment] + share[:, None] * (xy[segment + 1] - xy[segment])
    return np.vstack([points, xy[-1:]])


def _borders(view: View, xy: FloatArray, state: FloatArray, changes: IntArray) -> tuple[FloatArray, FloatArray]:
    """Image points (C, 2) just before and just behind each change of state, by bisection."""
    low, high = np.zeros(len(changes)), np.ones(len(changes))
    first, last = xy[changes], xy[changes + 1]
    for _ in range(_BISECTIONS if len(changes) else 0):
        middle = 0.5 * (low + high)
        same = view.look(first + middle[:, None] * (last - first))[1] == state[changes]
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    ends = [view.image(view.ground(first + t[:, None] * (last - first))) for t in (low, high)]
    return ends[0], ends[1]
