"""What is photographed and from where: plain numbers, so that the process that takes times imports nothing large."""

from __future__ import annotations

import random
from dataclasses import dataclass

CRS = "EPSG:32631"
CENTRE = (620_000.0, 5_500_000.0)
"""Off the central meridian, so that grid north is not true north."""

BASE, SWING, RIPPLE = 450.0, 410.0, 40.0
"""Heights of the relief in metres: middle, amplitude of the hills, amplitude of what lies on them."""

DEM_SIZE, DEM_SPACING = 2000, 5.0
RESOLUTION = 0.3
SATELLITE_PIXEL = 0.5
PLACE = (4.66209, 49.64061)
"""Longitude and latitude near `CENTRE`."""


@dataclass(frozen=True)
class Camera:
    """A frame camera in pixels; (0, 0) is the outer corner of the upper-left pixel, distortion as OpenCV writes it."""

    size: tuple[int, int]
    focal: float
    principal_point: tuple[float, float]
    brown: dict[str, float]


@dataclass(frozen=True)
class Satellite:
    """A scene of a satellite: rational polynomials of (longitude, latitude, height), first pixel's centre at 0.

    `scales` are those of col, row, longitude, latitude and height, about the image's middle, `place` and `BASE`;
    `terms` the coefficients of col's and row's numerators and of their denominator, by their numbers in RPC00B.
    """

    size: tuple[int, int]
    scales: tuple[float, float, float, float, float]
    place: tuple[float, float]
    terms: tuple[dict[int, float], dict[int, float], dict[int, float]]

    @property
    def middle(self) -> tuple[float, float]:
        """Offsets of col and row."""
        return (self.size[0] - 1) / 2, (self.size[1] - 1) / 2

    def tags(self) -> dict[str, str]:
        """As GDAL's metadata domain `RPC` has them."""
        names = ("SAMP", "LINE", "LONG", "LAT", "HEIGHT")
        offsets = (*self.middle, *self.place, BASE)
        out = {f"{name}_OFF": repr(value) for name, value in zip(names, offsets, strict=True)}
        out |= {f"{name}_SCALE": repr(value) for name, value in zip(names, self.scales, strict=True)}
        col, row, below = (" ".join(repr(part.get(k, 0.0)) for k in range(20)) for part in self.terms)
        return out | {
            "SAMP_NUM_COEFF": col, "LINE_NUM_COEFF": row, "SAMP_DEN_COEFF": below, "LINE_DEN_COEFF": below
        }  # fmt: skip


@dataclass(frozen=True)
class Shot:
    """A photo: projection centre in the map (heights ellipsoidal), omega, phi, kappa in degrees, gain and offset."""

    name: str
    position: tuple[float, float, float]
    angles: tuple[float, float, float]
    gain: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Scene:
    """Photos of one camera."""

    name: str
    camera: Camera
    shots: tuple[Shot, ...]


def _camera(width: int, height: int, focal: float) -> Camera:
    brown = {"k1": -0.05, "k2": 0.02, "k3": -0.004, "p1": 3e-4, "p2": -2e-4}
    return Camera((width, height), focal, (width / 2 + 3.2, height / 2 - 5.4), brown)


def single(size: int, name: str = "single") -> Scene:
    """One square photo, tilted and turned, about 0.3 m on the ground."""
    focal = 12_000.0
    shot = Shot("photo.tif", (CENTRE[0] + 150, CENTRE[1] - 90, BASE + focal * RESOLUTION), (2.5, -3.0, 25.0))
    return Scene(name, _camera(size, size, focal), (shot,))


def strips(width: int, height: int, rows: int = 3, each: int = 4) -> Scene:
    """Three strips of four, 60 % and 35 % overlap, with tilts and differences in exposure."""
    focal = 1.2 * width
    chance = random.Random(7)
    shots = []
    for row in range(rows):
        for col in range(each):
            x = CENTRE[0] + (col - (each - 1) / 2) * 0.4 * width * RESOLUTION + chance.uniform(-9, 9)
            y = CENTRE[1] - (row - (rows - 1) / 2) * 0.65 * height * RESOLUTION + chance.uniform(-9, 9)
            z = BASE + focal * RESOLUTION + chance.uniform(-15, 15)
            angles = (chance.gauss(0, 1.5), chance.gauss(0, 1.5), chance.gauss(0, 2.0) + 180.0 * (row % 2))
            look = chance.gauss(1.0, 0.08), chance.gauss(0.0, 5.0)
            shots.append(Shot(f"photo{row + 1}{col + 1}.tif", (x, y, z), angles, *look))
    return Scene("strips", _camera(width, height, focal), tuple(shots))


def satellite(small: bool) -> Satellite:
    """A square scene of 0.5 m, turned by 12 degrees, 20 degrees off nadir, with terms of all orders in it."""
    size = 2400 if small else 12_000
    half, cos, sin, lean = size / 2, 0.978, 0.208, 0.364
    # Half a side on the ground, in degrees at 49.6 degrees north; heights in units of 500 m.
    scales = (half, half, half * SATELLITE_PIXEL / 72_250.0, half * SATELLITE_PIXEL / 111_230.0, 500.0)
    high = lean * 500.0 / SATELLITE_PIXEL / half
    col = {1: cos, 2: sin, 3: 0.8 * high, 4: 6e-4, 7: -4e-4, 9: 2e-5, 11: 8e-5, 14: -5e-5}
    row = {1: sin, 2: -cos, 3: 0.6 * high, 4: -5e-4, 8: 3e-4, 10: 4e-5, 15: 6e-5, 17: 3e-5}
    return Satellite((size, size), scales, PLACE, (col, row, {0: 1.0, 1: 3e-4, 2: -2e-4, 3: 5e-5, 4: 2e-6}))


def scenes(small: bool) -> dict[str, Scene]:
    """All photos of a run."""
    return {
        "single": single(2500 if small else 10_000),
        "strips": strips(1500, 1000) if small else strips(6000, 4000),
        "tiny": single(800, "tiny"),
    }


def tiny_bounds(pixels: int = 512) -> tuple[float, float, float, float]:
    """Left, bottom, right, top of an output of that many pixels, within the tiny photo."""
    # Where the tilted axis meets the ground, to whole metres.
    middle, half = (CENTRE[0] + 328.0, CENTRE[1] + 55.0), pixels * RESOLUTION / 2
    return middle[0] - half, middle[1] - half, middle[0] + half, middle[1] + half
