"""Orthos with known truth: six photos of a town, rectified on the bare ground, so that houses lean; gains and offsets.

python -m benchmarks.town FOLDER [--small]

Makes `ortho*.tif` (georeferenced, uint8 RGB), `canvas*.tif` (on one canvas with alpha, for tools that know no map;
without gains and offsets, as such tools balance nothing), `truth.tif` (the ground's radiance, 0 to 255, no houses) and
`town.json` (sizes, houses, gains, offsets).
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import rasterio
from rasterio.transform import from_origin
from rasterio.windows import Window

from benchmarks.scene import CENTRE, CRS
from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.testing.synthetic import AnalyticGround

Floats = npt.NDArray[np.float64]
PIXEL, FORMAT, NOISE = 0.2, "4", 1.5
HIGH = 1.15
"""Height of flight in widths of an ortho."""


@dataclass(frozen=True)
class Plan:
    """Columns and rows of orthos, their size, the steps between them, in pixels, and the number of houses."""

    across: int
    down: int
    size: tuple[int, int]
    step: tuple[int, int]
    houses: int

    @property
    def canvas(self) -> tuple[int, int]:
        """Width and height of the whole."""
        return self.size[0] + (self.across - 1) * self.step[0], self.size[1] + (self.down - 1) * self.step[1]

    def corners(self) -> list[tuple[int, int]]:
        """Left and upper pixel of each ortho on the canvas."""
        return [(c * self.step[0], r * self.step[1]) for r in range(self.down) for c in range(self.across)]

    def above(self, corner: tuple[int, int]) -> Floats:
        """Place (col, row, height) of the camera over an ortho, in pixels of the canvas."""
        width, height = self.size
        return np.array([corner[0] + width / 2, corner[1] + height / 2, HIGH * width])


def plan(small: bool) -> Plan:
    """What is made."""
    return Plan(3, 2, (700, 520), (400, 300), 30) if small else Plan(3, 2, (1300, 1000), (750, 580), 70)


def town(p: Plan) -> Floats:
    """Houses (N, 5): left, upper, right, lower and height in pixels of the canvas; none touch."""
    random, houses = np.random.default_rng(11), []
    width, height = p.canvas
    while len(houses) < p.houses:
        size, at = random.uniform(40, 110, 2), random.uniform(30, [width - 140, height - 140])
        one = np.array([*at, *(at + size), random.uniform(25, 90)])
        if all(one[0] > h[2] + 25 or one[2] < h[0] - 25 or one[1] > h[3] + 25 or one[3] < h[1] - 25 for h in houses):
            houses.append(one)
    return np.array(houses)


def leaning(house: Floats, camera: Floats) -> Floats:
    """Left, upper, right, lower of what a house covers in an ortho on the bare ground."""
    out = house[4] / (camera[2] - house[4])
    low = np.minimum(house[:2], house[:2] + out * (house[:2] - camera[:2]))
    high = np.maximum(house[2:4], house[2:4] + out * (house[2:4] - camera[:2]))
    return np.concatenate([low, high])


def paint(ground: npt.NDArray[np.float32], houses: Floats, camera: Floats, left: int, top: int) -> None:
    """Draw the houses that a camera sees into an ortho of the ground (rows, cols, 3): the first that a ray meets."""
    rows, cols, _ = ground.shape
    nearest = np.ones((rows, cols))
    for number, house in enumerate(houses):
        box = leaning(house, camera) - [left, top, left, top]
        c0, r0 = np.maximum(np.floor(box[:2]).astype(int), 0)
        c1, r1 = np.minimum(np.ceil(box[2:]).astype(int) + 1, [cols, rows])
        if c0 >= c1 or r0 >= r1:
            continue
        x, y = np.meshgrid(np.arange(c0, c1) + left + 0.5, np.arange(r0, r1) + top + 0.5)
        way = np.stack([x - camera[0], y - camera[1], np.full(x.shape, -camera[2])], axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            a = (np.array([house[0], house[1], 0.0]) - camera) / way
            b = (np.array([house[2], house[3], house[4]]) - camera) / way
        near = np.minimum(a, b)
        enter, leave = near.max(axis=-1), np.maximum(a, b).min(axis=-1)
        window = np.s_[r0:r1, c0:c1]
        hit = (enter < leave) & (enter < nearest[window])
        roof = near.argmax(axis=-1) == 2
        at = camera[:2] + enter[..., None] * way[..., :2]
        lines = 14 * (np.sin((at[..., 0] + 2 * at[..., 1]) / 2.2) > 0)
        tone = np.array([[168, 92, 74], [122, 122, 128], [176, 168, 152]][number % 3], dtype=np.float64)
        wall = np.where(near.argmax(axis=-1) == 0, 70.0, 48.0)
        colour = np.where(roof[..., None], tone + lines[..., None], wall[..., None])
        ground[window][hit] = colour[hit]
        nearest[window][hit] = enter[hit]


def radiance(p: Plan, ground: npt.NDArray[np.float32], houses: Floats, corner: tuple[int, int]) -> Any:
    """What an ortho would show without gain, offset and noise (rows, cols, 3)."""
    left, top = corner
    seen = ground[top : top + p.size[1], left : left + p.size[0]].copy()
    paint(seen, houses, p.above(corner), left, top)
    return seen


def ground_of(p: Plan) -> npt.NDArray[np.float32]:
    """Radiance of the ground on the canvas, 0 to 255 (rows, cols, 3)."""
    width, height = p.canvas
    land = AnalyticGround(with_heights(parse_crs(CRS), "ellipsoidal"), CENTRE, wavelength=4 * PIXEL)
    out = np.empty((height, width, 3), dtype=np.float32)
    x = CENTRE[0] + (np.arange(width) + 0.5 - width / 2) * PIXEL
    for row in range(height):
        y = np.full(width, CENTRE[1] + (height / 2 - row - 0.5) * PIXEL)
        out[row] = 25 + 185 * land.texture(np.column_stack([x, y]))
    return out


def place(p: Plan, col: int = 0, row: int = 0) -> Any:
    """Transform of a part of the canvas."""
    width, height = p.canvas
    return from_origin(CENTRE[0] + (col - width / 2) * PIXEL, CENTRE[1] + (height / 2 - row) * PIXEL, PIXEL, PIXEL)


def make(folder: Path, small: bool) -> None:
    """Make what is not there yet."""
    folder.mkdir(parents=True, exist_ok=True)
    whole = folder / "made"
    if whole.exists() and whole.read_text() == FORMAT:
        return
    p, random = plan(small), np.random.default_rng(5)
    houses, ground = town(p), ground_of(p)
    tiled = {"driver": "GTiff", "tiled": True, "blockxsize": 512, "blockysize": 512, "interleave": "pixel"}
    width, height = p.canvas
    size = {"width": width, "height": height}
    with rasterio.open(
        folder / "truth.tif", "w", **tiled, **size, count=3, dtype="float32", crs=CRS, transform=place(p)
    ) as file:
        file.write(ground.transpose(2, 0, 1))
    looks = []
    for number, (left, top) in enumerate(p.corners()):
        gain = np.exp(random.normal(0, 0.10) + random.normal(0, 0.03, 3))
        offset = random.uniform(-8, 8, 3)
        looks.append({"gain": gain.tolist(), "offset": offset.tolist()})
        seen = radiance(p, ground, houses, (left, top))
        noise = random.normal(0, NOISE, seen.shape)
        grey, even = (
            np.clip(np.rint(v), 1, 255).astype(np.uint8).transpose(2, 0, 1)
            for v in (gain * seen + offset + noise, seen + noise)
        )
        shape = {"width": p.size[0], "height": p.size[1], "count": 3, "dtype": "uint8", "photometric": "RGB"}
        path = folder / f"ortho{number}.tif"
        with rasterio.open(path, "w", **tiled, **shape, crs=CRS, transform=place(p, left, top), nodata=0) as file:
            file.write(grey)
        alike = {"driver": "GTiff", "compress": "LZW", "photometric": "RGB", "alpha": "YES", "interleave": "pixel"}
        with rasterio.open(folder / f"canvas{number}.tif", "w", **alike, **size, count=4, dtype="uint8") as file:
            window = Window(left, top, *p.size)
            file.write(np.concatenate([even, np.full((1, *even.shape[1:]), 255, dtype=np.uint8)]), window=window)
    (folder / "town.json").write_text(
        json.dumps({"canvas": p.canvas, "size": p.size, "houses": houses.tolist(), "looks": looks})
    )
    whole.write_text(FORMAT)


if __name__ == "__main__":
    make(Path(sys.argv[1]), "--small" in sys.argv)
