"""Grid lines of one CRS on a map in another, their ends at the neatline, and their labels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import shapely
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.grid import Bounds
from geomosaic.geo.projection_domain import DomainBoundary, domain
from geomosaic.geo.transform import Transform
from geomosaic.numbers import angle_text, decimals, grouped, multiples, nice_step
from geomosaic.types import BoolArray, FloatArray

# Greatest number of meridians around a pole: every 5 degrees, since more would merge there.
_MOST_MERIDIANS = 72


@dataclass(frozen=True)
class GridLine:
    """Line of constant x or y of a grid.

    Attributes
    ----------
    axis : int, 0: x is constant (a line to the north), 1: y is
    value : float, in the grid's CRS
    pieces : tuple of array (N, 2), inside the neatline, in the map's CRS
    ends : tuple of (side, x, y)
        Where the line meets the neatline, in the map's CRS; side is 'left', 'bottom', 'right' or 'top'.
    """

    axis: int
    value: float
    pieces: tuple[FloatArray, ...]
    ends: tuple[tuple[str, float, float], ...]


@dataclass(frozen=True)
class MapGrid:
    """Grid on the map: its lines, intervals and CRS.

    Attributes
    ----------
    crs : CRS
    intervals : tuple of float
        Of lines of constant x and of constant y, in its own units; they differ where meridians meet at a pole.
    lines : tuple of GridLine
    crossings : array (N, 2), in the map's CRS
    pole : array (2,), optional, in the map's CRS, where one lies inside the neatline
    """

    crs: CRS
    intervals: tuple[float, float]
    lines: tuple[GridLine, ...]
    crossings: FloatArray
    pole: FloatArray | None = None

    @property
    def interval(self) -> float:
        """Of lines of constant y."""
        return self.intervals[1]

    @property
    def degrees(self) -> bool:
        """Whether it counts in degrees."""
        return bool(self.crs.is_geographic)

    @property
    def turned(self) -> bool:
        """Whether lines of constant x run across the sheet rather than up, as near the poles."""
        ways = {0: 0.0, 1: 0.0}
        for line in self.lines:
            for piece in line.pieces:
                dx, dy = np.abs(piece[-1] - piece[0])
                ways[line.axis] += float(dx - dy)
        return ways[0] > ways[1]

    def label(self, line: GridLine) -> str:
        """What stands beside a line."""
        if self.degrees:
            signs = "NS" if line.axis else "EW"
            if not line.axis and abs(abs(line.value) - 180.0) < 1e-9:
                return angle_text(180.0, self.intervals[0])  # east and west are one there
            return angle_text(line.value, self.intervals[line.axis], signs=signs)
        return grouped(line.value, decimals(self.intervals[line.axis], 3))


def map_grid(crs: CRS, map_crs: CRS, bounds: Bounds, spacing: float, interval: float | None = None) -> MapGrid:
    """Lines of a grid inside a neatline.

    Parameters
    ----------
    crs : CRS, of the grid: projected, or geographic in degrees, longitude first
    map_crs : CRS, of the map
    bounds : Bounds, neatline in `map_crs`
    spacing : float, least distance of lines in units of `map_crs`, for the round interval where none is given
    interval : float, optional, in units of `crs`

    Raises
    ------
    InputError
        The grid is not defined here, or the interval gives more than 200 lines.
    """
    flat = horizontal(crs)
    there, back = Transform(map_crs, flat), Transform(flat, map_crs)
    extent = extent_of(flat, there, back, bounds)
    low, high, pole = extent.low, extent.high, extent.pole
    size = np.array([bounds[2] - bounds[0], bounds[3] - bounds[1]])
    steps = _steps(extent, size, spacing, bool(flat.is_geographic), interval)
    # More lines than that would cover the map.
    count = max((high - low) / steps)
    if count > 200:
        raise InputError(
            f"an interval of {steps[1]:.10g} gives {count:.0f} lines on this sheet", hint="give a longer interval"
        )
    xs, ys = (multiples(low[i], high[i], steps[i]) for i in (0, 1))
    if pole is not None:
        xs = xs[xs > low[0] + 1e-9]  # the line of 180 degrees once
    lines = []
    for axis, values in ((0, xs), (1, ys)):
        for value in values.tolist():
            first, last = low[1 - axis], high[1 - axis]
            if pole is not None and axis == 0 and value % 90.0:
                # Where meridians crowd only those of the four quarters go on to the pole.
                stop = 90.0 - min(steps[1], (last - first) / 2)
                first, last = max(first, -stop), min(last, stop)
            points = SAMPLES * (max(1, round((last - first) / 90.0)) if flat.is_geographic else 1)
            path = np.empty((points, 2))
            path[:, axis], path[:, 1 - axis] = value, np.linspace(first, last, points)
            path = _whole(path, flat)
            # The ends of parallels around a pole, and of meridians at it, lie inside the neatline.
            ends = [
                end == limit and (pole is None or (axis == 0 and abs(end) < 90.0))
                for end, limit in ((first, low[1 - axis]), (last, high[1 - axis]))
            ]
            line = _clipped_to_map(axis, float(path[0, axis]), _longer(back(path), ends), bounds, pole)
            if line is not None:
                lines.append(line)
    nodes = back(_whole(np.array([(x, y) for x in xs for y in ys]).reshape(-1, 2), flat))
    return MapGrid(flat, (float(steps[0]), float(steps[1])), tuple(lines), nodes[_within(nodes, bounds)], pole)


def _steps(
    extent: Extent, size: FloatArray, spacing: float, degrees: bool, interval: float | None
) -> tuple[float, float]:
    """Intervals of x and y: as given, or round ones whose lines lie `spacing` apart at least."""
    # Where no line of one kind would be on the sheet, those lie closer. Around a pole meridians are `spacing` apart
    # half-way to the sides, unless closer ones are given and are not too many, and parallels twice as close, since few
    # of them are on the sheet.
    low, high = extent.low, extent.high
    if extent.pole is not None:
        reach = float(size.min()) / 2
        parallels = interval or nice_step(spacing / 2 * extent.degrees_per_unit, degrees=True)
        meridians = nice_step(360.0 * spacing / (np.pi * reach), degrees=True)
        if interval is not None and 360.0 / interval <= _MOST_MERIDIANS:
            return interval, interval
        return max(parallels, meridians), parallels
    if interval is not None:
        return interval, interval
    step = nice_step(float(spacing * np.max((high - low) / size)), degrees=degrees)
    x, y = (
        step if _has_multiples(first, last, step) else nice_step((last - first) / 4, degrees=degrees)
        for first, last in zip(low.tolist(), high.tolist(), strict=True)
    )
    return x, y


def _has_multiples(low: float, high: float, step: float) -> bool:
    """Whether a multiple lies between two values, and not on one of them."""
    hair = _COINCIDENT * (high - low)
    return bool(len(multiples(low + hair, high - hair, step)))


def _whole(places: FloatArray, crs: CRS) -> FloatArray:
    """Longitudes wrapped to -180 ... 180 degrees."""
    if not crs.is_geographic:
        return places
    beyond = places[:, 0] > 180.0
    return np.column_stack([places[:, 0] - 360.0 * beyond, places[:, 1]])


def _within(points: FloatArray, bounds: Bounds) -> BoolArray:
    left, bottom, right, top = bounds
    x, y = points[:, 0], points[:, 1]
    inside: BoolArray = (x > left) & (x < right) & (y > bottom) & (y < top)
    return inside


def _clipped_to_map(
    axis: int, value: float, path: FloatArray, bounds: Bounds, pole: FloatArray | None
) -> GridLine | None:
    """Part of a line inside the neatline; None where nothing is, or where it coincides with a side."""
    hair = _COINCIDENT * max(bounds[2] - bounds[0], bounds[3] - bounds[1])
    sides = zip((0, 1, 0, 1), bounds, strict=True)
    if len(path) < 2 or any(np.abs(path[:, k] - side).max() < hair for k, side in sides):
        return None
    cut = shapely.intersection(shapely.LineString(path), shapely.box(*bounds))
    parts = [p for p in shapely.get_parts(cut) if p.geom_type == "LineString" and p.length > 0]
    if not parts:
        return None
    pieces = tuple(np.asarray(part.coords) for part in parts)
    ends = []
    for piece in pieces:
        for x, y in (piece[0], piece[-1]):
            side = _side(float(x), float(y), bounds, axis)
            if side and (pole is None or np.hypot(x - pole[0], y - pole[1]) > hair):
                ends.append((side, float(x), float(y)))
    return GridLine(axis, value, pieces, tuple(ends))


def _longer(path: FloatArray, ends: Sequence[bool]) -> FloatArray:
    """Defined part of a line, extended by a step at its ends so that it surely crosses the neatline."""
    path = path[np.isfinite(path).all(axis=1)]
    if len(path) < 2:
        return path
    before, after = path[:1] + ends[0] * (path[:1] - path[1:2]), path[-1:] + ends[1] * (path[-1:] - path[-2:-1])
    return np.vstack([before, path, after])


def _side(x: float, y: float, bounds: Bounds, axis: int) -> str:
    """Side of the neatline on which a point lies; at a corner the one that lines of this axis cross."""
    left, bottom, right, top = bounds
    hair = 1e-9 * max(abs(v) for v in bounds) + 1e-7 * (right - left)
    # At a corner lines of constant x end at the bottom or top, those of constant y at the left or right.
    misses = [("bottom", y - bottom), ("top", y - top), ("left", x - left), ("right", x - right)]
    for side, miss in misses if axis == 0 else misses[2:] + misses[:2]:
        if abs(miss) < hair:
            return side
    return ""


# Points along each side of the neatline and each line: a graticule bends by less than 1e-3 of its sagitta between.
SAMPLES = 65


# Share of a sheet's size within which two points coincide: above rounding, below any line width.
_COINCIDENT = 1e-6


@dataclass(frozen=True)
class Extent:
    """Lowest and highest x and y (2,) of a grid on a sheet.

    Longitudes may go beyond 180 degrees. Where a pole lies inside the neatline, it stands in `pole`, in the map's CRS,
    with the degrees of latitude that a unit of the map has there. `turns`: x are longitudes.
    """

    low: FloatArray
    high: FloatArray
    pole: FloatArray | None = None
    degrees_per_unit: float = 0.0
    turns: bool = False


def extent_of(crs: CRS, there: Transform, back: Transform, bounds: Bounds) -> Extent:
    """Extent of a grid within the neatline of a sheet.

    Parameters
    ----------
    crs : CRS, of the grid, horizontal
    there, back : Transform, from the map to the grid, and from the grid to the map
    bounds : Bounds, neatline in the map's CRS

    Raises
    ------
    InputError
        A projected grid is not defined here. Of longitude and latitude the whole globe is taken where the sheet
        reaches beyond it.
    """
    ring = neatline_points(bounds)
    edge = there(ring)
    if not crs.is_geographic:
        if not np.isfinite(edge).all():
            raise InputError(f"the grid of '{crs.name}' is not defined on this sheet", hint="choose another grid CRS")
        return Extent(edge.min(axis=0), edge.max(axis=0))
    hair = _COINCIDENT * max(bounds[2] - bounds[0], bounds[3] - bounds[1])
    own = horizontal(there.source)
    folded = own.is_projected and domain(own).folds and bool(DomainBoundary.of(own).beyond(ring).any())
    whole = bool(np.isfinite(edge).all()) and not folded
    poles = {sign: place for sign in (1.0, -1.0) if (place := _pole(back, sign, bounds, hair)) is not None}
    if not whole or len(poles) == 2:  # a sheet that is wider than the globe
        return Extent(np.array([-180.0, -90.0]), np.array([180.0, 90.0]), turns=True)
    if not poles:
        # Steps from point to point: no jump where east becomes west.
        turns = (np.diff(edge[:, 0]) + 180.0) % 360.0 - 180.0
        edge[1:, 0] = edge[0, 0] + np.cumsum(turns)
        edge[:, 0] -= 360.0 * np.floor((edge[:, 0].min() + 180.0 + 1e-9) / 360.0)
        return Extent(edge.min(axis=0), edge.max(axis=0), turns=True)
    ((sign, pole),) = poles.items()
    low, high = (float(edge[:, 1].min()), 90.0) if sign > 0 else (-90.0, float(edge[:, 1].max()))
    per_unit = 1.0 / float(np.hypot(*(back(np.array([[0.0, sign * 89.0]]))[0] - pole)))
    return Extent(np.array([-180.0, low]), np.array([180.0, high]), pole, per_unit, turns=True)


def _pole(back: Transform, sign: float, bounds: Bounds, hair: float) -> FloatArray | None:
    """Position of a pole that is a point inside a neatline or on it, else None."""
    places = back(np.array([[0.0, sign * 90.0], [90.0, sign * 90.0]]))
    x, y = places[0]
    inside = bounds[0] - hair <= x <= bounds[2] + hair and bounds[1] - hair <= y <= bounds[3] + hair
    return places[0] if inside and np.abs(places[1] - places[0]).max() < hair else None


def neatline_points(bounds: Bounds) -> FloatArray:
    """Points around the neatline, counter-clockwise from the lower left corner.

    Parameters
    ----------
    bounds : Bounds
    """
    left, bottom, right, top = bounds
    return densified_ring(np.array([(left, bottom), (right, bottom), (right, top), (left, top)]), SAMPLES - 1)


def densified_ring(ring: FloatArray, parts: int) -> FloatArray:
    """Ring with every side divided into parts, not closed.

    Parameters
    ----------
    ring : array (N, 2), not closed
    parts : int
    """
    ahead = np.roll(ring, -1, axis=0)
    share = np.arange(parts)[None, :, None] / parts
    dense: FloatArray = (ring[:, None] * (1 - share) + ahead[:, None] * share).reshape(-1, 2)
    return dense
