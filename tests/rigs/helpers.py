"""Small models and readers with closed forms, independent of the code under test."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from affine import Affine
from hypothesis import settings
from pyproj import CRS

from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.geo.grid import Window
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import Parameters
from geomosaic.surface.model import HeightPatch

MAP = parse_crs("EPSG:32633")
GROUND = with_heights(MAP, "ellipsoidal")


def examples(count: int, **more: Any) -> settings:
    """Number of examples of a property: this many, or twenty times as many in a search for new ones."""
    return settings(max_examples=count * (1 if settings.default.derandomize else 20), **more)


def forget_sensors() -> None:
    """Drop what the registry remembers of the installed sensors, which a test changes."""
    for known in ("_points", "plugin", "plane_sensor", "rational_sensor", "photo_sensor", "relative_sensor"):
        getattr(registry, known).cache_clear()


@dataclass(frozen=True)
class PinholeOverMap:
    """A tilted pinhole over a plane map CRS, written as plainly as possible."""

    size: tuple[int, int] = (1000, 800)
    centre: tuple[float, float, float] = (500000.0, 5500000.0, 1000.0)
    focal: float = 1000.0
    tilt: tuple[float, float, float] = (0.05, -0.03, 0.4)
    crs: CRS = GROUND

    @property
    def parameters(self) -> Parameters:
        return Parameters(
            ("x", "y", "z"),
            ("m",) * 3,
            np.array(self.centre),
            np.full(3, np.inf),
            np.full(3, self.centre[2] / self.focal),
        )

    @property
    def seed(self) -> tuple[float, float, float]:
        return (self.centre[0], self.centre[1], 0.0)

    @property
    def rotation(self) -> np.ndarray:
        from scipy.spatial.transform import Rotation

        return Rotation.from_euler("XYZ", self.tilt).as_matrix().T

    def ground_to_image(self, xyz: np.ndarray) -> np.ndarray:
        u, v, w = self.rotation @ (np.asarray(xyz, dtype=float) - np.array(self.centre)).T
        with np.errstate(invalid="ignore", divide="ignore"):
            ahead = w < 0
            col = self.size[0] / 2 + np.where(ahead, -self.focal * u / w, np.nan)
            row = self.size[1] / 2 + np.where(ahead, self.focal * v / w, np.nan)
        return np.column_stack([col, row])

    def with_values(self, values: np.ndarray) -> PinholeOverMap:
        return replace(self, centre=tuple(float(v) for v in values))

    def to_dict(self) -> dict[str, Any]:
        return {"size": list(self.size), "centre": list(self.centre), "focal": self.focal, "tilt": list(self.tilt)}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> PinholeOverMap:
        return cls(tuple(state["size"]), tuple(state["centre"]), state["focal"], tuple(state["tilt"]))


@dataclass(frozen=True)
class Hills:
    """Relief in closed form."""

    crs: CRS = GROUND
    amplitude: float = 60.0
    wavelength: float = 700.0
    spacing: float = 5.0

    @property
    def range(self) -> tuple[float, float]:
        return -self.amplitude, self.amplitude

    def height(self, xy: np.ndarray) -> np.ndarray:
        k = 2 * np.pi / self.wavelength
        return self.amplitude * np.sin(k * (xy[:, 0] - 500000)) * np.cos(k * (xy[:, 1] - 5500000))

    def patch(self, bounds: tuple[float, float, float, float], spacing: float = 0.0) -> HeightPatch:
        s = self.spacing
        left, top = np.floor(bounds[0] / s - 2) * s, np.ceil(bounds[3] / s + 2) * s
        cols, rows = int((bounds[2] - left) / s) + 4, int((top - bounds[1]) / s) + 4
        x, y = np.meshgrid(left + (np.arange(cols) + 0.5) * s, top - (np.arange(rows) + 0.5) * s)
        z = self.height(np.column_stack([x.ravel(), y.ravel()])).reshape(rows, cols).astype(np.float32)
        return HeightPatch(z, ~Affine(s, 0, left, 0, -s, top))


class ArrayReader:
    """An image in memory, read as `raster.source.Source` reads a file."""

    def __init__(self, values: np.ndarray, valid: np.ndarray | None = None) -> None:
        self.values, self.valid = values, valid

    def read(self, window: Window, shrink: int = 1) -> tuple[np.ndarray, np.ndarray | None]:
        rows, cols = slice(window.row, window.stop_row), slice(window.col, window.stop_col)
        values = self.values[rows, cols]
        valid = None if self.valid is None else np.ascontiguousarray(self.valid[rows, cols])
        if shrink == 1:
            return np.ascontiguousarray(values), valid
        weight = np.ones(values.shape[:2]) if valid is None else valid.astype(float)
        h, w = -(-values.shape[0] // shrink), -(-values.shape[1] // shrink)
        total, count = np.zeros((h, w, values.shape[2])), np.zeros((h, w))
        j, i = np.arange(values.shape[0]) // shrink, np.arange(values.shape[1]) // shrink
        np.add.at(count, (j[:, None], i[None, :]), weight)
        np.add.at(total, (j[:, None], i[None, :]), values * weight[..., None])
        seen = count > 0
        total[seen] /= count[seen][:, None]
        return total.astype(np.float32), None if valid is None else seen.astype(np.uint8)
