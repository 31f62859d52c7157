"""Blocks of photos over hills with known poses, of which the start of a block is told the image positions alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.geo.local_frames import LocalFrame, angle_axis, omega_phi_kappa
from geomosaic.orientation.block.initial_values import InitialValues, Known, UnorientedBlock
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.types import FloatArray
from geomosaic_frame.model import FrameModel

UTM = with_heights(parse_crs("EPSG:32633"), "ellipsoidal")
PLACE = np.array([512_000.0, 5_300_000.0, 400.0])
SIZE = (6000, 4000)
FLIP = np.diag([1.0, -1.0, -1.0])
CAMERA = {
    "focal_length": 24.0,
    "sensor_size": [36.0, 24.0],
    "distortion": {"model": "brown", "k1": -0.05, "k2": 0.01, "p1": 3e-4},
}
FISHEYE = {"focal_length": 8.0, "sensor_size": [36.0, 24.0], "distortion": {"model": "fisheye", "k1": -0.01}}


@dataclass(frozen=True, eq=False)
class Truth:
    """A block, its photos as they are, its points, and which image positions are wrong."""

    block: UnorientedBlock
    models: tuple[FrameModel, ...]
    centres: FloatArray
    rotations: FloatArray
    points: FloatArray
    wrong: np.ndarray
    flying_height: float

    def knowing(self, **known: FloatArray) -> UnorientedBlock:
        """The block with something known of its places."""
        return replace(self.block, known=replace(self.block.known, **known))

    def control(self, *rows: int) -> FloatArray:
        """Coordinates of some points, as `Known.points`."""
        given = np.full_like(self.points, np.nan)
        given[list(rows)] = self.points[list(rows)]
        return given

    def errors(self, start: InitialValues) -> tuple[float, float, float]:
        """Largest error of a centre and median of a point, over the flying height; largest of an attitude, degrees."""
        off, turned = [], []
        frame = self.block.frame
        for model, centre, rotation in zip(start.models, self.centres, self.rotations, strict=True):
            there, turn = model.pose
            off.append(np.linalg.norm(frame.to_enu(there) - centre))
            cosine = (np.trace(turn @ frame.axes.T @ rotation.T) - 1.0) / 2.0
            turned.append(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
        points = np.linalg.norm(start.points - self.points, axis=1)
        return max(off) / self.flying_height, float(np.nanmedian(points)) / self.flying_height, max(turned)


@dataclass(frozen=True, eq=False)
class Scene:
    """An image that tells no more than where ground points are in it, as rational polynomials do."""

    inner: FrameModel

    def __getattr__(self, name: str) -> Any:
        if name in ("rays", "jacobian", "pose", "directions", "posed"):
            raise AttributeError(name)
        return getattr(self.inner, name)


def photo(camera: dict | None = None) -> FrameModel:
    """A photo that knows its camera alone."""
    model = registry.build("frame", SensorRequest("photo", SIZE, {"camera": camera or CAMERA, "unoriented": True}))
    assert isinstance(model, FrameModel)
    return model


def flight(
    strips: int, photos: int, height: float = 1000.0, forward: float = 0.6, side: float = 0.3, tilt: float = 3.0
):
    """Centres and rotations of a flight to and fro, in the block's frame; `tilt` in degrees is of all three angles."""
    rng = np.random.default_rng(strips * photos)
    long, wide = height * (1 - forward), 1.5 * height * (1 - side)
    centres, rotations = [], []
    for strip in range(strips):
        for index in range(photos):
            centres.append(np.array([strip * wide, index * long, height]) + rng.normal(0.0, 0.02 * height, 3))
            angles = np.array([0.0, 0.0, 180.0 * (strip % 2)]) + rng.normal(0.0, tilt, 3)
            rotations.append(FLIP @ omega_phi_kappa(*np.radians(angles)))
    return np.array(centres), np.array(rotations)


def circle(photos: int, radius: float = 8.0):
    """Centres and rotations of a camera that goes round an object, at changing heights."""
    angles = np.linspace(0.0, 2.0 * np.pi, photos, endpoint=False)
    centres = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), 2.0 * np.cos(3.0 * angles)])
    rotations = []
    for index, centre in enumerate(centres):
        forward = -centre / np.linalg.norm(centre)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        axes = np.stack([right, np.cross(forward, right), forward])
        # Every other photo is on its side.
        rotations.append(angle_axis(np.array([0.0, 0.0, np.pi / 2 * (index % 2)])) @ axes)
    return centres, np.array(rotations)


def hills(centres: FloatArray, count: int, relief: float = 0.1, seed: int = 1) -> FloatArray:
    """Points (S, 3) of hills below a flight."""
    rng = np.random.default_rng(seed)
    height = float(np.mean(centres[:, 2]))
    reach = np.array([0.75, 0.5]) * height
    places = rng.uniform(centres[:, :2].min(axis=0) - reach, centres[:, :2].max(axis=0) + reach, (count, 2))
    up = relief * height * np.sin(places[:, 0] / (0.4 * height)) * np.cos(places[:, 1] / (0.3 * height))
    return np.column_stack([places, up])


def block(
    centres: FloatArray,
    rotations: FloatArray,
    points: FloatArray,
    *,
    sigma: float = 0.5,
    gross: float = 0.0,
    model: FrameModel | None = None,
) -> Truth:
    """Block of photos with noise of `sigma` pixels, and a share `gross` of image positions anywhere."""
    rng = np.random.default_rng(7)
    frame = LocalFrame.at(UTM, PLACE)
    model = model or photo()
    ahead = frame.to_geocentric(points.mean(axis=0))
    posed = tuple(
        model.posed(frame.to_geocentric(centre), rotation @ frame.axes, ahead, frame.crs)
        for centre, rotation in zip(centres, rotations, strict=True)
    )
    image, point, colrow = [], [], []
    for index, one in enumerate(posed):
        place = one.ground_to_image(frame.to_geocentric(points))
        with np.errstate(invalid="ignore"):
            inside = np.flatnonzero(((place > 0) & (place < SIZE)).all(axis=1))
        image.append(np.full(len(inside), index))
        point.append(inside)
        colrow.append(place[inside])
    images, ids, positions = np.concatenate(image), np.concatenate(point), np.concatenate(colrow)
    twice = np.bincount(ids, minlength=len(points))[ids] >= 2
    images, ids, positions = images[twice], ids[twice], positions[twice]
    positions = positions + rng.normal(0.0, sigma, positions.shape)
    wrong = rng.random(len(ids)) < gross
    positions[wrong] = rng.uniform((0, 0), SIZE, (int(wrong.sum()), 2))
    names = tuple(f"photo {index + 1}" for index in range(len(centres)))
    given = UnorientedBlock(
        names,
        (model,) * len(centres),
        np.zeros(len(centres), dtype=bool),
        images,
        ids,
        positions,
        frame,
        Known.nothing(len(centres), len(points)),
    )
    distance = np.linalg.norm(points.mean(axis=0) - centres, axis=1)
    height = float(np.median(np.minimum(distance, np.maximum(centres[:, 2], 1.0)))) if len(centres) else 1.0
    return Truth(given, posed, centres, rotations, points, wrong, height)
