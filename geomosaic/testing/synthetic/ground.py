"""Synthetic ground, known at every point: relief in closed form, and its land cover with roofs and shadows.

Colours are red, green, blue and near infrared, 0..1, as a display shows them. Each layer is laid over those before it
with a soft mask. No edge is sharper and no pattern finer than the smallest wavelength asked for.

Coordinates here are local: (u, v) metres east and north of the ground's origin.

    z(u, v) = Σ Aᵢ·cos(2π(u·cos θᵢ + v·sin θᵢ)/λᵢ + φᵢ) + Σ Hⱼ·exp(−((u−uⱼ)² + (v−vⱼ)²)/(2·σⱼ²))
              − D·exp(−(v − r(u))²/(2·W²)),     r(u) the course of the river

Every term is bounded with a bounded slope, so the range of heights and the steepest slope are known without sampling.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from affine import Affine
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import has_heights
from geomosaic.geo.grid import Bounds
from geomosaic.surface.model import HeightPatch
from geomosaic.testing.synthetic.relief import (
    MASK,
    PERIOD,
    SUN,
    bounds,
    crowns,
    heights,
    patchwork,
    relief,
    river,
    soft,
    spline_noise,
    table,
)
from geomosaic.types import AnyArray, Float32Array, FloatArray

ROOFS = np.array(
    [
        [0.60, 0.34, 0.26, 0.44],
        [0.53, 0.30, 0.23, 0.40],
        [0.62, 0.42, 0.33, 0.47],
        [0.42, 0.37, 0.34, 0.36],
        [0.50, 0.49, 0.49, 0.44],
    ],
    dtype=np.float32,
)
SHADOW = np.array([0.10, 0.12, 0.13, 0.16], dtype=np.float32)
STREET = np.array([0.50, 0.48, 0.46, 0.45], dtype=np.float32)
PLOT, TURN = 31.0, 0.30  # metres, radians
KEEP = 0.72  # share of plots that are built on


def houses(ground: Float32Array, u: Float32Array, v: Float32Array, edge: float, seed: int) -> Float32Array:
    """Village laid over the ground's colours: streets, shadows and roofs.

    Parameters
    ----------
    ground : float32 array (N, 4)
        Colours, 0..1.
    u, v : float32 array (N,)
        Places in metres from the origin of the ground.
    edge : float
        Width of soft edges in metres.
    seed : int
        Fixes plots, sizes and colours.

    Returns
    -------
    float32 array (N, 4)
        Colours, 0..1.
    """
    turn_c, turn_s = np.float32(np.cos(TURN)), np.float32(np.sin(TURN))
    a, b = turn_c * u + turn_s * v, turn_c * v - turn_s * u
    i, j = np.floor(a / np.float32(PLOT)), np.floor(b / np.float32(PLOT))
    index = (j.astype(np.int64) & MASK) * PERIOD + (i.astype(np.int64) & MASK)
    random = table(seed, "houses", 7)[index]
    # A street along every second line between plots, a lane across every fifth.
    street = np.abs(np.mod(b, np.float32(2 * PLOT)) - np.float32(PLOT))
    lane = np.abs(np.mod(a, np.float32(5 * PLOT)) - np.float32(2 * PLOT))
    paved = np.maximum(soft(np.float32(2.4) - street, edge), soft(np.float32(1.9) - lane, edge))
    ground = ground + paved[:, None] * (STREET - ground)

    inset = np.minimum(
        np.float32(PLOT / 2) - np.abs(a - (i + np.float32(0.5)) * np.float32(PLOT)),
        np.float32(PLOT / 2) - np.abs(b - (j + np.float32(0.5)) * np.float32(PLOT)),
    )
    inside = soft(inset - np.float32(3.2 * edge), edge) * (random[:, 6] < KEEP)  # nothing crosses into the next plot
    x = a - (i + np.float32(0.5)) * np.float32(PLOT) - (random[:, 0] - np.float32(0.5)) * 5
    y = b - (j + np.float32(0.5)) * np.float32(PLOT) - (random[:, 1] - np.float32(0.5)) * 4
    twist = (random[:, 2] - np.float32(0.5)) * np.float32(0.24) + np.float32(np.pi / 2) * (random[:, 2] > 0.8)
    c, s = np.cos(twist), np.sin(twist)
    length, depth = 5 + 3 * random[:, 3], np.float32(3.9) + np.float32(1.4) * random[:, 4]
    # Away from the sun, in the axes of the plots.
    fall = (
        turn_c * -np.float32(SUN[0]) - turn_s * np.float32(SUN[1]),
        -turn_c * np.float32(SUN[1]) + turn_s * np.float32(SUN[0]),
    )
    x2, y2 = x - 3 * fall[0], y - 3 * fall[1]
    shadow = _box(c * x2 + s * y2, c * y2 - s * x2, length, depth, edge)
    ground = ground + (np.float32(0.8) * shadow * inside)[:, None] * (SHADOW - ground)
    along, across = c * x + s * y, c * y - s * x
    roof = ROOFS[(random[:, 5] * len(ROOFS)).astype(np.int64)]
    facing = -(fall[1] * c - fall[0] * s)  # how squarely the upper side of the ridge looks into the sun
    side = np.tanh(across * np.float32(1 / edge))
    tone = np.float32(0.98) + np.float32(0.26) * facing * side
    mask = _box(along, across, length, depth, edge) * inside
    built: Float32Array = ground + mask[:, None] * (roof * tone[:, None] - ground)
    return built


def _box(x: Float32Array, y: Float32Array, half_x: Float32Array, half_y: Float32Array, edge: float) -> Float32Array:
    """Soft rectangle around the origin."""
    return soft(half_x - np.abs(x), edge) * soft(half_y - np.abs(y), edge)


FIELDS = np.array(
    [
        [0.66, 0.60, 0.43, 0.52],  # ripe wheat
        [0.58, 0.52, 0.39, 0.48],  # stubble
        [0.44, 0.37, 0.29, 0.36],  # ploughed
        [0.37, 0.31, 0.25, 0.32],  # ploughed, wet
        [0.35, 0.42, 0.24, 0.70],  # meadow
        [0.39, 0.46, 0.25, 0.76],  # young crop
        [0.25, 0.33, 0.18, 0.72],  # beet, maize
        [0.31, 0.38, 0.22, 0.66],  # pasture
        [0.49, 0.49, 0.31, 0.60],  # hay
        [0.42, 0.45, 0.27, 0.64],  # grass
    ],
    dtype=np.float32,
)
LEAF_DARK, LEAF_LIGHT, PINE_LIGHT = (0.09, 0.14, 0.08, 0.34), (0.29, 0.37, 0.18, 0.80), (0.18, 0.27, 0.16, 0.60)
HEDGE, VERGE, GARDEN = (0.19, 0.26, 0.14, 0.58), (0.45, 0.46, 0.30, 0.56), (0.33, 0.40, 0.23, 0.66)
WATER, SAND = (0.16, 0.22, 0.22, 0.06), (0.60, 0.56, 0.46, 0.50)
ASPHALT, GRAVEL = (0.53, 0.52, 0.51, 0.46), (0.61, 0.56, 0.45, 0.55)
VILLAGE = (205.0, 260.0)


@dataclass(frozen=True)
class Land:
    """Land cover as a function of place.

    Attributes
    ----------
    wavelength : float
        Smallest wavelength in metres; a photo or ortho with pixels of at most half of it shows it without aliasing.
    seed : int
        Which land.
    bands : int
        1 to 4: red, green, blue, near infrared.
    """

    wavelength: float = 2.5
    seed: int = 7
    bands: int = 3

    def __call__(self, u: Float32Array, v: Float32Array, slope_u: Float32Array, slope_v: Float32Array) -> Float32Array:
        """Radiance (N, bands), 0..1, at local coordinates (N,) in metres, shaded by the slope of the relief (N,)."""
        broad, middle = self._noise("broad", u, v, 130.0), self._noise("middle", u, v, 21.0)
        fine = self._noise("fine", u, v, 1.6)
        colour = self._fields(u, v, broad, middle, fine)
        colour = self._woods(colour, u, v, broad, middle)
        colour = self._river(colour, u, v, middle, fine)
        colour = self._village(colour, u, v, broad, fine)
        colour = self._roads(colour, u, v, fine)
        light = 1 - np.float32(0.8) * (slope_u * np.float32(SUN[0]) + slope_v * np.float32(SUN[1]))
        light *= 1 + np.float32(0.07) * middle + np.float32(0.12) * broad
        lit: Float32Array = np.clip(colour[:, : self.bands] * light[:, None], 0, 1)
        return lit

    @property
    def _edge(self) -> float:
        """Half-width of the sharpest edge in metres."""
        return 0.42 * self.wavelength

    def _noise(self, name: str, u: Float32Array, v: Float32Array, spacing: float) -> Float32Array:
        return spline_noise(u, v, max(spacing, 0.9 * self.wavelength), table(self.seed, name, 1)[:, 0])

    def _fields(
        self, u: Float32Array, v: Float32Array, broad: Float32Array, middle: Float32Array, fine: Float32Array
    ) -> Float32Array:
        """Patchwork of fields with rows of crop, hedges and grass strips between them."""
        bend = np.float32(60.0) * broad
        c, s = np.float32(np.cos(0.42)), np.float32(np.sin(0.42))
        along, across = c * u + s * v + bend, c * v - s * u - bend
        size = max(1.0, self._edge / 2.0)
        p, q = along * np.float32(1 / (190.0 * size)), across * np.float32(1 / (112.0 * size))
        random = table(self.seed, "fields", 6)
        attributes = np.zeros((len(random), 8), dtype=np.float32)
        attributes[:, :4] = FIELDS[(random[:, 2] * len(FIELDS)).astype(np.int64)] * (0.90 + 0.2 * random[:, 3:4])
        rows = (random[:, 4] * 4).astype(np.int64)
        for k in range(3):  # which of three directions the rows of the crop run in, and how clearly
            attributes[rows == k, 4 + k] = 0.02 + 0.07 * random[rows == k, 5]
        attributes[:, 7] = 0.4 + 0.9 * random[:, 5]
        edge = self._edge / (112.0 * size)
        blended, border = patchwork(p, q, random[:, :2], attributes, edge, min(3.5 * edge, 0.05))
        stripes = np.zeros_like(u)
        for k, (turn, length) in enumerate(((0.0, 6.5), (np.pi / 2, 8.0), (0.0, 14.0))):
            k_wave = 2 * np.pi / max(length, 1.3 * self.wavelength)
            phase = (along * np.float32(np.sin(turn)) + across * np.float32(np.cos(turn))) * np.float32(k_wave)
            stripes += blended[:, 4 + k] * np.cos(phase)
        tone = 1 + stripes + blended[:, 7] * (np.float32(0.22) * fine + np.float32(0.26) * middle)
        colour = blended[:, :4] * tone[:, None]
        hedge = soft(self._noise("hedge", u, v, 70.0) - np.float32(0.03), 0.05)
        leaves = np.clip(np.float32(1) + np.float32(1.6) * fine, 0.3, 1.8)[:, None] * np.asarray(
            HEDGE, dtype=np.float32
        )
        colour = _lay(colour, border * (1 - hedge) * np.float32(0.75), VERGE)
        return _lay(colour, border * hedge, leaves)

    def _woods(
        self, colour: Float32Array, u: Float32Array, v: Float32Array, broad: Float32Array, middle: Float32Array
    ) -> Float32Array:
        """Woods on the higher ground, and lines of trees; crowns lit from the sun's side."""
        patches = self._noise("woods", u, v, 260.0) + np.float32(0.22) * broad + np.float32(0.035) * middle
        village = ((u - VILLAGE[0]) / 380) ** 2 + ((v - VILLAGE[1]) / 300) ** 2
        patches -= np.exp(-village) * np.float32(0.5)
        course, slope = river(u)
        bank = np.abs(v - course) / np.sqrt(1 + slope * slope)
        riverside = np.exp(-(((bank - 24) / 10) ** 2)) * (self._noise("bank", u, v, 60.0) + np.float32(0.12)) * 2
        mask = np.maximum(soft(patches - np.float32(0.115), 0.007), soft(riverside - np.float32(0.15), 0.1))
        near = np.flatnonzero(mask > 1e-5)
        if not len(near):
            return colour
        spacing = max(7.5, 2.6 * self.wavelength)
        cover, light = crowns(u[near], v[near], spacing, table(self.seed, "crowns", 4))
        pine = soft(self._noise("pines", u[near], v[near], 95.0), 0.06)[:, None]
        bright = np.asarray(LEAF_LIGHT, dtype=np.float32) * (1 - pine) + np.asarray(PINE_LIGHT, dtype=np.float32) * pine
        dark = np.asarray(LEAF_DARK, dtype=np.float32)
        leaves = dark + (cover * light)[:, None] * (bright - dark)
        colour[near] = _lay(colour[near], mask[near], leaves)
        return colour

    def _river(
        self, colour: Float32Array, u: Float32Array, v: Float32Array, middle: Float32Array, fine: Float32Array
    ) -> Float32Array:
        """Water with pale banks and a little current."""
        course, slope = river(u)
        distance = np.abs(v - course) / np.sqrt(1 + slope * slope)
        half = np.float32(10.0) + np.float32(6.0) * middle
        sand = soft(self._noise("sand", u, v, 48.0) - np.float32(0.08), 0.06)
        colour = _lay(colour, soft(half + 6 - distance, max(2.0, self._edge)) * sand, SAND)
        depth = np.float32(1) + np.float32(0.25) * fine + np.float32(0.35) * np.exp(-(((distance - half) / 5) ** 2))
        return _lay(colour, soft(half - distance, self._edge), depth[:, None] * np.asarray(WATER, dtype=np.float32))

    def _roads(self, colour: Float32Array, u: Float32Array, v: Float32Array, fine: Float32Array) -> Float32Array:
        """Two metalled roads, and a pair of farm tracks."""
        for amplitude, length, phase, offset, half, northward in (
            (34.0, 260.0, 0.7, -560.0, 1.6, True),
            (42.0, 310.0, 2.0, 560.0, 1.6, False),
            (26.0, 300.0, 1.1, -470.0, 1.6, False),
            (70.0, 520.0, 2.4, 240.0, 3.4, False),
            (48.0, 430.0, 0.3, 190.0, 3.0, True),
        ):
            a, b = (v, u) if northward else (u, v)
            angle = a * np.float32(1 / length) + np.float32(phase)
            slope = np.cos(angle) * np.float32(amplitude / length)
            distance = np.abs(b - offset - np.float32(amplitude) * np.sin(angle)) / np.sqrt(1 + slope * slope)
            if half > 2:
                colour = _lay(colour, soft(half + 3 - distance, max(1.5, self._edge)) * np.float32(0.8), VERGE)
            surface = np.asarray(ASPHALT if half > 2 else GRAVEL, dtype=np.float32)
            worn = (1 + np.float32(0.08) * fine)[:, None] * surface
            strength = np.float32(1.0 if half > 2 else 0.8)
            colour = _lay(colour, soft(half - distance, self._edge) * strength, worn)
        return colour

    def _village(
        self, colour: Float32Array, u: Float32Array, v: Float32Array, broad: Float32Array, fine: Float32Array
    ) -> Float32Array:
        """Gardens, streets, and houses with ridged roofs and shadows."""
        reach = ((u - VILLAGE[0]) / 235) ** 2 + ((v - VILLAGE[1]) / 165) ** 2
        mask = soft(np.float32(1) + np.float32(1.6) * broad - reach.astype(np.float32, copy=False), 0.06)
        near = np.flatnonzero(mask > 1e-5)
        if not len(near):
            return colour
        local = colour[near]
        garden = (1 + np.float32(0.5) * fine[near])[:, None] * np.asarray(GARDEN, dtype=np.float32)
        ground = _lay(local, np.full(len(near), 0.8, dtype=np.float32), garden)
        cover, light = crowns(u[near], v[near], max(9.0, 2.6 * self.wavelength), table(self.seed, "trees", 4))
        sparse = soft(self._noise("orchard", u[near], v[near], 26.0) - np.float32(0.1), 0.05)
        dark = np.asarray(LEAF_DARK, dtype=np.float32)
        leaves = dark + (cover * light)[:, None] * (np.asarray(LEAF_LIGHT, dtype=np.float32) - dark)
        ground = _lay(ground, cover * sparse, leaves)
        ground = houses(ground, u[near], v[near], self._edge, self.seed)
        colour[near] = _lay(local, mask[near], ground)
        return colour


def _lay(under: Float32Array, mask: Float32Array, over: AnyArray | Sequence[float]) -> Float32Array:
    """Colours with others (4,) or (N, 4) laid over them (N, 4) where the mask (N,) is 1."""
    return under + mask[:, None] * (np.asarray(over, dtype=np.float32) - under)


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
            raise InputError(
                f"the ground needs a map CRS with heights, not '{self.crs.name}'",
                hint="add heights, such as EPSG:32633 with 'ellipsoidal'",
            )
        if not 1 <= self.bands <= 4:
            raise InputError(f"the ground has 1 to 4 bands, not {self.bands}", hint="give 1, 2, 3 or 4")

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
