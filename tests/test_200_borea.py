"""A real aerial block of IGN France: 14 407 tie points, and what each mistake of convention does to them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyproj import CRS

from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.geo.transform import Transform
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.registry import build
from geomosaic.types import FloatArray


@dataclass(frozen=True)
class Photo:
    camera: dict[str, Any]
    position: list[float]
    angles: dict[str, float]
    ground: FloatArray  # Lambert-93 and ellipsoidal height
    pixels: FloatArray


@dataclass(frozen=True)
class Tie:
    photos: dict[str, Photo]
    altitude: CRS
    ellipsoidal: CRS

    def residuals(
        self, crs: CRS | None = None, scale_correction: bool = True, treatment: str = "rigorous", frame: str = "grid"
    ) -> FloatArray:
        """Computed minus measured (col, row) in pixels of all observations."""
        out = []
        to_altitude = Transform(self.ellipsoidal, self.altitude)
        for name, photo in self.photos.items():
            options: dict[str, Any] = {
                "camera": photo.camera,
                "position": photo.position,
                "orientation": {"system": "opk", **photo.angles, "frame": frame},
                "treatment": treatment,
            }
            if scale_correction:
                options |= {"scale_correction": True, "ground_height": float(to_altitude(photo.ground)[:, 2].mean())}
            width, height = photo.camera["size"]
            model = build("frame", SensorRequest(name, (width, height), options, crs or self.altitude))
            ground = Transform(self.ellipsoidal, model.crs)(photo.ground) if treatment == "rigorous" else photo.ground
            out.append(model.ground_to_image(ground) - photo.pixels)
        return np.vstack(out)


def rows(path: Path, count: int) -> list[list[str]]:
    return [line.split() for line in path.read_text().splitlines() if len(line.split()) == count]


@pytest.fixture(scope="module")
def tie(real_data: Callable[[str], Path]) -> Tie:
    base = real_data("borea-ign-uce-block")
    data = base / "test" / "data" / "dataset2"
    cameras = {}
    for file in ("Camera1.txt", "Camera2.txt"):
        text = dict(line.split("=") for line in (base / "dataset" / file).read_text().splitlines() if "=" in line)
        c = {key.strip(): value.strip() for key, value in text.items()}
        cameras[c["Name"]] = {
            "size": [int(c["width"]), int(c["height"])],
            "focal_length_px": float(c["focal"]),
            "principal_point_px": [float(c["PPAx"]), float(c["PPAy"])],
        }
    world = {r[0]: [float(v) for v in r[1:]] for r in rows(data / "all_liaisons2_world.mes", 4)}
    seen: dict[str, list[tuple[list[float], list[float]]]] = {}
    for point, image, col, row in rows(data / "all_liaisons2.mes", 4):
        if point in world:
            seen.setdefault(image, []).append((world[point], [float(col), float(row)]))
    photos = {}
    for name, *numbers, camera in rows(data / "23FD1305_alt_2.OPK", 8)[1:]:
        if name in seen:
            v = [float(n) for n in numbers]
            ground, pixels = zip(*seen[name], strict=True)
            angles = dict(zip(("omega", "phi", "kappa"), v[3:], strict=True))
            photos[name] = Photo(cameras[camera], v[:3], angles, np.array(ground), np.array(pixels))
    map_crs = parse_crs("EPSG:2154")
    geoid = str(base / "dataset" / "fr_ign_RAF20.tif")
    return Tie(photos, with_heights(map_crs, geoid), with_heights(map_crs, "ellipsoidal"))


def test_every_observation_is_met(tie: Tie) -> None:
    """Measured when written: mean (-0.004, -0.013), standard deviation (0.187, 0.206) px."""
    e = tie.residuals()
    assert len(e) == 14_407
    assert np.isfinite(e).all()
    assert (np.abs(e.mean(axis=0)) <= 0.02).all()
    assert (e.std(axis=0) <= 0.21).all()


# The data set's own description gives these figures for the mistakes.
def test_linear_alteration_left_in_shows(tie: Tie) -> None:
    assert tie.residuals(scale_correction=False).std(axis=0) == pytest.approx([2.3, 1.4], abs=0.06)


def test_missing_geoid_shows(tie: Tie) -> None:
    assert np.median(np.abs(tie.residuals(crs=tie.ellipsoidal))) == pytest.approx(145.0, abs=1.0)


def test_planar_collinearity_with_mixed_heights_shows(tie: Tie) -> None:
    e = tie.residuals(treatment="planar", scale_correction=False)
    assert e.std(axis=0) == pytest.approx([221.0, 140.0], abs=1.0)


def test_ignored_convergence_shows(tie: Tie) -> None:
    """1.03° to 1.21° of a half diagonal of 15 700 px."""
    e = tie.residuals(frame="local")
    assert np.median(np.hypot(*e.T)) > 100.0
