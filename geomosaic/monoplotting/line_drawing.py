"""Map points draped on the surface and projected into a photo, with occlusion."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import has_heights, horizontal
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import linear_unit, metres_per_unit
from geomosaic.sensor.plugin import SensorModel
from geomosaic.sensor.solve import image_to_ground
from geomosaic.sensor.solve.newton import pixel_step
from geomosaic.surface.model import Surface
from geomosaic.types import BoolArray, FloatArray, IntArray

# Ground pixels by which the surface must be in front of a point to occlude it: below lies the solver's noise.
TOLERANCE = 0.05
# States of a point: no image or no height; occluded by the surface; visible.
NO_IMAGE, OCCLUDED, VISIBLE = 0, 1, 2


@dataclass(frozen=True)
class View:
    """Projection of map points into one photo over a surface.

    Attributes
    ----------
    model : SensorModel
    surface : Surface or None
        None where heights play no part.
    crs : CRS
        Of the map, 2-D.
    sampling : float
        Map units that one pixel covers in the middle of the image.
    spacing : float
        Distance of the surface's nodes in map units; inf where it has one height.
    """

    model: SensorModel
    surface: Surface | None
    crs: CRS
    sampling: float
    spacing: float

    @classmethod
    def of(cls, model: SensorModel, surface: Surface | None, crs: CRS) -> View:
        """View whose sampling is measured in the middle of the image.

        Parameters
        ----------
        model : SensorModel
        surface : Surface or None
        crs : CRS
        """
        flat = horizontal(crs)
        own = model.crs if surface is None else surface.crs
        middle = np.array([[model.size[0] / 2.0, model.size[1] / 2.0]])
        seen = image_to_ground(model, middle, surface)
        if not np.isfinite(seen).all():
            seen = Transform(model.crs, own)(np.array([model.seed])) if has_heights(own) else np.array([model.seed])
        place = Transform(horizontal(own), flat)(seen[:, :2])[0]
        draft = cls(model, surface, flat, 1.0, np.inf)

        def image(xy: FloatArray) -> FloatArray:
            ground = draft.ground(xy)
            ground[:, 2] = seen[0, 2]
            return draft.image(ground)

        step = pixel_step(image, place, 1.0 if flat.is_projected else 1e-5)
        return cls(model, surface, flat, step, _spacing(surface, flat, seen[0, :2]))

    def ground(self, xy: FloatArray) -> FloatArray:
        """Map points (N, 2) draped on the surface: (N, 3) in its CRS, or in the model's without a surface."""
        own = self.model.crs if self.surface is None else self.surface.crs
        place = Transform(self.crs, horizontal(own))(np.asarray(xy, dtype=np.float64))
        heights = np.zeros(len(place)) if self.surface is None else self.surface.height(place)
        return np.column_stack([place, heights])

    def image(self, ground: FloatArray) -> FloatArray:
        """Image coordinates (N, 2) of draped points (N, 3), pixels; NaN where there are none."""
        if self.surface is None:
            return self.model.ground_to_image(ground)
        if has_heights(self.model.crs):
            return self.model.ground_to_image(Transform(self.surface.crs, self.model.crs)(ground))
        flat = Transform(horizontal(self.surface.crs), self.model.crs)(ground[:, :2])
        return self.model.ground_to_image(np.column_stack([flat, np.zeros(len(flat))]))

    def drape_to_image(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Image coordinates (N, 2) of map points (N, 2), pixels, and the state (N,) of each.

        A point is occluded where its line of sight meets the surface before it, by more than `TOLERANCE`.
        Points outside the frame are not examined: they count as visible.
        """
        ground = self.ground(xy)
        image = self.image(ground)
        state = np.where(np.isfinite(image).all(axis=1), VISIBLE, NO_IMAGE)
        if self.surface is None or not has_heights(self.model.crs):
            return image, state
        inside = np.flatnonzero((state == VISIBLE) & self.within(np.nan_to_num(image, nan=-1e9), 2.0))
        if len(inside):
            state[inside[self._hidden(ground[inside], image[inside])]] = OCCLUDED
        return image, state

    def within(self, image: FloatArray, margin: float = 0.0) -> BoolArray:
        """Mask (N,) of image points (N, 2) within the frame, enlarged by a margin in pixels."""
        near = (image >= -margin) & (image <= np.array(self.model.size) + margin)
        return np.asarray(near.all(axis=1))

    def _hidden(self, ground: FloatArray, image: FloatArray) -> BoolArray:
        assert self.surface is not None
        first = image_to_ground(self.model, image, self.surface)
        apart = (first - ground) * metres_per_unit(self.surface.crs, ground)
        tolerance = TOLERANCE * self.sampling * linear_unit(self.crs)
        hidden: BoolArray = (np.linalg.norm(apart, axis=1) > tolerance) & (apart[:, 2] > 0.0)
        return hidden


def _spacing(surface: Surface | None, crs: CRS, place: FloatArray) -> float:
    """Node spacing of a surface in map units; if it has no attribute `spacing`, that of a patch at `place`."""
    if surface is None or surface.range[0] == surface.range[1]:
        return np.inf
    known = getattr(surface, "spacing", None)
    if known is None:
        x, y = place
        t = surface.patch((x, y, x, y)).transform
        known = 1.0 / max(np.hypot(t.a, t.d), np.hypot(t.b, t.e))
    return float(known) * linear_unit(surface.crs) / linear_unit(crs)


# Pixels between the places of a line that are looked at.
STEP = 8.0
# Pixels by which a drawn line may be simplified.
SIMPLE = 0.02
MOST = 4_000_000
_TOGETHER = 2000
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
    parts: list[tuple[int, Any]] = []
    for number, geometry in enumerate(geometries):
        if geometry is None or geometry.is_empty:
            continue
        flat = shapely.force_2d(geometry)
        if not flat.is_valid:
            flat = shapely.make_valid(flat)
        inside = flat if shapely.contains_properly(area, flat) else flat.intersection(area)
        parts += [(number, part) for part in _parts(inside)]
    out = Drawing([], [], [])
    for start in range(0, len(parts), _TOGETHER):
        some = parts[start : start + _TOGETHER]
        for (number, _), pieces in zip(some, _drawn(view, [part for _, part in some]), strict=True):
            for drawn, covered in pieces:
                if hidden or not covered:
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


def _drawn(view: View, parts: Sequence[Any]) -> Iterator[list[tuple[Any, bool]]]:
    """Pieces of each simple geometry, and whether they are hidden; all lines are looked at together."""
    import shapely

    frame = shapely.box(0.0, 0.0, *view.model.size)
    rings = [_rings(part) for part in parts]
    traced = iter(_trace_all(view, [ring for each in rings for ring in each]))
    for part, own in zip(parts, rings, strict=True):
        lines = [next(traced) for _ in own]
        if part.geom_type == "Point":
            (image, what), *_ = lines[0]
            shown = what != NO_IMAGE and view.within(image[:1])[0]
            yield [(shapely.Point(image[0]), what == OCCLUDED)] if shown else []
        elif part.geom_type == "Polygon" and all(len(line) == 1 and line[0][1] == VISIBLE for line in lines):
            (outer, *holes) = [line[0][0] for line in lines]
            area = shapely.make_valid(shapely.Polygon(outer, holes)).intersection(frame)
            yield [(_simple(piece), False) for piece in _parts(area) if piece.geom_type == "Polygon"]
        else:
            yield [
                (_simple(piece), what == OCCLUDED)
                for line in lines
                for image, what in line
                if what != NO_IMAGE and len(image) > 1
                for piece in _parts(shapely.LineString(image).intersection(frame))
                if piece.geom_type == "LineString"
            ]


def _rings(part: Any) -> list[FloatArray]:
    """Vertices of the lines a simple geometry is made of; a point is a line of one vertex."""
    lines = [part.exterior, *part.interiors] if part.geom_type == "Polygon" else [part]
    return [np.asarray(line.coords, dtype=np.float64)[:, :2] for line in lines]


def _simple(geometry: Any) -> Any:
    simple = geometry.simplify(SIMPLE)
    return geometry if simple.is_empty or not simple.is_valid else simple


def trace(view: View, xy: FloatArray) -> list[tuple[FloatArray, int]]:
    """Follow one line of the map over the ground, see `_trace_all`.

    Parameters
    ----------
    view : View
    xy : array (N, 2)
        Vertices, CRS of the map.
    """
    return _trace_all(view, [xy])[0]


def _trace_all(view: View, lines: Sequence[FloatArray]) -> list[list[tuple[FloatArray, int]]]:
    """Pieces in image coordinates (M, 2) of lines (N, 2) of the map, each of one state, in order.

    Ends between states are found to 1e-6 of the distance of the places looked at.
    """
    if not lines:
        return []
    xy = np.vstack(lines)
    line = np.repeat(np.arange(len(lines)), [len(each) for each in lines])
    step = max(min(view.spacing, 4.0 * STEP * view.sampling), view.sampling)
    length = np.hypot(*np.diff(xy, axis=0).T)
    xy, line = _cut(xy, line, np.maximum(np.ceil(length / step), 1.0))
    for _ in range(3):  # near the camera of an oblique photo a step on the ground is many pixels
        counts = _closer(view, view.image(view.ground(xy)))
        if not (counts[line[1:] == line[:-1]] > 1.0).any():
            break
        xy, line = _cut(xy, line, counts)
    image, state = view.drape_to_image(xy)
    joined = line[1:] == line[:-1]
    changes = np.flatnonzero((state[1:] != state[:-1]) & joined)
    before, after = _borders(view, xy, state, changes)
    behind = dict(zip((changes + 1).tolist(), after, strict=True))
    ahead = dict(zip(changes.tolist(), before, strict=True))
    cuts = [0, *(np.flatnonzero((state[1:] != state[:-1]) | ~joined) + 1).tolist(), len(xy)]
    out: list[list[tuple[FloatArray, int]]] = [[] for _ in lines]
    for start, stop in itertools.pairwise(cuts):
        ends = [[behind[start]] if start in behind else [], [ahead[stop - 1]] if stop - 1 in ahead else []]
        whole = np.array([*ends[0], *image[start:stop], *ends[1]])
        what = int(state[start])
        out[line[start]].append((whole if what == NO_IMAGE else whole[np.isfinite(whole).all(axis=1)], what))
    return out


def _closer(view: View, image: FloatArray) -> FloatArray:
    """Into how many parts each segment is cut: what is near the frame and longer than a step in the image."""
    with np.errstate(invalid="ignore"):
        length = np.hypot(*np.diff(image, axis=0).T)
        low, high = np.minimum(image[1:], image[:-1]), np.maximum(image[1:], image[:-1])
        near = ((high >= 0.0) & (low <= np.array(view.model.size))).all(axis=1)
        return np.asarray(np.where(near & (length > 1.5 * STEP), np.minimum(np.ceil(length / STEP), 1000.0), 1.0))


def _cut(xy: FloatArray, line: IntArray, counts: FloatArray) -> tuple[FloatArray, IntArray]:
    """Cut each of N − 1 segments into so many equal parts; what lies between two lines is none."""
    whole: IntArray = np.where(line[1:] == line[:-1], counts, 1.0).astype(np.int64)
    if whole.sum() > MOST:
        raise InputError(
            f"lines would need {whole.sum():.2g} points to follow the ground",
            hint="cut the vectors to what the photo shows, or use a DEM with larger pixels",
        )
    segment = np.repeat(np.arange(len(whole)), whole)
    first = np.repeat(np.cumsum(whole) - whole, whole)
    share = (np.arange(len(segment)) - first) / whole[segment]
    points = xy[segment] + share[:, None] * (xy[segment + 1] - xy[segment])
    return np.vstack([points, xy[-1:]]), np.concatenate([line[segment], line[-1:]])


def _borders(view: View, xy: FloatArray, state: FloatArray, changes: IntArray) -> tuple[FloatArray, FloatArray]:
    """Image points (C, 2) just before and just behind each change of state, by bisection."""
    low, high = np.zeros(len(changes)), np.ones(len(changes))
    first, last = xy[changes], xy[changes + 1]
    for _ in range(_BISECTIONS if len(changes) else 0):
        middle = 0.5 * (low + high)
        same = view.drape_to_image(first + middle[:, None] * (last - first))[1] == state[changes]
        low, high = np.where(same, middle, low), np.where(same, high, middle)
    ends = [view.image(view.ground(first + t[:, None] * (last - first))) for t in (low, high)]
    return ends[0], ends[1]
