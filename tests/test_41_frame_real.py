"""Real photos whose orientation is given in several systems: the readers agree as far as the data does."""

from __future__ import annotations

import csv
import json
import math
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyproj import CRS

from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.geo.transform import Transform
from geomosaic.interchange.opensfm import camera_table
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.types import FloatArray
from geomosaic_frame import plugin
from geomosaic_frame.model import FrameModel

SIZE = (1368, 912)
UTM = with_heights(parse_crs("EPSG:32651"), "ellipsoidal")
RECONSTRUCTION = "opensfm/reconstruction.json"
IMAGES = ("100_0005_0018", "100_0005_0136", "100_0005_0140", "100_0005_0142")


@pytest.fixture(scope="module")
def odm(real_data: Callable[[str], Path]) -> Path:
    return real_data("orthority-odm")


def rows(path: Path) -> dict[str, list[float]]:
    lines = [shlex.split(line) for line in path.read_text().splitlines()[1:]]
    return {line[0].removesuffix(".tif"): [float(v) for v in line[1:7]] for line in lines}


def build(base: Path, image: str, crs: CRS, **options: Any) -> FrameModel:
    options.setdefault("ground_height", 10.0)
    return plugin.build(SensorRequest(f"{image}.tif", SIZE, options, crs, str(base)))


def camera_of(base: Path) -> dict[str, Any]:
    part = json.loads((base / RECONSTRUCTION).read_text())[0]
    return camera_table(next(iter(part["cameras"].values())), "camera")


def turn(a: FrameModel, b: FrameModel) -> float:
    """Angle between two photos' attitudes in degrees."""
    m = (a.rotation @ a.frame.axes) @ (b.rotation @ b.frame.axes).T
    return math.degrees(math.acos(min(1.0, (float(np.trace(m)) - 1) / 2)))


def apart(a: FrameModel, b: FrameModel) -> FloatArray:
    """Difference (col, row) in pixels at points 200 m away, all over the image."""
    c, r = np.meshgrid(np.linspace(0, SIZE[0], 5), np.linspace(0, SIZE[1], 5))
    origins, directions = a.rays(np.column_stack([c.ravel(), r.ravel()]))
    ground = origins + 200.0 * directions
    difference: FloatArray = a.ground_to_image(ground) - b.ground_to_image(ground)
    return difference


@pytest.mark.parametrize("image", IMAGES)
def test_angles_of_the_table_are_those_of_the_reconstruction(odm: Path, image: str) -> None:
    """Measured when written: at most 0.0005° and 0.02 px; the table has 0.001° and 1 mm."""
    x, y, z, omega, phi, kappa = rows(odm / "io" / "odm_xyz_opk.csv")[image]
    orientation = {"system": "opk", "omega": omega, "phi": phi, "kappa": kappa}
    for treatment in ("rigorous", "planar"):
        table = build(
            odm, image, UTM, camera=camera_of(odm), position=[x, y, z], orientation=orientation, treatment=treatment
        )
        own = {"system": "odm", "reconstruction": RECONSTRUCTION}
        shot = build(odm, image, UTM, orientation=own, treatment=treatment)
        assert turn(table, shot) < 0.001
        assert np.linalg.norm(table.centre - shot.centre) < 0.001
        assert np.abs(apart(table, shot)).max() < 0.03


@pytest.mark.parametrize("image", IMAGES)
def test_this_reconstruction_is_not_in_true_north(odm: Path, image: str) -> None:
    """OpenDroneMap writes it in UTM axes; read as OpenSfM's own, it is turned by the convergence, 0.86°, and moved."""
    shot, wrong = (
        build(odm, image, UTM, orientation={"system": system, "reconstruction": RECONSTRUCTION})
        for system in ("odm", "opensfm")
    )
    assert turn(shot, wrong) == pytest.approx(0.856, abs=0.002)
    assert 1.5 < np.linalg.norm(shot.centre - wrong.centre) < 2.6


@pytest.mark.parametrize("image", IMAGES)
def test_aircraft_angles_are_near_the_adjusted_ones(odm: Path, image: str) -> None:
    """Raw gimbal and compass: measured when written, 0.8 to 1.4° and 1 to 5 cm from the adjusted photo."""
    latitude, longitude, altitude, roll, pitch, yaw = rows(odm / "io" / "odm_lla_rpy.csv")[image]
    orientation = {"system": "rpy", "roll": roll, "pitch": pitch, "yaw": yaw}
    position = [longitude, latitude, altitude]
    raw = build(odm, image, CRS.from_epsg(4979), camera=camera_of(odm), position=position, orientation=orientation)
    shot = build(odm, image, UTM, orientation={"system": "odm", "reconstruction": RECONSTRUCTION})
    assert turn(raw, shot) < 1.5
    assert np.linalg.norm(raw.centre - shot.centre) < 0.06
    # The mirrored conventions are 60° off: the tilt is forward.
    for changed in ({"pitch": -pitch}, {"roll": 2 * pitch}):
        other = build(
            odm, image, CRS.from_epsg(4979), camera=camera_of(odm), position=position, orientation=orientation | changed
        )
        assert turn(other, shot) > 55.0


def test_dmc_photos_of_two_strips(real_data: Callable[[str], Path]) -> None:
    """Reduced copies of 7680 x 13824 px; strip 05 is upside down (kappa -179), strip 06 the right way up."""
    base = real_data("orthority-ngi")
    crs = with_heights(parse_crs((base / "io" / "ngi_xyz_opk.prj").read_text()), "egm96")
    camera = {"size": [7680, 13824], "focal_length": 120.0, "sensor_size": [92.16, 165.888]}
    models = {}
    with (base / "io" / "ngi_xyz_opk.csv").open() as file:
        for row in csv.DictReader(file):
            v = {key: float(value) for key, value in row.items() if key != "filename"}
            options = {
                "camera": camera,
                "position": [v["x"], v["y"], v["z"]],
                "orientation": {"system": "opk", "omega": v["omega"], "phi": v["phi"], "kappa": v["kappa"]},
                "ground_height": 450.0,
            }
            models[row["filename"]] = plugin.build(SensorRequest(row["filename"], (640, 1152), options, crs))
    assert len(models) == 4
    # Between the strips, in the upper half of all four photos; and a kilometre to the east.
    ground = np.array([[-56_400.0, -3_729_500.0, 450.0], [-55_400.0, -3_729_500.0, 450.0]])
    for name, model in models.items():
        at, east = model.ground_to_image(Transform(crs, model.crs)(ground))
        assert "reduced by 12" in model.notes[0]
        assert 0 < at[0] < 640
        assert 0 < at[1] < 576
        assert math.copysign(1.0, east[0] - at[0]) == (-1.0 if "_05_" in name else 1.0)
        assert np.linalg.norm(east - at) == pytest.approx(1000.0 * (120.0 / 0.144) / (5250.0 - 450.0), rel=0.03)
