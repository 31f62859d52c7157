"""Synthetic ground: height and colour known at every point, relief in closed form with its gradient.

Coordinates here are local: (u, v) metres east and north of the ground's origin.

    z(u, v) = Σ Aᵢ·cos(2π(u·cos θᵢ + v·sin θᵢ)/λᵢ + φᵢ) + Σ Hⱼ·exp(−((u−uⱼ)² + (v−vⱼ)²)/(2·σⱼ²))
              − D·exp(−(v − r(u))²/(2·W²)),     r(u) the course of the river

Every term is bounded with a bounded slope, so the range of heights and the steepest slope are known without sampling.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from affine import Affine
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import has_heights
from geomosaic.geo.grid import Bounds
from geomosaic.surface.model import HeightPatch
from geomosaic.testing.synthetic.land import Land
from geomosaic.testing.synthetic.relief import bounds, heights, relief
from geomosaic.types import Float32Array, FloatArray

CHUNK = 1 << 15  # points at a time: what a core's cache holds


@dataclass(frozen=True)
class AnalyticGround:
    """Synthetic ground: relief and colour in closed form; a `Surface`.

    Attributes
    ----------
    crs : CRS
        3-D CRS in metres (projected, or a local one); its heights are those of the relief.
    origin : (float, float)
        Where in `crs` the middle of the land lies.
    base : float
        Height in metres about which the relief goes up and down.
    exaggeration : float
        Factor on the relief; 0 is flat country.
    wavelength : float
        Smallest wavelength of the colour in metres. Pixels up to half of it show it without aliasing.
    bands : int
        1 to 4: red, green, blue, near infrared.
    seed : int
        Which land.
    spacing : float
        Nodes of `patch`, metres.
    targets : tuple of (float, float)
        Places in `crs` marked by a white spot on a dark disc, as surveyed points are before a flight.
    """

    crs: CRS
    origin: tuple[float, float] = (0.0, 0.0)
    base: float = 450.0
    exaggeration: float = 1.0
    wavelength: float = 2.5
    bands: int = 3
    seed: int = 7
    spacing: float = 2.0
    targets: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        if self.crs.is_geocentric or not has_heights(self.crs):
            raise InputError(f"the ground needs a map CRS with heights, not '{self.crs.name}'")
        if not 1 <= self.bands <= 4:
            raise InputError(f"the ground has 1 to 4 bands, not {self.bands}")

    @property
    def range(self) -> tuple[float, float]:
        """Bounds of the height in metres, from the formulas; safe rather than tight."""
        low, high, _ = bounds()
        return self.base + self.exaggeration * low, self.base + self.exaggeration * high

    @property
    def steepest(self) -> float:
        """Upper bound of the slope in metres per metre."""
        return abs(self.exaggeration) * bounds()[2]

    @property
    def datum(self) -> FloatArray:
        """The point (3,) that coordinate pictures count from: the origin at the base height."""
        return np.array([*self.origin, self.base])

    def _local(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        points = np.asarray(xy, dtype=np.float64)
        return points[:, 0] - self.origin[0], points[:, 1] - self.origin[1]

    def height(self, xy: FloatArray) -> FloatArray:
        """Heights (N,) in metres at (N, 2) in `crs`."""
        return self.base + self.exaggeration * heights(*self._local(xy))

    def gradient(self, xy: FloatArray) -> FloatArray:
        """Slopes dz/dx and dz/dy (N, 2) at (N, 2) in `crs`."""
        _, zu, zv = relief(*self._local(xy))
        return self.exaggeration * np.column_stack([zu, zv])

    def height_and_gradient(self, xy: FloatArray) -> tuple[FloatArray, FloatArray]:
        """`height` (N,) and `gradient` (N, 2) for the price of one."""
        z, zu, zv = relief(*self._local(xy))
        return self.base + self.exaggeration * z, self.exaggeration * np.column_stack([zu, zv])

    def texture(self, xy: FloatArray) -> Float32Array:
        """Radiance (N, bands), 0..1, at (N, 2) in `crs`; NaN where a coordinate is."""
        u, v = self._local(xy)
        out = np.empty((len(u), self.bands), dtype=np.float32)
        land = Land(self.wavelength, self.seed, self.bands)
        for start in range(0, len(u), CHUNK):
            part = slice(start, start + CHUNK)
            seen = np.isfinite(u[part]) & np.isfinite(v[part])
            pu, pv = (np.where(seen, p[part], 0.0).astype(np.float32) for p in (u, v))
            _, zu, zv = relief(pu, pv)
            out[part] = land(pu, pv, *(np.float32(self.exaggeration) * slope for slope in (zu, zv)))
            for x, y in self.targets:
                out[part] = _mark(out[part], pu - (x - self.origin[0]), pv - (y - self.origin[1]), self.wavelength)
            out[part][~seen] = np.nan
        return out

    def patch(self, bounds: Bounds, spacing: float = 0.0) -> HeightPatch:
        """Heights at nodes `spacing` apart over bounds (left, bottom, right, top) in `crs`, two nodes to spare."""
        s = self.spacing
        first_col, last_col = np.floor(bounds[0] / s) - 2, np.ceil(bounds[2] / s) + 2
        first_row, last_row = np.floor(bounds[1] / s) - 2, np.ceil(bounds[3] / s) + 2
        x, y = np.arange(first_col, last_col + 1) * s, np.arange(last_row, first_row - 1, -1) * s
        nodes = np.column_stack([np.tile(x, len(y)), np.repeat(y, len(x))])
        heights = self.height(nodes).reshape(len(y), len(x)).astype(np.float32)
        return HeightPatch(heights, ~Affine(s, 0.0, x[0] - s / 2, 0.0, -s, y[0] + s / 2))


def _mark(colour: Float32Array, u: Float32Array, v: Float32Array, wavelength: float) -> Float32Array:
    """Colours (N, bands) with a target laid over them: white out to about 1.3 m from (0, 0), dark out to 3 m."""
    near = np.flatnonzero(u * u + v * v < (5.0 * max(3.0, 2 * wavelength)) ** 2)
    if not len(near):
        return colour
    radius = max(1.3, 0.8 * wavelength)
    distance2 = (u[near] ** 2 + v[near] ** 2)[:, None] / radius**2
    colour[near] += np.exp(-((distance2 / 5.0) ** 2)) * (np.float32(0.12) - colour[near])
    colour[near] += np.exp(-distance2) * (np.float32(0.92) - colour[near])
    return colour
