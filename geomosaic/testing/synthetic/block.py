"""Flight plans for synthetic blocks: strips of photos with overlaps, tilts and turns as real flights have them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from geomosaic.testing.synthetic.camera import PlainCamera
from geomosaic.testing.synthetic.ground import AnalyticGround

CAMERA: dict[str, Any] = {
    "size": [1200, 900],
    "focal_length": 45.2,
    "sensor_size": [36.0, 27.0],
    "principal_point": [0.18, -0.12],
    "distortion": {"model": "brown", "k1": -0.095, "k2": 0.035, "k3": 0.0, "p1": 0.0006, "p2": -0.0004},
}


@dataclass(frozen=True)
class SyntheticPhoto:
    """Photo of a synthetic block.

    Attributes
    ----------
    name : str
    position : (float, float, float)
        Projection centre in the CRS of the ground, metres.
    angles : (float, float, float)
        Omega, phi, kappa in degrees.
    """

    name: str
    position: tuple[float, float, float]
    angles: tuple[float, float, float]

    def camera(self, camera: Mapping[str, Any], ground: AnalyticGround) -> PlainCamera:
        """Independent camera at this place."""
        return PlainCamera(camera, ground.crs, self.position, self.angles)


def synthetic_block(
    ground: AnalyticGround,
    camera: Mapping[str, Any],
    strips: int,
    photos: int,
    forward_overlap: float = 0.6,
    side_overlap: float = 0.35,
    seed: int = 0,
    *,
    gsd: float = 0.7,
    tilt: float = 2.0,
    drift: float = 4.0,
    shake: float = 12.0,
) -> list[SyntheticPhoto]:
    """Flight plan of a synthetic block about the ground's origin: strips run east and west in turn.

    Parameters
    ----------
    camera : mapping
        As `PlainCamera` has it.
    strips, photos : int
        Number of strips, and of photos in each.
    forward_overlap, side_overlap : float
        Shares of the image's width and height, 0..1, on flat ground at the base height.
    seed : int
        Of tilts, drifts and positions.
    gsd : float
        Pixel size on the ground at the base height, metres; it sets the flying height.
    tilt, drift : float
        Standard deviations of omega and phi, and of kappa about the strip's direction, degrees; nothing is beyond
        twice as much.
    shake : float
        Standard deviation of the position in metres, about the plan.

    Returns
    -------
    list of SyntheticPhoto
        In flight order; positions are rounded to mm and angles to 1e-5 degrees, so tables carry them in full.
    """
    width, height = camera["size"]
    above = gsd * camera["focal_length"] * width / camera["sensor_size"][0]
    base, spacing = gsd * width * (1 - forward_overlap), gsd * height * (1 - side_overlap)
    random = np.random.default_rng(seed)
    block = []
    for strip in range(strips):
        westward = bool(strip % 2)
        for k in range(photos):
            off = np.clip(random.normal(size=6), -2, 2)
            along = (k - (photos - 1) / 2) * base * (-1 if westward else 1)
            across = ((strips - 1) / 2 - strip) * spacing
            position = np.array([ground.origin[0] + along, ground.origin[1] + across, ground.base + above])
            x, y, z = np.round(position + shake * off[:3], 3).tolist()
            kappa = drift * off[5] + (180.0 if westward else 0.0)
            omega, phi, kappa = np.round([tilt * off[3], tilt * off[4], (kappa + 180) % 360 - 180], 5).tolist()
            block.append(SyntheticPhoto(f"strip{strip + 1}_{k + 1:02d}", (x, y, z), (omega, phi, kappa)))
    return block
