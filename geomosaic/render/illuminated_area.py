"""Illuminated area of the ground in each pixel of a radar scene, by which its radar brightness is flattened.

Radar brightness is power per area of the slant range plane, A_β = δ_r · δ_a. Gamma nought is power per area of the
ground as the sensor sees it, projected onto the plane across the line of sight. With the facets of the ground that are
lit and whose range falls into a pixel,

    γ⁰ = β⁰ · A_β / A_γ,    A_γ = Σ |(a × b) · s|

a and b being the sides of a facet and s the direction to the sensor (Small, Flattening gamma: radiometric terrain
correction for SAR imagery, IEEE Transactions on Geoscience and Remote Sensing 49(8), 2011, equations 17 to 21). In
layover the areas of several places add up, as their echoes do; in shadow there is none.

Facets stand on profiles of one row each, a column wide at a middle height of the ground. Across a row a facet is
as long as the row is; along it, its area is spread evenly over the columns between its two ends, so that no column is
counted twice or left out however slopes stretch or compress them.
"""

from __future__ import annotations

import math
from collections import OrderedDict
from dataclasses import dataclass, field
from threading import Lock
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.geo.grid import Window
from geomosaic.geo.transform import Transform
from geomosaic.resample.layover_shadow import shadowed
from geomosaic.sensor.solve import image_to_height
from geomosaic.surface.model import Surface
from geomosaic.types import AnyArray, BoolArray, FloatArray, IntArray

# Pixels of a part that is computed at once. Wide ones: ground beside a part falls into it, along its rows.
WIDTH, HEIGHT = 4096, 256
# Rows of it whose facets are in memory at once.
STRIP = 64
# Columns and rows between nodes of what is smooth.
STEP = 64
# Metres between two heights whose ground places make the vertical.
RISE = 1000.0
_UP, _RIGHT = np.array([0.0, 0.0, RISE]), np.array([1.0, 0.0])
# Share of the slant range plane's area below which a pixel counts as shadow.
LEAST = 0.05
# Bytes of finished parts that are kept: those under some rows of a large output.
HELD = 192 << 20


