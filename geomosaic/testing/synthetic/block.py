"""Independent frame camera, written a second time on purpose, and flight plans for synthetic blocks.

The truth of a rendered photo must not come from the code that is tested with it. This is plain collinearity in NumPy
and pyproj; it shares no line with the sensor plugins, nor with `geomosaic.geo`:

    map (x, y, height) → geographic → Earth-centred → east, north, up at the camera
    R = Rz(−γ)·Rx(ω)·Ry(φ)·Rz(κ), camera → east-north-up, γ the meridian convergence: the angles refer to grid north
    (X, Y, Z) = Rᵀ·(point − camera),  x = −X/Z,  y = Y/Z  (x to the right, y down: OpenCV)
    r² = x² + y²,  d = 1 + k₁r² + k₂r⁴ + k₃r⁶
    x' = x·d + 2p₁xy + p₂(r² + 2x²),  y' = y·d + p₁(r² + 2y²) + 2p₂xy
    col = width/2 + (x₀ + f·x')/pixel,  row = height/2 + (−y₀ + f·y')/pixel, with x₀ right and y₀ up, in mm

(Wolf & Dewitt, Elements of Photogrammetry, app. D, for the rotation; Brown 1971 in OpenCV's notation.)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from pyproj import CRS, Geod, Transformer

import geomosaic.geo.crs as _grids  # noqa: F401  puts the shipped geoid grid on PROJ's path
from geomosaic.testing.synthetic.ground import AnalyticGround
from geomosaic.types import FloatArray


@dataclass(frozen=True)
class PlainCamera:
    """One photo of a frame camera: rays, and the image of ground points.

    Attributes
    ----------
    camera : mapping
        `size` [width, height] px, `focal_length` mm, `sensor_size` [width, height] mm, and optionally
        `principal_point` [right, up] mm from the image centre and `distortion` with k1 k2 k3 p1 p2.
    ground : CRS
        Projected CRS with heights, of `position`.
    position : (float, float, float)
        Projection centre.
    angles : (float, float, float)
        Omega, phi, kappa in degrees, relative to grid north.
    """

    camera: Mapping[str, Any]
    ground: CRS
    position: tuple[float, float, float]
    angles: tuple[float, float, float]

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        width, height = self.camera["size"]
        return int(width), int(height)

    @cached_property
    def crs(self) -> CRS:
        """Geocentric CRS of the rays."""
        return CRS.from_epsg(4978)

    @cached_property
    def _to_earth(self) -> Transformer:
        return Transformer.from_crs(self.ground, self.crs, always_xy=True, allow_ballpark=False)

    @cached_property
    def centre(self) -> FloatArray:
        """Projection centre (3,), geocentric metres."""
        return np.array(self._to_earth.transform(*self.position))

    @cached_property
    def rotation(self) -> FloatArray:
        """Camera (x right, y up, z backwards) to geocentric, (3, 3)."""
        to_place = Transformer.from_crs(self.crs, CRS.from_epsg(4979), always_xy=True, allow_ballpark=False)
        lon, lat = np.radians(np.array(to_place.transform(*self.centre))[:2])
        east = np.array([-np.sin(lon), np.cos(lon), 0.0])
        up = np.array([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
        north = np.cross(up, east)
        # Grid north, found by walking along it: fifty metres to either side, measured on the ellipsoid; the azimuths at
        # the two ends differ by what the meridians converge, so their mean is the azimuth here.
        x, y, z = self.position
        walk = to_place.transform(*self._to_earth.transform([x, x], [y - 50.0, y + 50.0], [z, z]))
        forth, back, _ = Geod(ellps="WGS84").inv(walk[0][0], walk[1][0], walk[0][1], walk[1][1])
        azimuth = np.radians((forth + (back + 360.0) % 360.0 - 180.0) / 2)
        grid_north = np.sin(azimuth) * east + np.cos(azimuth) * north
        grid = np.column_stack([np.cross(grid_north, up), grid_north, up])
        omega, phi, kappa = np.radians(self.angles)
        (co, cp, ck), (so, sp, sk) = np.cos([omega, phi, kappa]), np.sin([omega, phi, kappa])
        rx = np.array([[1, 0, 0], [0, co, -so], [0, so, co]])
        ry = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
        rz = np.array([[ck, -sk, 0], [sk, ck, 0], [0, 0, 1]])
        rotation: FloatArray = grid @ rx @ ry @ rz
        return rotation

    def _interior(self) -> tuple[float, float, float, float]:
        """Focal length in columns and in rows, principal point (col, row); pixels."""
        width, height = self.size
        fc = self.camera["focal_length"] * width / self.camera["sensor_size"][0]
        fr = self.camera["focal_length"] * height / self.camera["sensor_size"][1]
        x0, y0 = self.camera.get("principal_point", (0.0, 0.0))
        c0 = width / 2 + x0 * width / self.camera["sensor_size"][0]
        r0 = height / 2 - y0 * height / self.camera["sensor_size"][1]
        return fc, fr, c0, r0

    def _distort(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        given = self.camera.get("distortion", {})
        k1, k2, k3, p1, p2 = (float(given.get(name, 0.0)) for name in ("k1", "k2", "k3", "p1", "p2"))
        r2 = x * x + y * y
        d = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        return x * d + 2 * p1 * x * y + p2 * (r2 + 2 * x * x), y * d + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y

    def rays(self, colrow: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Image (N, 2) to origins (N, 3) and unit directions (N, 3) towards the ground, geocentric metres."""
        fc, fr, c0, r0 = self._interior()
        pixels = np.asarray(colrow, dtype=np.float64)
        tx, ty = (pixels[:, 0] - c0) / fc, (pixels[:, 1] - r0) / fr
        x, y = tx.copy(), ty.copy()
        for _ in range(60):  # the distortion is a contraction: a fixed point of x = target − shift(x)
            dx, dy = self._distort(x, y)
            ex, ey = tx - dx, ty - dy
            x, y = x + ex, y + ey
            if max(np.abs(ex).max(initial=0.0), np.abs(ey).max(initial=0.0)) < 1e-14:
                break
        local = np.column_stack([x, -y, -np.ones_like(x)])
        directions = local @ self.rotation.T
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        return np.broadcast_to(self.centre, directions.shape), directions

    def project(self, xyz: FloatArray) -> FloatArray:
        """Ground (N, 3) in `ground` to image (N, 2); NaN behind the camera."""
        points = np.asarray(xyz, dtype=np.float64)
        earth = np.column_stack(self._to_earth.transform(points[:, 0], points[:, 1], points[:, 2]))
        return self.ground_to_image(earth)

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        """Geocentric (N, 3) to image (N, 2); NaN behind the camera."""
        local = (np.asarray(xyz, dtype=np.float64) - self.centre) @ self.rotation
        depth = np.where(local[:, 2] < 0, -local[:, 2], np.nan)
        x, y = self._distort(local[:, 0] / depth, -local[:, 1] / depth)
        fc, fr, c0, r0 = self._interior()
        return np.column_stack([c0 + fc * x, r0 + fr * y])


