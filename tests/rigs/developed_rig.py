"""Photos of walls, towers and domes by a pinhole written plainly: rays marched to implicit surfaces.

The photos hold no grey values but the x, y and z of what each pixel shows, so that a developed image can be held
against its own formula to a thousandth of a pixel.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from affine import Affine
from rasterio.errors import NotGeoreferencedWarning

SIZE = (320, 256)
FOCAL = 336.0
CAMERA = """focal_length_px = 336.0
principal_point_px = [160.0, 128.0]
size = [320, 256]
"""


@dataclass(frozen=True)
class Pinhole:
    """A camera at `centre` that looks at `target`, its top towards `up`."""

    centre: np.ndarray
    target: np.ndarray
    up: np.ndarray

    @property
    def matrix(self) -> np.ndarray:
        """Local frame → image, x right, y up, z backwards."""
        back = (self.centre - self.target) / np.linalg.norm(self.centre - self.target)
        right = np.cross(self.up, back)
        right /= np.linalg.norm(right)
        return np.array([right, np.cross(back, right), back])

    def rays(self) -> np.ndarray:
        """Unit directions (N, 3) of all pixel centres, row by row."""
        rows, cols = np.mgrid[0 : SIZE[1], 0 : SIZE[0]]
        x, y = cols.ravel() + 0.5 - SIZE[0] / 2, SIZE[1] / 2 - (rows.ravel() + 0.5)
        rays = np.column_stack([x, y, np.full(x.size, -FOCAL)]) @ self.matrix
        return rays / np.linalg.norm(rays, axis=1)[:, None]

    def project(self, xyz: np.ndarray) -> np.ndarray:
        """Points (N, 3) to (col, row)."""
        x, y, z = self.matrix @ (np.atleast_2d(xyz) - self.centre).T
        return np.column_stack([SIZE[0] / 2 - FOCAL * x / z, SIZE[1] / 2 + FOCAL * y / z])


def first_crossing(
    function: Callable[[np.ndarray], np.ndarray], camera: Pinhole, reach: float, steps: int = 90
) -> np.ndarray:
    """Points (N, 3) where the rays of a camera first cross `function` = 0 downwards; NaN where they do not."""
    rays = camera.rays()
    low, high = np.full(len(rays), np.nan), np.full(len(rays), np.nan)
    before = function(np.tile(camera.centre, (len(rays), 1)))
    for i in range(1, steps + 1):
        here = function(camera.centre + rays * (reach * i / steps))
        new = np.isnan(low) & (before > 0) & (here <= 0)
        low[new], high[new] = reach * (i - 1) / steps, reach * i / steps
        before = here
    for _ in range(45):
        middle = (low + high) / 2
        outside = function(camera.centre + rays * middle[:, None]) > 0
        low, high = np.where(outside, middle, low), np.where(outside, high, middle)
    return camera.centre + rays * low[:, None]


def photograph(path: Path, points: np.ndarray) -> None:
    """Write points (N, 3) of all pixels as three bands, NaN where there is none."""
    bands = points.reshape(SIZE[1], SIZE[0], 3).astype(np.float32)
    profile = {"driver": "GTiff", "width": SIZE[0], "height": SIZE[1], "count": 3, "dtype": "float32"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "w", **profile, nodata=float("nan"), transform=Affine.identity()) as sink:
            sink.write(np.moveaxis(bands, -1, 0))


def exterior(path: Path, cameras: dict[str, Pinhole]) -> None:
    """Write the table of positions and matrices."""
    lines = ["image,x,y,z," + ",".join(f"r{i}{j}" for i in "123" for j in "123")]
    for name, camera in cameras.items():
        numbers = [*camera.centre, *camera.matrix.ravel()]
        lines.append(",".join([name, *(repr(float(v)) for v in numbers)]))
    path.write_text("\n".join(lines) + "\n")
