"""Radar scenes of an analytic orbit: a Kepler ellipse over the turning Earth, and zero-Doppler times by bisection.

Nothing here is of the plug-in: positions, velocities and image coordinates are computed by formulas of their own.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import brentq

GM = 3.986004418e14  # m³/s², WGS 84
EARTH_RATE = 7.292115e-5  # rad/s
A, F = 6378137.0, 1 / 298.257223563


def geocentric(lon: np.ndarray, lat: np.ndarray, height: np.ndarray) -> np.ndarray:
    lon, lat = np.radians(lon), np.radians(lat)
    e2 = F * (2 - F)
    n = A / np.sqrt(1 - e2 * np.sin(lat) ** 2)
    return np.stack(
        [
            (n + height) * np.cos(lat) * np.cos(lon),
            (n + height) * np.cos(lat) * np.sin(lon),
            (n * (1 - e2) + height) * np.sin(lat),
        ],
        axis=-1,
    )


@dataclass(frozen=True)
class Ellipse:
    """Kepler ellipse: position and velocity in the Earth-fixed frame at any time, exactly."""

    semi_major: float = 7_071_000.0
    eccentricity: float = 0.0012
    inclination: float = 98.18
    perigee: float = 70.0
    node: float = 8.0
    start: float = 1.2  # mean anomaly at time 0, radians

    def at(self, t: float) -> tuple[np.ndarray, np.ndarray]:
        e, a = self.eccentricity, self.semi_major
        rate = np.sqrt(GM / a**3)
        mean = self.start + rate * t
        anomaly = mean
        for _ in range(20):
            anomaly -= (anomaly - e * np.sin(anomaly) - mean) / (1 - e * np.cos(anomaly))
        b = a * np.sqrt(1 - e * e)
        plane = np.array([a * (np.cos(anomaly) - e), b * np.sin(anomaly), 0.0])
        speed = rate / (1 - e * np.cos(anomaly))
        rates = np.array([-a * np.sin(anomaly), b * np.cos(anomaly), 0.0]) * speed
        w, i, o = np.radians([self.perigee, self.inclination, self.node])
        turn = _about_z(o) @ _about_x(i) @ _about_z(w)
        back = _about_z(-EARTH_RATE * t)
        p = back @ turn @ plane
        return p, back @ turn @ rates - np.cross([0.0, 0.0, EARTH_RATE], p)

    def zero_doppler(self, point: np.ndarray, low: float, high: float) -> tuple[float, float]:
        """Time at which the range to a point no longer changes, and the range."""

        def along(t: float) -> float:
            p, v = self.at(t)
            return float((point - p) @ v)

        t = brentq(along, low, high, xtol=1e-14, rtol=1e-15)
        return t, float(np.linalg.norm(point - self.at(t)[0]))


def _about_z(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])


def _about_x(angle: float) -> np.ndarray:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1, 0, 0], [0, c, -s], [0, s, c]])


@dataclass(frozen=True)
class Scene:
    """A scene of an analytic orbit: pixels of any ground point by formula."""

    orbit: Ellipse = Ellipse()
    size: tuple[int, int] = (800, 1000)
    side: int = 1
    first_row: float = -0.75
    row_interval: float = 0.0015
    near: float = 850_000.0
    spacing: float = 5.0

    def image(self, xyz: np.ndarray) -> np.ndarray:
        """Exact (col, row) of geocentric points (N, 3)."""
        found = np.array([self.orbit.zero_doppler(p, -60.0, 60.0) for p in xyz])
        return np.column_stack(
            [(found[:, 1] - self.near) / self.spacing + 0.5, (found[:, 0] - self.first_row) / self.row_interval + 0.5]
        )

    def middle(self, height: float = 0.0) -> tuple[float, float]:
        """Longitude and latitude of the middle of the scene at a height, by bisection along the great circle."""
        t = self.first_row + 0.5 * self.size[1] * self.row_interval
        r = self.near + 0.5 * self.size[0] * self.spacing
        p, v = self.orbit.at(t)
        up, across = p / np.linalg.norm(p), np.cross(v, p) * self.side
        across -= v * (across @ v) / (v @ v)
        across /= np.linalg.norm(across)
        # Downward direction of the zero-Doppler plane.
        down = -(up - v * (up @ v) / (v @ v))
        down /= np.linalg.norm(down)

        def above(look: float) -> float:
            q = p + r * (np.cos(look) * down + np.sin(look) * across)
            return float(lonlat(q)[2] - height)

        look = brentq(above, 0.05, 1.2, xtol=1e-14)
        lon, lat, _ = lonlat(p + r * (np.cos(look) * down + np.sin(look) * across))
        return lon, lat

    def states(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        both = [self.orbit.at(float(t)) for t in times]
        return np.array([p for p, _ in both]), np.array([v for _, v in both])

    def table(self, times: np.ndarray | None = None, *, velocities: bool = True) -> dict[str, Any]:
        """The scene as the neutral JSON table, slant range."""
        t = np.arange(-40.0, 41.0, 10.0) if times is None else times
        p, v = self.states(t)
        orbit = {"times": t.tolist(), "positions": p.tolist()}
        if velocities:
            orbit["velocities"] = v.tolist()
        return {
            "title": "analytic orbit",
            "size": list(self.size),
            "looking": "right" if self.side > 0 else "left",
            "first_row_time": self.first_row,
            "row_interval": self.row_interval,
            "slant_range": {"near": self.near, "spacing": self.spacing},
            "orbit": orbit,
        }

    def ground_table(self, order: int = 8) -> tuple[dict[str, Any], float]:
        """The scene with columns over ground range: the table, and the metres per column.

        Ground ranges are lengths on a sphere, fitted by polynomials at three times.
        """
        far = self.near + self.size[0] * self.spacing
        ranges = np.linspace(self.near - 500.0, far + 500.0, 60)
        records, spacing = [], 0.0
        for t in (self.first_row - 0.5, self.first_row + 0.7, self.first_row + 2.0):
            ground = self.ground_range(ranges, t) - self.ground_range(np.array([self.near]), self.first_row)
            fit = np.polynomial.Polynomial.fit(ranges - self.near, ground, order).convert()
            records.append({"time": t, "origin": self.near, "coefficients": fit.coef.tolist()})
            spacing = spacing or float(ground[-1] - ground[0]) / self.size[0]
        table = self.table()
        del table["slant_range"]
        table["ground_range"] = {"first": 0.0, "spacing": spacing, "polynomials": records}
        return table, spacing

    def ground_range(self, ranges: np.ndarray, t: float) -> np.ndarray:
        """Length on a sphere of 6371 km from the point below the sensor."""
        distance, radius = np.linalg.norm(self.orbit.at(t)[0]), 6_371_000.0
        cosine = (distance**2 + radius**2 - ranges**2) / (2 * distance * radius)
        return radius * np.arccos(cosine)

    def write(self, folder: Path, name: str = "scene", table: dict[str, Any] | None = None) -> Path:
        path = folder / f"{name}.radar.json"
        path.write_text(json.dumps(table or self.table()))
        return path

    def left(self) -> Scene:
        return replace(self, side=-1)


def lonlat(xyz: np.ndarray) -> tuple[float, float, float]:
    """Longitude, latitude (degrees), ellipsoidal height of a geocentric point, by fixed-point iteration."""
    x, y, z = (float(v) for v in xyz)
    e2, p = F * (2 - F), float(np.hypot(x, y))
    lat = np.arctan2(z, p * (1 - e2))
    for _ in range(12):
        n = A / np.sqrt(1 - e2 * np.sin(lat) ** 2)
        lat = np.arctan2(z + e2 * n * np.sin(lat), p)
    n = A / np.sqrt(1 - e2 * np.sin(lat) ** 2)
    height = p * np.cos(lat) + z * np.sin(lat) - n * (1 - e2 * np.sin(lat) ** 2)
    return float(np.degrees(np.arctan2(y, x))), float(np.degrees(lat)), float(height)
