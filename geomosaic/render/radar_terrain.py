"""Terrain as a radar sees it: layover, shadow and foreshortening, and the local incidence angle.

A block of the output is gone over along straight profiles away from the sensor, one ground pixel apart, which begin and
end as far outside of it as the relief can reach. Over these kilometres the direction of the profiles turns by less than
a tenth of a degree. Places of the sensor, and of the ground at a height, are smooth: one in 32 is computed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.geo.crs import horizontal
from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import metres_per_unit
from geomosaic.resample.layover_shadow import UNKNOWN, profile_classes
from geomosaic.surface.model import Surface
from geomosaic.types import ByteArray, FloatArray

# Nodes of what is smooth: pixels between them.
STEP = 32
# Metres between two heights whose ground places make the vertical.
RISE = 1000.0
# Steepest and flattest look that profiles reach for: the horizontal reach of a metre of relief is at most 4 m.
REACH = 4.0


@dataclass(frozen=True, eq=False)
class _Smooth:
    """What is smooth over places: ground on the surface's zero height, the vertical, the sensor, the surface's map."""

    ground: FloatArray
    up: FloatArray
    sensor: FloatArray
    surface: FloatArray

    def at(self, heights: FloatArray) -> FloatArray:
        """Lines (..., 3) from the ground at heights (...) to the sensor, metres."""
        line: FloatArray = self.sensor - self.ground - heights[..., None] * self.up
        return line


@dataclass(frozen=True, eq=False)
class RadarTerrain:
    """Terrain of an output as one radar scene sees it.

    Attributes
    ----------
    grid : Grid
        The output.
    surface : Surface
    model : SensorModel with `sensor_positions`
    """

    grid: Grid
    surface: Surface
    model: Any

    @cached_property
    def _to_surface(self) -> Transform:
        return Transform(self.grid.crs, horizontal(self.surface.crs))

    @cached_property
    def _to_model(self) -> Transform:
        crs: CRS = self.model.crs
        return Transform(self.surface.crs, crs)

    def classes(self, window: Window) -> ByteArray:
        """Classes (rows, cols) of the pixels of a window; see `layover_shadow`.

        Parameters
        ----------
        window : Window
        """
        metres, away = self._away(window)
        rows, cols = window.height, window.width
        if away is None:
            return np.full((rows, cols), UNKNOWN, dtype=np.uint8)
        spacing = float(metres.min())
        # Pixels of the window in metres along the profiles and across them, from its middle.
        col = (np.arange(cols) + 0.5 - cols / 2) * metres[0]
        row = (np.arange(rows) + 0.5 - rows / 2) * metres[1]
        along = away[0] * col[None, :] + away[1] * row[:, None]
        across = -away[1] * col[None, :] + away[0] * row[:, None]
        low, high = self.surface.range
        beyond = REACH * (high - low) + 2.0 * spacing
        first = np.array([along.min() - beyond, across.min() - 2.0 * spacing])
        counts = (
            np.ceil((np.array([along.max() + beyond, across.max() + 2.0 * spacing]) - first) / spacing).astype(int) + 1
        )
        centre = np.array([window.col + cols / 2, window.row + rows / 2])

        def pixels(profile: FloatArray, point: FloatArray) -> FloatArray:
            """Pixels of the grid (profiles, points, 2)."""
            g, a = first[0] + spacing * point[None, :], first[1] + spacing * profile[:, None]
            offsets = np.stack([away[0] * g - away[1] * a, away[1] * g + away[0] * a], axis=-1) / metres
            return np.asarray(centre + offsets)

        smooth = self._smooth(pixels, int(counts[1]), int(counts[0]))
        heights = self._heights(smooth.surface)
        sensor = smooth.sensor
        distance = np.sqrt(np.einsum("...i,...i->...", sensor, sensor))

        def seen(height: FloatArray) -> tuple[FloatArray, FloatArray]:
            line = smooth.at(height)
            ranges = np.sqrt(np.einsum("...i,...i->...", line, line))
            return ranges, -np.einsum("...i,...i->...", line, sensor) / (ranges * distance)

        level, _ = seen(np.full(heights.shape, (low + high) / 2))
        found = profile_classes(*seen(heights), level)
        at = np.rint((across - first[1]) / spacing).astype(int), np.rint((along - first[0]) / spacing).astype(int)
        return np.asarray(found[at])

    def incidence(self, window: Window) -> FloatArray:
        """Local incidence angles (rows, cols) of the pixels of a window, degrees: of the line of sight to the normal.

        Parameters
        ----------
        window : Window
        """

        def pixels(row: FloatArray, col: FloatArray) -> FloatArray:
            c, r = np.meshgrid(window.col - 0.5 + col, window.row - 0.5 + row)
            return np.stack([c, r], axis=-1)

        smooth = self._smooth(pixels, window.height + 2, window.width + 2)
        line = smooth.at(self._heights(smooth.surface))
        places = smooth.sensor - line
        normal = np.cross(np.gradient(places, axis=0), np.gradient(places, axis=1))
        upwards = np.sign(np.einsum("...i,...i->...", normal, smooth.up))
        lengths = np.sqrt(np.einsum("...i,...i->...", normal, normal) * np.einsum("...i,...i->...", line, line))
        with np.errstate(invalid="ignore", divide="ignore"):
            cosine = upwards * np.einsum("...i,...i->...", normal, line) / lengths
        angles: FloatArray = np.degrees(np.arccos(np.clip(cosine[1:-1, 1:-1], -1.0, 1.0)))
        return angles

    def _heights(self, xy: FloatArray) -> FloatArray:
        return np.asarray(self.surface.height(xy.reshape(-1, 2))).reshape(xy.shape[:-1])

    def _away(self, window: Window) -> tuple[FloatArray, FloatArray | None]:
        """Metres (2,) per pixel along columns and rows, and the direction (2,) away from the sensor there.

        None where the sensor does not pass the window.
        """
        centre = np.array([window.col + window.width / 2, window.row + window.height / 2])
        # Ends of a cross of half the window: ranges and times over it are nearly linear.
        half = np.array([window.width, window.height]) / 2
        ends = centre + np.array([[0.0, 0.0], [half[0], 0.0], [-half[0], 0.0], [0.0, half[1]], [0.0, -half[1]]])
        unit = np.broadcast_to(metres_per_unit(self.grid.crs, self.grid.xy(centre[None])[0]), (2,))
        metres = np.abs(np.array(self.grid.resolution)) * unit
        ground = self._ground(self.grid.xy(ends), sum(self.surface.range) / 2)
        image, sensor = self.model.ground_to_image(ground), self.model.sensor_positions(ground)
        ranges = np.linalg.norm(ground - sensor, axis=1)
        rows = image[:, 1]
        if not (np.isfinite(ranges).all() and np.isfinite(rows).all()):
            return metres, None
        by = 2.0 * half * metres
        time = np.array([rows[1] - rows[2], rows[3] - rows[4]]) / by
        growth = np.array([ranges[1] - ranges[2], ranges[3] - ranges[4]]) / by
        away = np.array([-time[1], time[0]]) / math.hypot(*time)
        return metres, away * (1.0 if away @ growth > 0.0 else -1.0)

    def _ground(self, xy: FloatArray, height: float) -> FloatArray:
        """Places (N, 3) of the model's frame at a height of the surface's over map places (N, 2)."""
        there = self._to_surface(xy)
        return self._to_model(np.column_stack([there, np.full(len(there), height)]))

    def _smooth(self, pixels: Any, rows: int, cols: int) -> _Smooth:
        """What is smooth, at all of a raster of places, from every 32nd: `pixels(rows, cols)` are those of the grid."""
        at_rows, at_cols = _nodes(rows), _nodes(cols)
        xy = self.grid.xy(pixels(at_rows, at_cols).reshape(-1, 2))
        there = self._to_surface(xy)
        zero = self._ground(xy, 0.0)
        up = (self._ground(xy, RISE) - zero) / RISE
        sensor = self.model.sensor_positions(zero + up * sum(self.surface.range) / 2)
        shape = len(at_rows), len(at_cols)
        by_row, by_col = _weights(at_rows, rows), _weights(at_cols, cols)

        def everywhere(values: FloatArray) -> FloatArray:
            grid = values.reshape(*shape, -1)
            return np.stack([by_row @ grid[..., k] @ by_col.T for k in range(grid.shape[-1])], axis=-1)

        return _Smooth(everywhere(zero), everywhere(up), everywhere(sensor), everywhere(there))


def _nodes(count: int) -> FloatArray:
    """Places of nodes along `count` places, the ends among them."""
    return np.linspace(0.0, count - 1.0, max(2, math.ceil((count - 1) / STEP) + 1))


def _weights(nodes: FloatArray, count: int) -> FloatArray:
    """Weights (count, nodes) of linear interpolation."""
    step = nodes[1] - nodes[0]
    places = np.arange(count) / step
    left = np.minimum(places.astype(int), len(nodes) - 2)
    out = np.zeros((count, len(nodes)))
    out[np.arange(count), left] = 1.0 - (places - left)
    out[np.arange(count), left + 1] = places - left
    return out