CAMERA: dict[str, Any] = {
    "size": [1200, 900],
    "focal_length": 45.2,
    "sensor_size": [36.0, 27.0],
    "principal_point": [0.18, -0.12],
    "distortion": {"model": "brown", "k1": -0.095, "k2": 0.035, "k3": 0.0, "p1": 0.0006, "p2": -0.0004},
}


@dataclass(frozen=True)
class SyntheticPhoto:
    """Photo of a synthetic block.

    Attributes
    ----------
    name : str
    position : (float, float, float)
        Projection centre in the CRS of the ground, metres.
    angles : (float, float, float)
        Omega, phi, kappa in degrees.
    """

    name: str
    position: tuple[float, float, float]
    angles: tuple[float, float, float]

    def camera(self, camera: Mapping[str, Any], ground: AnalyticGround) -> PlainCamera:
        """Independent camera at this place."""
        return PlainCamera(camera, ground.crs, self.position, self.angles)


@dataclass(frozen=True)
class FlightPlan:
    """Flight plan of a synthetic block: strips that run east and west in turn.

    Attributes
    ----------
    strips, photos : int
        Number of strips, and of photos in each.
    forward_overlap, side_overlap : float
        Shares of the image's width and height, 0..1, on flat ground at the base height.
    gsd : float
        Pixel size on the ground at the base height, metres; it sets the flying height.
    tilt, drift : float
        Standard deviations of omega and phi, and of kappa about the strip's direction, degrees; nothing is beyond
        twice as much.
    shake : float
        Standard deviation of the position in metres, about the plan.
    """

    strips: int
    photos: int
    forward_overlap: float = 0.6
    side_overlap: float = 0.35
    gsd: float = 0.7
    tilt: float = 2.0
    drift: float = 4.0
    shake: float = 12.0


def synthetic_block(
    ground: AnalyticGround, camera: Mapping[str, Any], plan: FlightPlan, seed: int = 0
) -> list[SyntheticPhoto]:
    """Photos of a flight about the ground's origin.

    Parameters
    ----------
    ground : AnalyticGround
    camera : mapping
        As `PlainCamera` has it.
    plan : FlightPlan
    seed : int
        Of tilts, drifts and positions.

    Returns
    -------
    list of SyntheticPhoto
        In flight order; positions are rounded to mm and angles to 1e-5 degrees, so tables carry them in full.
    """
    width, height = camera["size"]
    above = plan.gsd * camera["focal_length"] * width / camera["sensor_size"][0]
    base, spacing = plan.gsd * width * (1 - plan.forward_overlap), plan.gsd * height * (1 - plan.side_overlap)
    random = np.random.default_rng(seed)
    block = []
    for strip in range(plan.strips):
        westward = bool(strip % 2)
        for k in range(plan.photos):
            off = np.clip(random.normal(size=6), -2, 2)
            along = (k - (plan.photos - 1) / 2) * base * (-1 if westward else 1)
            across = ((plan.strips - 1) / 2 - strip) * spacing
            position = np.array([ground.origin[0] + along, ground.origin[1] + across, ground.base + above])
            x, y, z = np.round(position + plan.shake * off[:3], 3).tolist()
            kappa = plan.drift * off[5] + (180.0 if westward else 0.0)
            omega, phi, kappa = np.round(
                [plan.tilt * off[3], plan.tilt * off[4], (kappa + 180) % 360 - 180], 5
            ).tolist()
            block.append(SyntheticPhoto(f"strip{strip + 1}_{k + 1:02d}", (x, y, z), (omega, phi, kappa)))
    return block
