"""Photos of one land on two dates: vegetation recoloured, contrast reversed in places, snow, shadows and clouds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scenery import PhotoRadiometry, Scenery, photograph
from scenery_rig import GROUND
from scipy.ndimage import gaussian_filter, map_coordinates

from geomosaic.testing.synthetic import AnalyticGround, SyntheticPhoto, intersect

# Metres between nodes of the fields that say where a date changes what; nodes along a side, of a period of 2 km.
STEP, SIDE = 8.0, 256
# Metres of clouds above the land, and of their way from photo to photo: a light wind in three seconds.
ABOVE, DRIFT = 150.0, np.array([9.0, 4.0])


@dataclass(frozen=True)
class Date:
    """What a date makes of the land: shares of it where contrast is reversed, snow lies, shadows fall, clouds hang."""

    seed: int = 0
    recoloured: float = 0.0
    reversed: float = 0.0
    snow: float = 0.0
    shadows: float = 0.0
    clouds: float = 0.0


def _field(places: np.ndarray, seed: int, width: float) -> np.ndarray:
    """Quantile (rows, cols), 0..1, of a random field at places (rows, cols, 2) in metres from the origin."""
    noise = gaussian_filter(np.random.default_rng(seed).normal(size=(SIDE, SIDE)), width / STEP, mode="wrap")
    ranks = np.empty(noise.size)
    ranks[np.argsort(noise.ravel())] = np.linspace(0.0, 1.0, noise.size)
    at = places[..., ::-1].transpose(2, 0, 1) / STEP
    return map_coordinates(ranks.reshape(noise.shape), at, order=1, mode="grid-wrap")


def clouds_of(photo: SyntheticPhoto, number: int, date: Date, camera: dict[str, Any]) -> np.ndarray:
    """Where clouds are in a photo (rows, cols)."""
    # So seeded that every photo of the tests shows some: 5 to 44 %, 21 % in the mean of the larger block.
    return _field(4.0 * (_seen(photo, camera, ABOVE) - number * DRIFT), 57 + date.seed, 32.0) < date.clouds


def _seen(photo: SyntheticPhoto, camera: dict[str, Any], above: float = 0.0) -> np.ndarray:
    """Places (rows, cols, 2) that the pixels show, metres from the origin; of clouds on a level plane."""
    wide, high = camera["size"]
    # Lines of sight of every fifteenth pixel: the fields are metres wide.
    col, row = np.meshgrid(np.arange(0.0, wide + 45.0, 15.0) - 15.0, np.arange(0.0, high + 45.0, 15.0) - 15.0)
    ground = GROUND if not above else AnalyticGround(GROUND.crs, GROUND.origin, GROUND.base + above, 0.0)
    met = intersect(photo.camera(camera, GROUND), ground, np.column_stack([col.ravel(), row.ravel()]))
    nodes = (met[:, :2] - GROUND.origin).reshape(*col.shape, 2)
    at = np.meshgrid((np.arange(high) + 15.5) / 15.0, (np.arange(wide) + 15.5) / 15.0, indexing="ij")
    return np.stack([map_coordinates(nodes[..., axis], at, order=3) for axis in (0, 1)], axis=-1)


def picture_on(photo: SyntheticPhoto, number: int, date: Date, camera: dict[str, Any], scenery: Scenery) -> np.ndarray:
    """Photo (rows, cols, 3) of a date, the number of which in its flight says how far clouds have gone."""
    values = (
        photograph(photo.camera(camera, GROUND), GROUND, scenery, PhotoRadiometry(noise=0.0)).astype(np.float64) / 255.0
    )
    place, seed = _seen(photo, camera), 10 * date.seed
    if date.recoloured:
        green = _field(place, seed + 1, 30.0)[..., None]
        values = values * (1.0 + date.recoloured * (green - 0.5) * np.array([1.0, -1.2, 0.6]))
    if date.reversed:
        mean = cv2.GaussianBlur(values, (0, 0), 12.0)
        turned = _field(place, seed + 2, 30.0)[..., None] < date.reversed
        values = np.where(turned, mean - 0.8 * (values - mean), values)
    if date.snow:
        own = 0.85 + 0.05 * (_field(place, seed + 4, 10.0)[..., None] - 0.5)
        values = np.where(_field(place, seed + 3, 20.0)[..., None] < date.snow, own, values)
    if date.shadows:
        values = np.where(_field(place, seed + 5, 10.0)[..., None] < date.shadows, 0.45 * values, values)
    if date.clouds:
        # Their own texture, a metre wide: what matching finds, and moves with the wind.
        own = 0.55 + 0.4 * _field(8.0 * (_seen(photo, camera, ABOVE) - number * DRIFT), seed + 6, 8.0)[..., None]
        values = np.where(clouds_of(photo, number, date, camera)[..., None], own, values)
    values += np.random.default_rng([seed, number]).normal(0.0, 0.012, values.shape)
    return np.clip(np.rint(255.0 * values), 0.0, 255.0).astype(np.uint8)


def write_dates(
    folder: Path, flights: Sequence[tuple[Sequence[SyntheticPhoto], Date]], camera: dict[str, Any], scenery: Scenery
) -> None:
    """JPEG files of the photos of each flight on its date."""
    for photos, date in flights:
        for number, photo in enumerate(photos):
            values = picture_on(photo, number, date, camera, scenery)
            cv2.imwrite(str(folder / f"{photo.name}.jpg"), values[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 92])
