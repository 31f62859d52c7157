"""Analytic hills about the middle of a radar scene, and what rays and circles cast over them say of it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from affine import Affine
from pyproj import CRS, Transformer
from sar_rig import Scene

# Height and width of hills (metres) and where they stand, from the middle of the scene: layover, shadow, neither.
HILLS = ((1900.0, 560.0, -1200.0, 300.0), (1400.0, 900.0, 1500.0, -900.0), (500.0, 1500.0, 300.0, 2500.0))
BASE = 200.0


@dataclass(frozen=True)
class Facets:
    """Facets of ground: middles, areas as vectors along their normals, positions of the sensor, (col, row)."""

    earth: np.ndarray
    area: np.ndarray
    sensor: np.ndarray
    places: np.ndarray

    @property
    def cosine(self) -> np.ndarray:
        """Of the local incidence angle."""
        line = self.sensor - self.earth
        return np.sum(line * self.area, axis=1) / (np.linalg.norm(line, axis=1) * self.size)

    @property
    def size(self) -> np.ndarray:
        """Square metres."""
        return np.linalg.norm(self.area, axis=1)

    def image(self, sent: np.ndarray, size: tuple[int, int]) -> np.ndarray:
        """Sums of what facets send by the pixels that their middles lie in."""
        edges = np.arange(size[1] + 1.0), np.arange(size[0] + 1.0)
        return np.histogram2d(self.places[:, 1], self.places[:, 0], bins=edges, weights=sent)[0]


@dataclass(frozen=True)
class Land:
    """Hills about the middle of a scene, in metres of a UTM zone over the ellipsoid."""

    scene: Scene
    middle: tuple[float, float]
    zone: int

    @classmethod
    def of(cls, scene: Scene) -> Land:
        lon, lat = scene.middle(BASE)
        zone = 32600 + int((lon + 180) // 6) + 1
        x, y = Transformer.from_crs(4326, zone, always_xy=True).transform(lon, lat)
        return cls(scene, (round(x, -1), round(y, -1)), zone)

    def height(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        out = np.full(np.shape(x), BASE)
        for top, wide, east, north in HILLS:
            out = out + top * np.exp(
                -((x - self.middle[0] - east) ** 2 + (y - self.middle[1] - north) ** 2) / (2 * wide**2)
            )
        return out

    def coarse(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Heights that the DEM has."""
        return self.height(x, y)

    def earth(self, x: np.ndarray, y: np.ndarray, h: np.ndarray) -> np.ndarray:
        return np.stack(self._there.transform(x, y, h), axis=-1)

    def map(self, earth: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return self._there.transform(*np.moveaxis(earth, -1, 0), direction="INVERSE")

    @property
    def _there(self) -> Transformer:
        crs = CRS.from_epsg(self.zone).to_3d()
        return Transformer.from_crs(crs, 4978, always_xy=True)

    def orbit(self, earth: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Exact positions and directions of flight at the zero-Doppler times of points (N, 3).

        The times, nearly linear in the ground, come from a quadratic fitted to exact ones.
        """
        known = earth[:: max(1, len(earth) // 60)]
        exact = np.array([self.scene.orbit.zero_doppler(p, -60.0, 60.0)[0] for p in known])

        def terms(p: np.ndarray) -> np.ndarray:
            u = (p - earth.mean(axis=0)) / 1e4
            pairs = [u[:, i] * u[:, j] for i in range(3) for j in range(i, 3)]
            return np.column_stack([np.ones(len(u)), u, *pairs])

        fit = np.linalg.lstsq(terms(known), exact, rcond=None)[0]
        assert np.abs(terms(known) @ fit - exact).max() < 1e-7
        states = [self.scene.orbit.at(float(t)) for t in terms(earth) @ fit]
        return np.array([p for p, _ in states]), np.array([v / np.linalg.norm(v) for _, v in states])

    def facets(self, half: tuple[float, float], step: float, band: tuple[float, float] | None = None) -> Facets:
        """Ground within some metres of the middle as facets, and where the exact orbit places them in the scene.

        A band is of the y from the middle that count.
        """
        low, high = band or (-half[1], half[1])
        x, y = np.meshgrid(
            self.middle[0] + np.arange(-half[0], half[0], step), self.middle[1] + np.arange(low, high, step)
        )
        earth = self.earth(x, y, self.height(x, y)).reshape(-1, 3)
        d = 0.25 * step
        east = self.earth(x + d, y, self.height(x + d, y)) - self.earth(x - d, y, self.height(x - d, y))
        north = self.earth(x, y + d, self.height(x, y + d)) - self.earth(x, y - d, self.height(x, y - d))
        area = 4.0 * np.cross(east, north).reshape(-1, 3)
        known = earth[np.random.default_rng(0).choice(len(earth), 300)]
        exact = np.array([self.scene.orbit.zero_doppler(p, -60.0, 60.0)[0] for p in known])

        def terms(p: np.ndarray) -> np.ndarray:
            u = (p - earth.mean(axis=0)) / 1e4
            return np.column_stack([np.ones(len(u)), u, *(u[:, i] * u[:, j] for i in range(3) for j in range(i, 3))])

        times = terms(earth) @ np.linalg.lstsq(terms(known), exact, rcond=None)[0]
        base = np.linspace(times.min(), times.max(), 9)
        sensor = np.stack(
            [
                np.polyval(np.polyfit(base, axis, 5), times)
                for axis in np.array([self.scene.orbit.at(t)[0] for t in base]).T
            ],
            axis=1,
        )
        ranges = np.linalg.norm(sensor - earth, axis=1)
        places = np.column_stack(
            [
                (ranges - self.scene.near) / self.scene.spacing + 0.5,
                (times - self.scene.first_row) / self.scene.row_interval + 0.5,
            ]
        )
        return Facets(earth, area, sensor, places)

    def in_shadow(self, earth: np.ndarray, sensor: np.ndarray) -> np.ndarray:
        """Whether the straight line to the sensor runs through the ground."""
        line = sensor - earth
        line /= np.linalg.norm(line, axis=1)[:, None]
        steps = np.arange(12.0, 3600.0, 12.0)
        x, y, h = self.map(earth[:, None] + steps[:, None] * line[:, None])
        return (self.height(x, y) > h + 0.05).any(axis=1)

    def shaded(self, facets: Facets, reach: float, step: float) -> np.ndarray:
        """Whether the straight line to the sensor runs through the ground, on a map without curvature."""
        x, y, h = self.map(facets.earth)
        line = (facets.sensor - facets.earth) / np.linalg.norm(facets.sensor - facets.earth, axis=1)[:, None]
        there = np.array(self.map(facets.earth + 1000.0 * line)) - [x, y, h]
        hidden = np.zeros(len(x), dtype=bool)
        for part in np.arange(0.8 * step, reach, step) / 1000.0:
            left = np.flatnonzero(~hidden)
            at = np.array([x, y, h])[:, left] + part * there[:, left]
            hidden[left] = self.height(at[0], at[1]) > at[2] + 0.02
        return hidden

    def in_layover(self, earth: np.ndarray, sensor: np.ndarray, flight: np.ndarray) -> np.ndarray:
        """Whether the circle of its range meets lit ground elsewhere."""
        line = earth - sensor
        ranges = np.linalg.norm(line, axis=1)[:, None, None]
        ahead = line[:, None] / ranges
        beside = np.cross(flight, line)[:, None] / ranges
        arc = np.arange(-5000.0, 5000.1, 10.0)
        angle = arc[:, None] / ranges
        x, y, h = self.map(sensor[:, None] + ranges * (np.cos(angle) * ahead + np.sin(angle) * beside))
        above = h - self.height(x, y) > 0
        turns = (above[:, 1:] != above[:, :-1]) & (np.abs(arc[1:] - 5.0) > 25.0)
        number, place = np.nonzero(turns)
        other = self.earth(x[number, place], y[number, place], self.height(x[number, place], y[number, place]))
        lit = ~self.in_shadow(other, sensor[number])
        out = np.zeros(len(earth), dtype=bool)
        out[number[lit]] = True
        return out

    def write_dem(self, folder: Path, half: float = 9000.0) -> Path:
        """DEM of nodes every 10 m."""
        x, y = self.middle[0] + np.arange(-half, half + 1.0, 10.0), self.middle[1] + np.arange(half, -half - 1.0, -10.0)
        place = Affine(10.0, 0.0, x[0] - 5.0, 0.0, -10.0, y[0] + 5.0)
        path = folder / "dem.tif"
        with rasterio.open(
            path, "w", driver="GTiff", width=len(x), height=len(y), count=1, dtype="float32",
            crs=f"EPSG:{self.zone}", transform=place,
        ) as file:  # fmt: skip
            file.write(self.coarse(*np.meshgrid(x, y)).astype(np.float32), 1)
        return path
