"""Small sensors and surfaces with nothing but the required members, to try the general solvers on."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from affine import Affine
from pyproj import CRS

from geomosaic.geo.crs import geocentric, with_heights
from geomosaic.geo.grid import Bounds
from geomosaic.geo.local_frames import LocalFrame, omega_phi_kappa
from geomosaic.geo.transform import Transform
from geomosaic.sensor.plugin import Parameters
from geomosaic.surface.model import HeightPatch
from geomosaic.types import FloatArray

MAP = with_heights(CRS.from_epsg(32633), "egm96")
PLACE = np.array([512_000.0, 5_404_000.0, 450.0])
ECEF = geocentric(MAP)
FRAME = LocalFrame.at(MAP, PLACE)


@dataclass(frozen=True, eq=False)
class Camera:
    """Collinearity in a local frame; east, north, up of the centre (m), omega, phi, kappa (deg), focal length (px)."""

    values: FloatArray
    size: tuple[int, int] = (4000, 3000)
    sigmas: tuple[float, ...] = (np.inf,) * 6 + (0.0,)
    names: tuple[str, ...] = ("east", "north", "up", "omega", "phi", "kappa", "focal")

    @property
    def crs(self) -> CRS:
        return ECEF

    @property
    def parameters(self) -> Parameters:
        gsd = self.values[2] / self.values[6]
        degrees = np.degrees(1.0 / self.values[6])
        steps = np.array([gsd, gsd, 2.0 * gsd, degrees, degrees, 2.0 * degrees, 2.0])
        units = ("m", "m", "m", "deg", "deg", "deg", "px")
        return Parameters(self.names, units, self.values, np.array(self.sigmas), steps)

    @property
    def seed(self) -> tuple[float, float, float]:
        axis = -self._rotation()[2]
        enu = self.values[:3] + axis * (self.values[2] / -axis[2])
        x, y, z = FRAME.to_geocentric(enu[None])[0]
        return float(x), float(y), float(z)

    def _rotation(self) -> FloatArray:
        omega, phi, kappa = np.radians(self.values[3:6])
        return omega_phi_kappa(omega, phi, kappa)

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        x, y, z = ((FRAME.to_enu(xyz) - self.values[:3]) @ self._rotation().T).T
        z = np.where(z < 0.0, z, np.nan)
        width, height = self.size
        return np.column_stack([width / 2 - self.values[6] * x / z, height / 2 + self.values[6] * y / z])

    def with_values(self, values: FloatArray) -> Self:
        return replace(self, values=np.array(values, dtype=np.float64))

    def to_dict(self) -> dict[str, Any]:
        free = [None if np.isinf(sigma) else sigma for sigma in self.sigmas]
        return {"values": self.values.tolist(), "size": list(self.size), "sigmas": free}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        sigmas = tuple(np.inf if sigma is None else sigma for sigma in state["sigmas"])
        width, height = state["size"]
        return cls(np.array(state["values"]), (width, height), sigmas)


@dataclass(frozen=True, eq=False)
class CameraWithRays(Camera):
    """The same camera, giving its lines of sight too."""

    def rays(self, colrow: FloatArray) -> tuple[FloatArray, FloatArray]:
        width, height = self.size
        sight = np.column_stack(
            [
                (colrow[:, 0] - width / 2) / self.values[6],
                (height / 2 - colrow[:, 1]) / self.values[6],
                -np.ones(len(colrow)),
            ]
        )
        directions = (sight / np.linalg.norm(sight, axis=1)[:, None]) @ self._rotation() @ FRAME.axes
        origin = FRAME.to_geocentric(self.values[None, :3])
        return np.repeat(origin, len(colrow), axis=0), directions


@dataclass(frozen=True, eq=False)
class Scanner(Camera):
    """A line scanner flying north, one row per metre, its rows curved and its attitude drifting.

    The row is the solution of an equation, found by a fixed number of Newton steps: an image function that is implicit
    and not central, like a real push-broom sensor.
    """

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        east, north, up = (FRAME.to_enu(xyz) - self.values[:3]).T
        width, height = self.size
        omega, phi, kappa = np.radians(self.values[3:6])
        down = np.where(up < 0.0, -up, np.nan)
        row = np.zeros_like(down)
        for _ in range(12):  # row / 1000 is the drift of pitch in degrees over the scene
            pitch = omega + np.radians(row / 1000.0 * 0.05)
            row = north - down * np.tan(pitch) + np.sin(kappa) * east
        return np.column_stack([width / 2 + self.values[6] * np.tan(np.arctan2(east, down) - phi), height / 2 - row])

    @property
    def parameters(self) -> Parameters:
        gsd = self.values[2] / self.values[6]
        degrees = np.degrees(1.0 / self.values[6])
        along = np.degrees(1.0 / self.values[2])
        steps = np.array([gsd, 1.0, 2.0 * gsd, along, degrees, along * 2.0, 500.0])
        units = ("m", "m", "m", "deg", "deg", "deg", "px")
        return Parameters(self.names, units, self.values, np.array(self.sigmas), steps)

    @property
    def seed(self) -> tuple[float, float, float]:
        east = self.values[0] + self.values[2] * np.tan(np.radians(self.values[4]))
        north = self.values[1] + self.values[2] * np.tan(np.radians(self.values[3]))
        x, y, z = FRAME.to_geocentric(np.array([[east, north, 0.0]]))[0]
        return float(x), float(y), float(z)


def camera(omega: float = 2.0, phi: float = -3.0, kappa: float = 40.0, up: float = 1500.0, **more: Any) -> Camera:
    return Camera(np.array([20.0, -30.0, up, omega, phi, kappa, 3500.0]), **more)


def scanner() -> Scanner:
    return Scanner(np.array([30.0, -20.0, 500_000.0, 1.0, 12.0, 2.0, 450_000.0]), size=(4000, 3000))


@dataclass(frozen=True)
class Level:
    """Constant height."""

    z: float
    crs: CRS = MAP

    @property
    def range(self) -> tuple[float, float]:
        return self.z, self.z

    def height(self, xy: FloatArray) -> FloatArray:
        return np.full(len(xy), self.z)

    def patch(self, bounds: Bounds, spacing: float = 0.0) -> HeightPatch:
        return HeightPatch(np.full((2, 2), self.z, dtype=np.float32), Affine.identity())


@dataclass(frozen=True)
class Hills:
    """Smooth hills of analytic height; unknown outside a disc."""

    amplitude: float = 120.0
    length: float = 900.0
    radius: float = 1e9
    spread: tuple[float, float] | None = None
    crs: CRS = MAP

    @property
    def range(self) -> tuple[float, float]:
        return self.spread or (PLACE[2] - self.amplitude, PLACE[2] + self.amplitude)

    def height(self, xy: FloatArray) -> FloatArray:
        x, y = (xy - PLACE[:2]).T
        z = PLACE[2] + self.amplitude * np.sin(2 * np.pi * x / self.length) * np.cos(2 * np.pi * y / self.length)
        return np.where(np.hypot(x, y) < self.radius, z, np.nan)

    def patch(self, bounds: Bounds, spacing: float = 0.0) -> HeightPatch:
        left, bottom, _, _ = bounds
        heights = np.full((2, 2), PLACE[2], dtype=np.float32)
        return HeightPatch(heights, Affine(1 / 10.0, 0.0, -left / 10.0, 0.0, -1 / 10.0, bottom / 10.0))


@dataclass(frozen=True)
class Cliff(Hills):
    """A block of height 300 in a plain, walls 1 m wide: a line of sight crosses it more than once."""

    amplitude: float = 150.0

    @property
    def range(self) -> tuple[float, float]:
        return PLACE[2], PLACE[2] + 300.0

    def height(self, xy: FloatArray) -> FloatArray:
        x, y = (xy - PLACE[:2]).T
        z = PLACE[2] + 300.0 * np.clip(200.0 - np.maximum(np.abs(x), np.abs(y)), 0.0, 1.0)
        return np.where(np.hypot(x, y) < self.radius, z, np.nan)

    def patch(self, bounds: Bounds, spacing: float = 0.0) -> HeightPatch:
        left, bottom, _, _ = bounds
        return HeightPatch(np.zeros((2, 2), dtype=np.float32), Affine(1.0, 0.0, -left, 0.0, -1.0, bottom))


def image_of(model: Camera, xyz: FloatArray, crs: CRS = MAP) -> FloatArray:
    return model.ground_to_image(Transform(crs, model.crs)(xyz))


def pixels(model: Camera, count: int = 200, seed: int = 1) -> FloatArray:
    return np.random.default_rng(seed).uniform([0.0, 0.0], model.size, (count, 2))


def control(model: Camera, count: int = 30, relief: float = 200.0, seed: int = 2) -> FloatArray:
    """Ground points in `model.crs`, spread over the image and over height."""
    from geomosaic.sensor.solve import image_to_height

    heights = PLACE[2] + np.random.default_rng(seed).uniform(-relief, relief, count)
    return Transform(MAP, model.crs)(image_to_height(model, pixels(model, count, seed), heights, MAP))
