"""Overlapping photos whose true maps are known: slightly tilted, and bent as prints and scanners bend them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pyproj import CRS

from geomosaic.block import ControlPoint, OrientedImage
from geomosaic.orientation.edges import CommonPoint
from geomosaic_planar import PlanarModel, fit_planar

UTM = CRS.from_epsg(32633)
SIZE = (2000, 1600)
STEP = 1500.0
"""Pixels from one photo to the next: they overlap by a quarter."""
CORNER = np.array([500_000.0, 5_400_000.0])


@dataclass(frozen=True)
class TruePhoto:
    """Ground → image: shifted, turned by a degree or so, tilted, then bent by some pixels."""

    index: int
    tilt: float = 4e-6
    bend: float = 6.0

    def __call__(self, xy: np.ndarray) -> np.ndarray:
        u = (xy - CORNER) @ np.diag([1.0, -1.0]) - [STEP * self.index, 0.0]
        angle = np.radians(0.7 * (-1) ** self.index)
        u = u @ np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        u = u / (1.0 + self.tilt * (u - np.array(SIZE) / 2) @ [1.0, 0.6 - 0.4 * self.index])[:, None]
        s, t = (u / SIZE * 2.0 - 1.0).T
        k = 1.0 + 0.3 * self.index
        return u + self.bend * np.column_stack([k * s * t - 0.5 * s**3, k * np.sin(2.0 * t + self.index) - 0.7 * s * s])

    def inverse(self, colrow: np.ndarray) -> np.ndarray:
        """Image → ground, by iteration."""
        xy = CORNER + np.add(colrow, [STEP * self.index, 0.0]) * [1.0, -1.0]
        for _ in range(100):
            left = colrow - self(xy)
            xy = xy + left * [1.0, -1.0]
            if np.abs(left).max() < 2e-9:  # map coordinates have no more digits
                break
        assert np.abs(left).max() < 1e-8
        return xy


def seam(index: int, count: int, wobble: float = 30.0) -> np.ndarray:
    """Ground along the middle of the overlap of photos index and index + 1, from top to bottom."""
    down = np.linspace(120.0, SIZE[1] - 120.0, count)
    along = 0.5 * (STEP + SIZE[0]) + STEP * index + wobble * np.sin(down / 130.0)
    return CORNER + np.column_stack([along, -down])


def xyz(xy: np.ndarray) -> np.ndarray:
    return np.column_stack([xy, np.zeros(len(xy))])


@dataclass(frozen=True)
class Rig:
    """Photos with 4 control points each (0.5 px) and 8 common points at each seam (0.3 px by default)."""

    truths: list[TruePhoto]
    photos: list[OrientedImage]
    control: list[ControlPoint]
    common: list[CommonPoint]


def start(kind: str, index: int) -> PlanarModel:
    """A model of one kind, off by ten pixels."""
    grid = np.array([[a, b] for a in (100.0, 1000.0, 1900.0) for b in (100.0, 800.0, 1500.0)])
    xy = CORNER + np.add(grid, [STEP * index, 0.0]) * [1.0, -1.0]
    fitted = fit_planar(kind, xy, grid + 10.0)
    return PlanarModel.of(fitted, UTM, SIZE)


def rig(
    photos: int = 2,
    kind: str = "affine",
    *,
    seed: int = 1,
    control_sigma: float = 0.5,
    common_sigma: float = 0.3,
    bend: float = 6.0,
    tilt: float = 4e-6,
    common: int = 8,
    wobble: float = 30.0,
) -> Rig:
    rng = np.random.default_rng(seed)
    truths = [TruePhoto(i, tilt, bend) for i in range(photos)]
    scenes = [OrientedImage(f"photo-{i}", "", "planar", start(kind, i)) for i in range(photos)]
    known, shared = [], []
    for i, truth in enumerate(truths):
        for k, place in enumerate([(150.0, 140.0), (1850.0, 150.0), (1840.0, 1450.0), (160.0, 1460.0)]):
            ground = truth.inverse(np.array([place]))
            noisy = np.array(place) + rng.normal(0.0, control_sigma, 2)
            known.append(
                ControlPoint(
                    f"c{i}{k}", (*ground[0], 0.0), f"photo-{i}", tuple(noisy), sigma_px=max(control_sigma, 1e-3)
                )
            )
    for i in range(photos - 1):
        for k, ground in enumerate(seam(i, common, wobble)):
            for j in (i, i + 1):
                noisy = truths[j](ground[None])[0] + rng.normal(0.0, common_sigma, 2)
                shared.append(CommonPoint(f"p{i}{k}", f"photo-{j}", tuple(noisy), max(common_sigma, 1e-3)))
    return Rig(truths, scenes, known, shared)


def along_the_seam(rig: Rig, models: list[PlanarModel], index: int = 0, count: int = 400) -> np.ndarray:
    """How far two photos are from meeting (count,), pixels, between the common points and without their noise."""
    from geomosaic.sensor.solve import image_to_height

    ground = seam(index, count)
    places = [image_to_height(models[i], rig.truths[i](ground), 0.0, models[i].crs)[:, :2] for i in (index, index + 1)]
    return np.hypot(*(places[1] - places[0]).T)  # a pixel is a metre
