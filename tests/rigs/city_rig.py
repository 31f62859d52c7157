"""A city of boxes on level ground, photographed by an independent camera: what is seen is known in closed form."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from affine import Affine
from rasterio.errors import NotGeoreferencedWarning

from geomosaic.types import BoolArray, FloatArray

CORNER = np.array([500_000.0, 5_500_000.0])
"""Lower left, UTM 33."""
SIDE, PIXEL = 320.0, 0.5
GROUND_CLASS, WALL_CLASS = 20, 230


@dataclass(frozen=True)
class City:
    """Boxes (N, 5): left, bottom, right, top in metres from the corner, and height."""

    boxes: FloatArray

    @classmethod
    def of(cls, count: int = 40, seed: int = 4) -> City:
        """Boxes at arbitrary places that do not touch."""
        rng, boxes = np.random.default_rng(seed), []
        while len(boxes) < count:
            size, place = rng.uniform(9.0, 26.0, 2), rng.uniform(20.0, SIDE - 50.0, 2)
            box = np.array([*place, *(place + size), rng.uniform(4.0, 28.0)])
            apart = [box[0] > b[2] + 4 or box[2] < b[0] - 4 or box[1] > b[3] + 4 or box[3] < b[1] - 4 for b in boxes]
            if all(apart):
                boxes.append(box)
        return cls(np.array(boxes))

    def roof(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Height and class at places: ground, or 40 + number of the box."""
        z, kind = np.zeros_like(x), np.full(x.shape, float(GROUND_CLASS))
        for number, (left, bottom, right, top, height) in enumerate(self.boxes):
            inside = (x >= left) & (x < right) & (y >= bottom) & (y < top)
            z[inside], kind[inside] = height, 40 + number * 4
        return z, kind

    def blocked(self, origin: FloatArray, point: FloatArray) -> BoolArray:
        """Whether boxes stand between origins and points (N, 3), touching them left out: the slab test."""
        out = np.zeros(len(point), dtype=bool)
        way = origin - point
        steepest = float(np.abs(way[:, :2] / way[:, 2:]).max())
        x, y = np.ascontiguousarray(point[:, 0]), np.ascontiguousarray(point[:, 1])
        for left, bottom, right, top, height in self.boxes:
            low, high = np.array([left, bottom, -1.0]), np.array([right, top, height])
            far = steepest * height
            near = np.flatnonzero((x > left - far) & (x < right + far) & (y > bottom - far) & (y < top + far))
            with np.errstate(divide="ignore", invalid="ignore"):
                a, b = (low - point[near]) / way[near], (high - point[near]) / way[near]
            enter, leave = np.fmax.reduce(np.fmin(a, b), axis=1), np.fmin.reduce(np.fmax(a, b), axis=1)
            out[near] |= (np.minimum(leave, 1.0) - np.maximum(enter, 0.0)) > 1e-9
        return out

    def write_dsm(self, path: Path, pixel: float = PIXEL, margin: float = 40.0, shift: float = 0.0) -> None:
        """Heights at the centres of pixels, which lie `shift` metres off whole ones to the right and upwards."""
        count = int((SIDE + 2 * margin) / pixel)
        c = (np.arange(count) + 0.5) * pixel - margin + shift
        x, y = np.meshgrid(c, c[::-1])
        heights = self.roof(x, y)[0].astype(np.float32)
        corner = CORNER[0] - margin + shift, CORNER[1] + SIDE + margin + shift
        profile = {"driver": "GTiff", "width": count, "height": count, "count": 1, "dtype": "float32"}
        with rasterio.open(
            path, "w", **profile, crs="EPSG:32633", transform=Affine(pixel, 0.0, corner[0], 0.0, -pixel, corner[1])
        ) as dataset:
            dataset.write(heights, 1)


def write_image(path: Path, classes: FloatArray) -> None:
    profile = {"driver": "GTiff", "width": classes.shape[1], "height": classes.shape[0], "count": 1, "dtype": "uint8"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "w", **profile) as dataset:
            dataset.write(classes.astype(np.uint8), 1)


FOCAL, SIZE = 1000.0, (1000, 1000)


def photograph(city: City, centre: FloatArray, path: Path) -> None:
    """A vertical photo, its top to the north, centre (3,) from the corner: of all boxes the first that a ray meets."""
    c, r = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    way = np.stack([(c - SIZE[0] / 2) / FOCAL, (SIZE[1] / 2 - r) / FOCAL, -np.ones_like(c)], axis=-1)
    nearest, kind = np.full(c.shape, centre[2]), np.full(c.shape, float(GROUND_CLASS))
    for number, (left, bottom, right, top, height) in enumerate(city.boxes):
        low, high = np.array([left, bottom, 0.0]) - centre, np.array([right, top, height]) - centre
        cols = [SIZE[0] / 2 - FOCAL * x / z for x in (low[0], high[0]) for z in (low[2], high[2])]
        rows = [SIZE[1] / 2 + FOCAL * y / z for y in (low[1], high[1]) for z in (low[2], high[2])]
        window = tuple(slice(max(0, int(min(v)) - 1), max(0, int(max(v)) + 2)) for v in (rows, cols))
        with np.errstate(divide="ignore", invalid="ignore"):
            a, b = low / way[window], high / way[window]
        near, far = np.minimum(a, b), np.maximum(a, b)
        enter, leave = near.max(axis=-1), far.min(axis=-1)
        hit = (enter < leave) & (enter < nearest[window])
        nearest[window][hit] = enter[hit]
        kind[window][hit] = np.where(near[hit].argmax(axis=1) == 2, 40 + number * 4, WALL_CLASS)
    write_image(path, kind)


def places() -> tuple[FloatArray, FloatArray]:
    """Centres of the output's pixels from the corner, rows from the top."""
    c = (np.arange(int(SIDE / PIXEL)) + 0.5) * PIXEL
    return np.meshgrid(c, c[::-1])
