"""Blocks of the scenery as files, what matching makes of them, and how far that is from the truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scenery import PhotoRadiometry, Scenery, photograph, tie_errors, water

import geomosaic as gm
from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.geo.engineering_crs import local_frame_crs
from geomosaic.testing.synthetic import CAMERA, AnalyticGround, SyntheticPhoto, intersect

GROUND = AnalyticGround(with_heights(parse_crs("EPSG:32633"), "egm96"), origin=(400_000.0, 5_500_000.0))


@dataclass(frozen=True)
class Truth:
    """How far the rays of tie points are from where they should be, pixels; how many of them show water."""

    errors: np.ndarray
    on_water: int

    def share_beyond(self, pixels: float) -> float:
        """Share of errors that are larger."""
        return float((self.errors > pixels).mean())

    @property
    def rms(self) -> float:
        """Root mean square, pixels."""
        return float(np.sqrt((self.errors**2).mean()))


def camera_of(size: tuple[int, int]) -> dict[str, Any]:
    """The kit's camera with a sensor of other pixels."""
    return {**CAMERA, "size": list(size)}


def write_photos(folder: Path, photos: Sequence[SyntheticPhoto], camera: dict[str, Any], scenery: Scenery) -> None:
    """JPEG files of photos, as far as they are not there; exposures differ by up to half."""
    folder.mkdir(parents=True, exist_ok=True)
    for number, photo in enumerate(photos):
        path = folder / f"{photo.name}.jpg"
        if not path.exists():
            chance = np.random.default_rng(number)
            look = PhotoRadiometry(chance.uniform(0.75, 1.25), chance.uniform(-0.05, 0.05), 0.012, number)
            picture = photograph(photo.camera(camera, GROUND), GROUND, scenery, look)
            cv2.imwrite(str(path), picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, 92])


def block_of(folder: Path, photos: Sequence[SyntheticPhoto], camera: dict[str, Any]) -> gm.Block:
    """Block of the photos, of which nothing but the focal length is known."""
    wide, high = camera["size"]
    lens = gm.Camera(size=(wide, high), focal_length_px=camera["focal_length"] / camera["sensor_size"][0] * wide)
    paths = [folder / f"{photo.name}.jpg" for photo in photos]
    return gm.Block(paths, "frame", camera=lens, crs=local_frame_crs().to_wkt())


def truth_of(ties: Any, photos: Sequence[SyntheticPhoto], camera: dict[str, Any], scenery: Scenery) -> Truth:
    """Errors of tie points against the true cameras and the true ground."""
    cameras = [photo.camera(camera, GROUND) for photo in photos]
    number = {f"{photo.name}.jpg": k for k, photo in enumerate(photos)}
    image = np.array([number[name] for name in ties.images])
    _, point = np.unique(np.asarray(ties.points), return_inverse=True)
    off = tie_errors(cameras, GROUND, image, point.ravel(), ties.colrow)
    wet = 0
    for k, each in enumerate(cameras):
        met = intersect(each, GROUND, ties.colrow[image == k])
        wet += int(water(scenery, met[:, :2] - GROUND.origin).sum())
    return Truth(off[~np.isnan(off)], wet)
