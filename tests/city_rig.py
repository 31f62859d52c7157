"""A city of boxes on level ground, photographed by an independent camera: what is seen is known in closed form."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from rasterio.errors import NotGeoreferencedWarning
from rasterio.transform import from_origin

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
        for left, bottom, right, top, height in self.boxes:
            low, high = np.array([left, bottom, -1.0]), np.array([right, top, height])
            with np.errstate(divide="ignore", invalid="ignore"):
                a, b = (low - point) / way, (high - point) / way
            enter, leave = np.fmax.reduce(np.fmin(a, b), axis=1), np.fmin.reduce(np.fmax(a, b), axis=1)
            out |= (np.minimum(leave, 1.0) - np.maximum(enter, 0.0)) > 1e-9
        return out

    def seen(self, origin: FloatArray, direction: FloatArray) -> FloatArray:
        """Class that rays (N, 3) meet first; origins are above all boxes."""
        nearest = -origin[:, 2] / direction[:, 2]
        kind = np.full(len(origin), float(GROUND_CLASS))
        for number, (left, bottom, right, top, height) in enumerate(self.boxes):
            low, high = np.array([left, bottom, -1.0]), np.array([right, top, height])
            with np.errstate(divide="ignore", invalid="ignore"):
                a, b = (low - origin) / direction, (high - origin) / direction
            near, far = np.fmin(a, b), np.fmax(a, b)
            enter, leave = np.fmax.reduce(near, axis=1), np.fmin.reduce(far, axis=1)
            hit = (enter < leave) & (enter > 0.0) & (enter < nearest)
            nearest[hit] = enter[hit]
            kind[hit] = np.where(near[hit].argmax(axis=1) == 2, 40 + number * 4, WALL_CLASS)
        return kind

    def write_dsm(self, path: Path, pixel: float = PIXEL, margin: float = 40.0) -> None:
        """Heights at the centres of pixels."""
        count = int((SIDE + 2 * margin) / pixel)
        c = (np.arange(count) + 0.5) * pixel - margin
        x, y = np.meshgrid(c, c[::-1])
        heights = self.roof(x, y)[0].astype(np.float32)
        corner = CORNER[0] - margin, CORNER[1] + SIDE + margin
        profile = {"driver": "GTiff", "width": count, "height": count, "count": 1, "dtype": "float32"}
        with rasterio.open(
            path, "w", **profile, crs="EPSG:32633", transform=from_origin(*corner, pixel, pixel)
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
    """A vertical photo with the top to the north; centre (3,) from the corner."""
    c, r = np.meshgrid(np.arange(SIZE[0]) + 0.5, np.arange(SIZE[1]) + 0.5)
    direction = np.column_stack(
        [(c.ravel() - SIZE[0] / 2) / FOCAL, (SIZE[1] / 2 - r.ravel()) / FOCAL, -np.ones(c.size)]
    )
    kinds = city.seen(np.tile(centre, (c.size, 1)), direction)
    write_image(path, kinds.reshape(SIZE[1], SIZE[0]))


def places() -> tuple[FloatArray, FloatArray]:
    """Centres of the output's pixels from the corner, rows from the top."""
    c = (np.arange(int(SIDE / PIXEL)) + 0.5) * PIXEL
    return np.meshgrid(c, c[::-1])