@dataclass(frozen=True, eq=False)
class IlluminatedArea:
    """Illuminated area of the ground by pixels of a radar scene, over their area in the slant range plane.

    Attributes
    ----------
    model : SensorModel with `sensor_positions`
    surface : Surface
    """

    model: Any
    surface: Surface
    _parts: OrderedDict[tuple[int, int], AnyArray] = field(default_factory=OrderedDict, repr=False)
    _making: dict[tuple[int, int], Any] = field(default_factory=dict, repr=False)
    _lock: Any = field(default_factory=Lock, repr=False)

    def at(self, window: Window) -> AnyArray:
        """A_γ / A_β (rows, cols), float32, of the pixels of a window; NaN in shadow, and where the ground is not known.

        Parameters
        ----------
        window : Window
            Of the scene.
        """
        out = np.empty((window.height, window.width), dtype=np.float32)
        for row in range(window.row // HEIGHT, -(-window.stop_row // HEIGHT)):
            for col in range(window.col // WIDTH, -(-window.stop_col // WIDTH)):
                whole = Window(col * WIDTH, row * HEIGHT, WIDTH, HEIGHT).intersection(Window(0, 0, *self.model.size))
                here = whole.intersection(window)
                values = self._part(whole)
                out[_within(here, window)] = values[_within(here, whole)]
        return out

    def _part(self, part: Window) -> AnyArray:
        """Part that is computed once, whichever threads ask for it."""
        key = part.col, part.row
        with self._lock:
            making = self._making.setdefault(key, Lock())
        with making:
            with self._lock:
                found = self._parts.pop(key, None)
                if found is not None:
                    self._parts[key] = found
                    return found
            area = self.summed(part)
            # Three digits are better than any DEM.
            found = np.where(area < LEAST, np.nan, area).astype(np.float16)
            with self._lock:
                self._parts[key] = found
                while sum(one.nbytes for one in self._parts.values()) > HELD:
                    self._parts.popitem(last=False)
            return found

    def summed(self, part: Window) -> FloatArray:
        """A_γ / A_β (rows, cols) of one part, from the facets of all rows and columns whose ground can fall into it.

        Next to nothing in shadow; NaN where the ground is not known.

        Parameters
        ----------
        part : Window
            Of the scene.
        """
        nodes = _Nodes.under(self.model, self.surface, part)
        if nodes is None:
            return np.full((part.height, part.width), np.nan)
        total = np.zeros((part.height, part.width))
        unknown = np.zeros(total.shape, dtype=np.bool_)
        for first in range(nodes.reach.row, nodes.reach.stop_row, STRIP):
            # One row more on either side, for the sides of facets across rows.
            stop = min(first + STRIP, nodes.reach.stop_row)
            level = nodes.level(max(first - 1, nodes.reach.row), min(stop + 1, nodes.reach.stop_row))
            heights = self.surface.height(level.map.reshape(2, -1).T).reshape(level.map.shape[1:])
            missing = np.isnan(heights)
            # A facet needs the rows on either side of its own.
            heights[1:][missing[:-1]] = np.nan
            heights[:-1][missing[1:]] = np.nan
            own = slice(first - level.first_row, stop - level.first_row)
            self._add(part, level, heights, own, total)
            top, bottom = max(first, part.row), min(stop, part.stop_row)
            if top < bottom:
                inside = slice(top - level.first_row, bottom - level.first_row)
                unknown[top - part.row : bottom - part.row] = level.open_pixels(heights, inside, part)
        ratio = total / nodes.range_step(part)
        ratio[unknown] = np.nan
        return ratio

    def _add(self, part: Window, level: _Level, heights: FloatArray, own: slice, total: FloatArray) -> None:
        """Add the areas of facets of some of the level's rows, per length of a row, to the pixels of a part."""
        known = np.isfinite(heights)
        z = np.where(known, heights, level.height) - level.height
        ground = level.ground + z * level.up
        line = level.sensor - ground
        ranges, distance = _length(line), _length(level.sensor)
        lit = known & ~shadowed(-_dot(line, level.sensor) / (ranges * distance), known)
        along = np.gradient(ground, axis=1)
        side = 0.5 * (along[..., 1:] + along[..., :-1])
        sight = line / ranges
        sight = 0.5 * (sight[..., 1:] + sight[..., :-1])
        seen = _dot(np.cross(side, np.diff(ground, axis=2), axis=0), sight) * level.turn
        # Per length of the row on level ground: the azimuth side of A_β.
        seen /= _length(np.gradient(level.ground, axis=1))[:, 1:]
        sends = lit[own, 1:] & lit[own, :-1] & (seen[own] > 0.0)
        cols, rows = (place[own] for place in level.shifted(z))
        middle = np.clip(0.5 * (rows[:, 1:] + rows[:, :-1]), 0.5, self.model.size[1] - 0.5)
        left, right = cols[:, :-1][sends] - part.col, cols[:, 1:][sends] - part.col
        total += _spread(left, right, middle[sends] - part.row, seen[own][sends], (part.height, part.width))


def _moved(model: Any, crs: CRS, image: FloatArray, limits: tuple[float, float]) -> tuple[FloatArray, FloatArray]:
    """Places (N, 3) of image places (N, 2) at a middle height, and shifts (2, N, 2) of lowest and highest ground."""
    there = image_to_height(model, image, 0.5 * sum(limits), crs)
    to_model = Transform(crs, model.crs)
    ends = [np.column_stack([there[:, :2], np.full(len(there), end)]) for end in limits]
    return there, np.stack([model.ground_to_image(to_model(end)) for end in ends]) - image


@dataclass(frozen=True)
class _Reach:
    """Columns and rows, at a middle height, of the ground that can fall into a part or shade it."""

    first: int
    stop: int
    row: int
    stop_row: int
    height: float

    @classmethod
    def of(cls, model: Any, crs: CRS, part: Window, limits: tuple[float, float]) -> _Reach | None:
        """Reach of ground between two heights; None where the orbit does not pass it."""
        low, high = limits
        rows = max(part.row, 0.5), min(part.stop_row, model.size[1] - 0.5)
        corners = np.array([[col, row] for col in (part.col, part.stop_col) for row in rows], dtype=np.float64)
        # Each corner and the place of the next column, found together: a search costs more than its points.
        both, shift = _moved(model, crs, np.concatenate([corners, corners + _RIGHT]), limits)
        to_model = Transform(crs, model.crs)
        there = both[: len(corners)]
        corner, beside = np.split(to_model(both), 2)
        line = (model.sensor_positions(corner) - corner).T
        rise = (to_model(there + _UP) - corner).T
        cosine = _dot(line, rise) / (_length(line) * _length(rise))
        # Columns that a shadow is long, by height: the tangent of the incidence angle.
        shade = np.sqrt(1.0 - cosine**2) / cosine / _length((beside - corner).T)
        if not (np.isfinite(shift).all() and (shade > 0.0).all()):
            return None
        # Ground at column u shows at u + shift; what shades it stands nearer to the sensor, at smaller columns.
        least, most = float(shift[..., 0].min()), float(shift[..., 0].max())
        margin = 1 + math.ceil(float(np.abs(shift[..., 1]).max()))
        return cls(
            math.floor(part.col - most - 1.02 * (high - low) * float(shade.max())) - 2,
            math.ceil(part.stop_col - least) + 2,
            max(0, part.row - margin),
            min(model.size[1], part.stop_row + margin),
            0.5 * (low + high),
        )

    def nodes(self, step: int) -> tuple[FloatArray, FloatArray]:
        """Columns and rows, about a step apart, from edge to edge and from the first to the last row's middle."""
        columns, rows = self.stop - self.first, self.stop_row - self.row
        return (
            np.linspace(self.first, self.stop, max(2, math.ceil(columns / step) + 1)),
            np.linspace(self.row + 0.5, self.stop_row - 0.5, max(2, math.ceil(rows / step) + 1)),
        )

    def relief(self, model: Any, surface: Surface) -> tuple[float, float] | None:
        """Lowest and highest ground, by every eighth column and row and with a margin for what is between them.

        A DEM may have far higher mountains elsewhere. None where no height is known.
        """
        cols, rows = self.nodes(8 * STEP)
        image = np.stack(np.meshgrid(cols, rows), axis=-1).reshape(-1, 2)
        places = image_to_height(model, image, self.height, surface.crs)[:, :2]
        at = np.arange(self.row, self.stop_row + 1.0, 8.0), np.arange(self.first, self.stop + 1.0, 8.0)
        xy = _bilinear(places.T.reshape(2, len(rows), len(cols)), (rows, cols), *at)
        found = surface.height(xy.reshape(2, -1).T)
        found = found[np.isfinite(found)]
        if not len(found):
            return None
        low, high = float(found.min()), float(found.max())
        margin = 0.1 * (high - low) + 5.0
        return max(low - margin, surface.range[0]), min(high + margin, surface.range[1])


@dataclass(frozen=True, eq=False)
class _Level:
    """Ground at a middle height under rows of a scene and facets along them, and how the scene moves with height.

    Arrays of vectors are (3, rows, points); those of the map (2, rows, points).
    """

    first_row: int
    cols: FloatArray
    height: float
    half: float
    ground: FloatArray
    up: FloatArray
    sensor: FloatArray
    map: FloatArray
    bends: FloatArray
    turn: float

    def shifted(self, z: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Columns and rows (rows, points) of the ground at heights above the middle one."""
        part = z / self.half
        rows = self.first_row + 0.5 + np.arange(len(z))[:, None]
        return (
            self.cols + part * (self.bends[0] + part * self.bends[2]),
            rows + part * (self.bends[1] + part * self.bends[3]),
        )

    def open_pixels(self, heights: FloatArray, inside: slice, part: Window) -> BoolArray:
        """Pixels of some rows into which ground may fall whose height is not known, were it as high as its neighbours.

        Neighbours are all of these rows whose height is known.
        """
        known = np.isfinite(heights[inside])
        if known.all() or not known.any():
            return np.full((len(known), part.width), not known.any())
        moved = (self.shifted(np.nan_to_num(heights - self.height))[0][inside] - self.cols)[known]
        number = np.concatenate([np.zeros((len(known), 1), dtype=int), np.cumsum(~known, axis=1)], axis=1)
        pixel = np.arange(part.col, part.stop_col)
        first = np.searchsorted(self.cols, pixel - math.ceil(moved.max()))
        last = np.searchsorted(self.cols, pixel + 1 - math.floor(moved.min()), side="right")
        return np.asarray(number[:, last] > number[:, first])


@dataclass(frozen=True, eq=False)
class _Nodes:
    """What is smooth over the reach of a part, at nodes: the vectors and shifts of `_Level`, one after the other."""

    reach: _Reach
    half: float
    rows: FloatArray
    cols: FloatArray
    table: FloatArray
    steps: FloatArray

    @classmethod
    def under(cls, model: Any, surface: Surface, part: Window) -> _Nodes | None:
        """Nodes of level ground that can fall into a part or shade it; None where the orbit does not pass it."""
        reach = _Reach.of(model, surface.crs, part, surface.range)
        limits = None if reach is None else reach.relief(model, surface)
        reach = None if limits is None else _Reach.of(model, surface.crs, part, limits)
        if reach is None or limits is None:
            return None
        to_model = Transform(surface.crs, model.crs)
        cols, rows = reach.nodes(STEP)
        image = np.stack(np.meshgrid(cols, rows), axis=-1).reshape(-1, 2)
        places, moves = _moved(model, surface.crs, image, limits)
        zero = to_model(places)
        up = (to_model(places + _UP) - zero) / RISE
        sensor = model.sensor_positions(zero)
        # Shifts by height are quadratics through those of the lowest, the middle and the highest ground.
        bends = [0.5 * (moves[1] - moves[0]), 0.5 * (moves[1] + moves[0])]
        table = np.concatenate([zero, up, sensor, places[:, :2], *bends], axis=1)
        if not np.isfinite(table).all():
            return None
        shape = len(rows), len(cols)
        steps = np.gradient(np.linalg.norm(sensor - zero, axis=1).reshape(shape), cols, axis=1)
        half = max(0.5 * (limits[1] - limits[0]), 1.0)
        return cls(reach, half, rows, cols, table.T.reshape(-1, *shape), steps)

    def level(self, row: int, stop_row: int) -> _Level:
        """Level ground under some rows."""
        reach = self.reach
        cols = np.arange(reach.first, reach.stop + 1.0)
        table = _bilinear(self.table, (self.rows, self.cols), np.arange(row + 0.5, stop_row), cols)
        ground, up, sensor = table[:3], table[3:6], table[6:9]
        facet = np.cross(ground[:, 1, 0] - ground[:, 0, 0], ground[:, 0, 1] - ground[:, 0, 0])
        turn = math.copysign(1.0, float(facet @ up[:, 0, 0]))
        return _Level(row, cols, reach.height, self.half, ground, up, sensor, table[9:11], table[11:], turn)

    def range_step(self, part: Window) -> FloatArray:
        """Metres of slant range from one column to the next, at the pixels of a part."""
        rows, cols = np.arange(part.row + 0.5, part.stop_row), np.arange(part.col + 0.5, part.stop_col)
        return np.asarray(_bilinear(self.steps[None], (self.rows, self.cols), rows, cols)[0])


def _spread(
    left: FloatArray, right: FloatArray, row: FloatArray, amount: FloatArray, shape: tuple[int, int]
) -> FloatArray:
    """Sums (rows, cols) of amounts that lie evenly between two columns, and linearly between two rows' middles."""
    rows, cols = shape
    low, high = np.minimum(left, right), np.maximum(left, right)
    width = np.maximum(high - low, 1e-9)
    high = low + width
    first = np.floor(low).astype(np.int64)
    above = np.floor(row - 0.5).astype(np.int64)
    lower = row - 0.5 - above
    total = np.zeros(rows * cols)
    touched = np.ceil(high).astype(np.int64) - first
    for number in range(int(touched.max(initial=0))):
        some = np.flatnonzero((touched > number) & (first + number >= 0) & (first + number < cols))
        col = first[some] + number
        share = (np.minimum(high[some], col + 1.0) - np.maximum(low[some], col)) / width[some] * amount[some]
        for down in (0, 1):
            at = above[some] + down
            inside = (at >= 0) & (at < rows)
            part = share * (lower[some] if down else 1.0 - lower[some])
            total += np.bincount((at * cols + col)[inside], part[inside], rows * cols)
    return total.reshape(shape)


def _bilinear(
    values: FloatArray, nodes: tuple[FloatArray, FloatArray], rows: FloatArray, cols: FloatArray
) -> FloatArray:
    """Values (K, rows, cols) of (K, R, C) at nodes (R,) and (C,)."""
    (down, lower), (across, right) = _between(nodes[0], rows), _between(nodes[1], cols)
    lines = values[..., across] * (1.0 - right) + values[..., across + 1] * right
    return np.asarray(lines[:, down] * (1.0 - lower)[:, None] + lines[:, down + 1] * lower[:, None])


def _between(nodes: FloatArray, at: FloatArray) -> tuple[IntArray, FloatArray]:
    """Equidistant node before each place, and the part of the way to the next."""
    place = (at - nodes[0]) / (nodes[1] - nodes[0])
    first = np.clip(place.astype(np.int64), 0, len(nodes) - 2)
    return first, place - first


def _within(part: Window, whole: Window) -> tuple[slice, slice]:
    """Rows and columns of a part in an array of the whole."""
    row, col = part.row - whole.row, part.col - whole.col
    return slice(row, row + part.height), slice(col, col + part.width)


def _dot(one: FloatArray, other: FloatArray) -> FloatArray:
    out: FloatArray = np.einsum("i...,i...->...", one, other)
    return out


def _length(vectors: FloatArray) -> FloatArray:
    return np.sqrt(_dot(vectors, vectors))
