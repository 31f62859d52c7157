"""Photos of the analytic ground: each pixel's line of sight, exactly to the relief; colour; camera effects."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import DTypeLike
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.transform import Transform
from geomosaic.testing.synthetic.ground import AnalyticGround
from geomosaic.testing.synthetic.relief import heights
from geomosaic.types import AnyArray, Float32Array, FloatArray

CHUNK = 1 << 16
CLOSE = 1e-4  # metres: the last step may follow the straight line, whose bend is 1e-3 for rays 6 km apart
NEAR = 0.3  # metres: from here on Newton steps cannot miss the first crossing of so smooth a relief
Texture = Callable[[AnalyticGround, FloatArray], AnyArray]


class Camera(Protocol):
    """Camera that a photo is rendered with: a sensor model with rays, or a `PlainCamera`."""

    @property
    def crs(self) -> CRS:
        """Cartesian frame of the rays."""

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""


@dataclass(frozen=True)
class Exposure:
    """Exposure of a photo: value = gain · radiance + offset.

    Attributes
    ----------
    gain, offset : tuple of float
        Per band; one number serves all bands.
    """

    gain: tuple[float, ...] = (1.0,)
    offset: tuple[float, ...] = (0.0,)


@dataclass(frozen=True)
class Vignetting:
    """Fall of light towards the corners: 1 − a·ρ² − b·ρ⁴.

    Attributes
    ----------
    a, b : float
        Coefficients; ρ is the distance from the image centre, 1 in the corners.
    """

    a: float = 0.0
    b: float = 0.0

    def factor(self, colrow: FloatArray, size: tuple[int, int]) -> FloatArray:
        """Transmission (N,) at image (N, 2)."""
        half = np.array(size) / 2.0
        rho2 = ((np.asarray(colrow) - half) ** 2).sum(axis=1) / (half**2).sum()
        factor: FloatArray = 1.0 - self.a * rho2 - self.b * rho2**2
        return factor


def radiance(ground: AnalyticGround, xyz: FloatArray) -> Float32Array:
    """Texture of an ordinary photo: the colour of the ground.

    Parameters
    ----------
    ground : AnalyticGround
    xyz : array (N, 3)
        Points in `ground.crs`.

    Returns
    -------
    float32 array (N, bands)
        0..1.
    """
    return ground.texture(xyz[:, :2])


def coordinates(ground: AnalyticGround, xyz: FloatArray) -> FloatArray:
    """Texture whose values are the ground coordinates, counted from `ground.datum`.

    Parameters
    ----------
    ground : AnalyticGround
    xyz : array (N, 3)
        Points in `ground.crs`.

    Returns
    -------
    array (N, 3)
        x, y, z in metres.
    """
    # Differences, because float32 resolves a northing of 5 500 km to half a metre only, and 1 km to 0.06 mm.
    return xyz - ground.datum


def intersect(model: Camera, ground: AnalyticGround, colrow: FloatArray) -> FloatArray:
    """First intersection of lines of sight with the relief.

    Exact to `TOLERANCE` in height. A model with `rays` is asked for them; any other is inverted by
    `geomosaic.sensor.solve.inverse`.

    Parameters
    ----------
    model : Camera
    ground : AnalyticGround
    colrow : array (N, 2)
        Image coordinates.

    Returns
    -------
    array (N, 3)
        In `ground.crs`; NaN where a line of sight misses the ground.
    """
    rays = getattr(model, "rays", None)
    if rays is None:
        from geomosaic.sensor.plugin import SensorModel
        from geomosaic.sensor.solve import image_to_ground

        return np.asarray(image_to_ground(cast(SensorModel, model), colrow, ground))
    origins, directions = rays(np.asarray(colrow, dtype=np.float64))
    return trace(model.crs, origins, directions, ground)


def trace(crs: CRS, origins: FloatArray, directions: FloatArray, ground: AnalyticGround) -> FloatArray:
    """First intersection of each ray with the relief.

    Parameters
    ----------
    crs : CRS
        Cartesian CRS of the rays.
    origins : array (N, 3)
        Metres.
    directions : array (N, 3)
        Of any length.
    ground : AnalyticGround

    Returns
    -------
    array (N, 3)
        Points in `ground.crs`; NaN where a ray does not meet the relief.
    """
    # A plane at the top of the relief gives one exact point of each ray in map coordinates, and derivatives in the
    # middle of all give its direction there. Along that straight line a step of gap/(fall + steepest slope · run) can
    # never pass the relief, so marching stops just before the first hit, wherever the ray comes from. Newton steps with
    # exact map coordinates then take out what is left, including the bend of the ray in the map.
    to_map = Transform(crs, ground.crs)
    highest = ground.range[1]
    foot = np.array([[*ground.origin, highest], [*ground.origin, highest + 1.0]])
    low, high = to_map.inverse()(foot)
    up = (high - low) / np.linalg.norm(high - low)
    fall = -(directions @ up)
    with np.errstate(divide="ignore", invalid="ignore"):
        # A ray that does not go down never meets the relief from above.
        t = np.where(fall > 1e-9, ((origins - low) @ up) / fall, np.nan)
    top = origins + t[:, None] * directions
    ahead = np.isfinite(t)
    if not ahead.any():
        return np.full(origins.shape, np.nan)
    # Derivatives of the map over 100 m: far above rounding of geocentric metres, far below the Earth's curvature.
    middle, arm = top[ahead].mean(axis=0), 50.0 * np.eye(3)
    step = directions @ (to_map(middle + arm) - to_map(middle - arm)) / 100.0
    t += _march(ground, to_map(top), step)
    point = np.full(origins.shape, np.nan)
    left = np.flatnonzero(np.isfinite(t))
    for _ in range(12):
        spot = to_map(origins[left] + t[left, None] * directions[left])
        height, gradient = ground.height_and_gradient(spot[:, :2])
        gap = spot[:, 2] - height
        more = gap / ((gradient * step[left, :2]).sum(axis=1) - step[left, 2])
        close = np.abs(gap) < CLOSE
        point[left[close]] = spot[close] + more[close, None] * step[left[close]]
        t[left] += more
        left = left[~close]
        if not len(left):
            break
    return point


def _march(ground: AnalyticGround, start: FloatArray, step: FloatArray) -> FloatArray:
    """Distance (N,) from `start` along straight lines `step` (per metre) to within `NEAR` above the relief, or NaN."""
    # Half of float64's time: NEAR is far above the rounding of float32, which 1 km resolves to 0.06 mm.
    p, d = (start - ground.datum).astype(np.float32), step.astype(np.float32)
    closing = -d[:, 2] + np.float32(ground.steepest) * np.hypot(d[:, 0], d[:, 1])
    t = np.full(len(p), np.nan, dtype=np.float32)
    active = np.flatnonzero(np.isfinite(p).all(axis=1) & (d[:, 2] < 0))
    u, v, z = (p[active, k] for k in range(3))
    du, dv, dz = (d[active, k] for k in range(3))
    far, closing = np.zeros_like(u), closing[active]
    for _ in range(200):
        gap = z + far * dz - ground.exaggeration * heights(u + far * du, v + far * dv)
        far += gap / closing
        if (done := gap < NEAR).any():
            t[active[done]] = far[done]
            active, u, v, z, du, dv, dz, far, closing = (a[~done] for a in (active, u, v, z, du, dv, dz, far, closing))
        if not len(active):
            break
    return t.astype(np.float64)


def render(
    model: Camera,
    ground: AnalyticGround,
    *,
    texture: Texture = radiance,
    vignetting: Vignetting | None = None,
    exposure: Exposure | None = None,
    noise: float = 0.0,
    seed: int = 0,
    dtype: DTypeLike = np.uint8,
    supersample: int = 1,
) -> AnyArray:
    """Synthetic photo of the ground.

    value = vignetting · gain · texture + offset + noise, for integer types times the largest value of the type,
    rounded and clipped.

    Parameters
    ----------
    model : Camera
        Any sensor model, or the independent `PlainCamera`.
    ground : AnalyticGround
        What is photographed.
    texture : callable
        (ground, xyz (N, 3) in `ground.crs`) → values (N, bands): `radiance`, `coordinates`, or one's own.
    vignetting, exposure : optional
        Camera effects.
    noise : float
        Standard deviation of white Gaussian noise in units of the texture (1/255 is one grey value of uint8).
    seed : int
        Of the noise.
    dtype : dtype
        uint8, uint16, int16, float32 or float64.
    supersample : int
        Values are means of n × n points per pixel.

    Returns
    -------
    array (rows, cols, bands)
        Pixels that see no ground are NaN, 0 for integer types.
    """
    kind: np.dtype[Any] = np.dtype(dtype)
    if supersample < 1:
        raise InputError(
            f"supersample is {supersample}, not a whole number of at least 1", hint="give 1, or more for smoother edges"
        )
    width, height = model.size
    rows_at_once = max(1, CHUNK // (width * supersample**2))

    def strip(first: int) -> AnyArray:
        count = min(rows_at_once, height - first)
        fine = _pixels(first, count, width, supersample)
        values = np.asarray(texture(ground, intersect(model, ground, fine)), dtype=np.float64)
        values = values.reshape(count, supersample, width, supersample, -1).mean(axis=(1, 3))
        if vignetting is not None:
            falloff = vignetting.factor(_pixels(first, count, width, 1), model.size)
            values *= falloff.reshape(count, width, 1)
        if exposure is not None:
            values = values * np.asarray(exposure.gain) + np.asarray(exposure.offset)
        if noise > 0:  # seeded by row, so that the order in which threads work does not matter
            values += np.random.default_rng([seed, first]).normal(0.0, noise, values.shape)
        return _as(values, kind)

    with ThreadPoolExecutor(min(8, os.cpu_count() or 1)) as pool:
        return np.concatenate(list(pool.map(strip, range(0, height, rows_at_once))))


def _pixels(first: int, count: int, width: int, per_side: int) -> FloatArray:
    """Image coordinates (N, 2) of the centres of per_side² parts of each pixel, in `count` rows from `first`."""
    inner = (np.arange(per_side) + 0.5) / per_side
    cols = (np.arange(width)[:, None] + inner).ravel()
    rows = (np.arange(first, first + count)[:, None] + inner).ravel()
    return np.column_stack([np.tile(cols, len(rows)), np.repeat(rows, len(cols))])


def _as(values: FloatArray, kind: np.dtype[Any]) -> AnyArray:
    """Values in a pixel type; those of integers are scaled to its largest value."""
    if kind.kind == "f":
        return values.astype(kind)
    top = np.iinfo(kind).max
    grey: AnyArray = np.nan_to_num(np.clip(np.rint(values * top), 0, top)).astype(kind)
    return grey
