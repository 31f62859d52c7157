"""Grid lines of any CRS on a map of any other: where they run, where they leave the neatline, and their labels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pyproj import CRS

from geomosaic.carto.nice import angle_text, decimals, grouped, multiples, nice_step
from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.grid import Bounds
from geomosaic.geo.transform import Transform
from geomosaic.types import BoolArray, FloatArray

SAMPLES = 65
"""Points along each side of the neatline and each line: a graticule bends by less than 1e-3 of its sagitta between."""


@dataclass(frozen=True)
class GridLine:
    """One line of constant x or y of a grid.

    Attributes
    ----------
    axis : int
        0: x is constant (a line to the north), 1: y is.
    value : float
        In the grid's CRS.
    pieces : tuple of array (N, 2)
        Inside the neatline, in the map's CRS.
    ends : tuple of (side, x, y)
        Where the line meets the neatline, in the map's CRS; side is 'left', 'bottom', 'right' or 'top'.
    """

    axis: int
    value: float
    pieces: tuple[FloatArray, ...]
    ends: tuple[tuple[str, float, float], ...]


@dataclass(frozen=True)
class MapGrid:
    """A grid on the map: its CRS, interval in its own units, lines, and crossings (N, 2) in the map's CRS."""

    crs: CRS
    interval: float
    lines: tuple[GridLine, ...]
    crossings: FloatArray

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
                return angle_text(180.0, self.interval)  # east and west are one there
            return angle_text(line.value, self.interval, signs=signs)
        return grouped(line.value, decimals(self.interval, 3))


def map_grid(crs: CRS, map_crs: CRS, bounds: Bounds, spacing: float, interval: float | None = None) -> MapGrid:
    """Lines of a grid inside a neatline.

    Parameters
    ----------
    crs : CRS
        Of the grid: projected, or geographic in degrees, longitude first.
    map_crs : CRS
        Of the map.
    bounds : Bounds
        Neatline in `map_crs`.
    spacing : float
        Least distance of lines in units of `map_crs`, for the round interval where none is given.
    interval : float, optional
        In units of `crs`.

    Raises
    ------
    InputError
        The grid is not defined here, or the interval gives more than 200 lines.
    """
    flat = horizontal(crs)
    there, back = Transform(map_crs, flat), Transform(flat, map_crs)
    edge = there(_outline(bounds))
    if not np.isfinite(edge).all():
        raise InputError(f"the grid of '{flat.name}' is not defined on this sheet", mend="choose another grid CRS")
    if flat.is_geographic and np.ptp(edge[:, 0]) > 180.0:
        edge[:, 0] %= 360.0  # across the 180th meridian
        if np.ptp(edge[:, 0]) > 180.0:
            raise InputError("the sheet has a pole on it", mend='give [graticule] style = "none"')
    low, high = edge.min(axis=0), edge.max(axis=0)
    if interval is None:
        size = np.array([bounds[2] - bounds[0], bounds[3] - bounds[1]])
        interval = nice_step(float(spacing * np.max((high - low) / size)), degrees=bool(flat.is_geographic))
    if max((high - low) / interval) > 200:
        raise InputError(
            f"an interval of {interval:g} gives {max((high - low) / interval):.0f} lines on this sheet",
            mend="give a longer interval",
        )
    lines = []
    for axis in (0, 1):
        along = np.linspace(low[1 - axis], high[1 - axis], SAMPLES)
        for value in multiples(low[axis], high[axis], interval):
            path = np.empty((SAMPLES, 2))
            path[:, axis], path[:, 1 - axis] = value, along
            path = _whole(path, flat)
            line = _inside(axis, float(path[0, axis]), back(path), bounds)
            if line is not None:
                lines.append(line)
    xs, ys = (multiples(low[i], high[i], interval) for i in (0, 1))
    nodes = back(_whole(np.array([(x, y) for x in xs for y in ys]).reshape(-1, 2), flat))
    return MapGrid(flat, float(interval), tuple(lines), nodes[_within(nodes, bounds)])


def _whole(places: FloatArray, crs: CRS) -> FloatArray:
    """Longitudes beyond 180 degrees as those of the west."""
    if not crs.is_geographic:
        return places
    beyond = places[:, 0] > 180.0
    return np.column_stack([places[:, 0] - 360.0 * beyond, places[:, 1]])


def _outline(bounds: Bounds) -> FloatArray:
    """Points along the neatline."""
    left, bottom, right, top = bounds
    t = np.linspace(0.0, 1.0, SAMPLES)
    xs, ys = left + t * (right - left), bottom + t * (top - bottom)
    sides = [(xs, np.full(SAMPLES, v)) for v in (bottom, top)] + [(np.full(SAMPLES, v), ys) for v in (left, right)]
    return np.concatenate([np.column_stack(side) for side in sides])


def _within(points: FloatArray, bounds: Bounds) -> BoolArray:
    left, bottom, right, top = bounds
    x, y = points[:, 0], points[:, 1]
    inside: BoolArray = (x > left) & (x < right) & (y > bottom) & (y < top)
    return inside


def _inside(axis: int, value: float, path: FloatArray, bounds: Bounds) -> GridLine | None:
    """Cut a line at the neatline; None where nothing of it is inside."""
    import shapely

    path = _longer(path[np.isfinite(path).all(axis=1)])
    if len(path) < 2:
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
            if side:
                ends.append((side, float(x), float(y)))
    return GridLine(axis, value, pieces, tuple(ends))


def _longer(path: FloatArray) -> FloatArray:
    """Extend a line by a hair at both ends: those that should meet the neatline then do."""
    if len(path) < 2:
        return path
    return np.vstack([2 * path[0] - path[1], path, 2 * path[-1] - path[-2]])


def _side(x: float, y: float, bounds: Bounds, axis: int) -> str:
    """Side of the neatline on which a point lies; at a corner the one that lines of this axis cross."""
    left, bottom, right, top = bounds
    hair = 1e-9 * max(abs(v) for v in bounds) + 1e-7 * (right - left)
    misses = [("bottom", y - bottom), ("top", y - top), ("left", x - left), ("right", x - right)]
    for side, miss in misses if axis == 0 else misses[2:] + misses[:2]:
        if abs(miss) < hair:
            return side
    return ""
