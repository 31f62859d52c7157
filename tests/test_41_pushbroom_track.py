"""Airborne strips with a track of positions and attitudes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyproj import CRS
from scipy.interpolate import CubicSpline

from geomosaic.errors import InputError
from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.geo.local_frames import enu_axes, map_place
from geomosaic.geo.transform import Transform
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.testing import SensorModelTests, check_plugin
from geomosaic.types import FloatArray
from geomosaic_pushbroom.model import PushbroomModel

pytestmark = pytest.mark.ci

MAP = with_heights(parse_crs("EPSG:32633"), "ellipsoidal")
WORLD = CRS.from_epsg(4979)
SIZE = (800, 1000)
PERIOD, FIRST, FOCAL = 0.01, 345_600.0, 1000.0
LON, LAT, UP = 17.5, 48.5, 2300.0


def flight(t: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Longitude, latitude, height and roll, pitch, heading in degrees, t seconds from the first row."""
    place = np.column_stack([LON + 5e-4 * t, LAT + 4e-4 * t, UP + 3.0 * np.sin(0.4 * t)])
    wave = np.column_stack([2.0 * np.sin(0.9 * t), 1.0 + 0.8 * np.cos(0.7 * t), 40.0 + 1.5 * np.sin(0.3 * t)])
    return place, wave


def ray(col: float, t: float) -> tuple[FloatArray, FloatArray]:
    """Geocentric ray by elementary turns of an aircraft: heading about down, pitch about right, roll about forward."""
    (place,), (angles,) = flight(np.array([t]))
    roll, pitch, heading = np.radians(angles)
    nose, right = np.array([np.sin(heading), np.cos(heading), 0.0]), np.array([np.cos(heading), -np.sin(heading), 0.0])
    up = np.array([0.0, 0.0, 1.0])
    nose, up = np.cos(pitch) * nose + np.sin(pitch) * up, np.cos(pitch) * up - np.sin(pitch) * nose
    right, up = np.cos(roll) * right - np.sin(roll) * up, np.cos(roll) * up + np.sin(roll) * right
    look = (col - 400.0) / FOCAL * right - up
    origin = Transform(WORLD, CRS.from_epsg(4978))(place[None])[0]
    return origin, look @ enu_axes(place[0], place[1])


def write(path: Path, crs: CRS, system: str, rate: float = 500.0) -> None:
    t = np.arange(-0.5, 10.6, 1.0 / rate)
    place, angles = flight(t)
    xyz = Transform(WORLD, crs)(place)
    names = "roll,pitch,heading"
    if system == "opk":
        names, rows = "omega,phi,kappa", []
        # Convergence changes slowly along the flight: measured at 40 places, to 1e-9 degrees between them.
        some = np.unique(np.linspace(0, len(t) - 1, 40).round().astype(int))
        convergence = CubicSpline(t[some], [map_place(crs, *xyz[i, :2]).convergence for i in some])(t)
        for gamma, (roll, pitch, heading) in zip(np.radians(convergence), np.radians(angles), strict=True):
            a, b, c = (
                _turn(axis, angle) for axis, angle in ((2, -heading), (0, pitch), (1, roll))
            )  # body axes right, forward, up in east, north, up
            true = (a @ b @ c).T
            m = true @ _turn(2, gamma).T
            rows.append([np.arctan2(-m[2, 1], m[2, 2]), np.arcsin(m[2, 0]), np.arctan2(-m[1, 0], m[0, 0])])
        angles = np.degrees(rows)
    table = np.column_stack([FIRST + t, xyz, angles])
    lines = [f"time,x,y,z,{names}", *(",".join(f"{v:.10f}" for v in row) for row in table)]
    path.write_text("\n".join(lines))


def _turn(axis: int, angle: float) -> FloatArray:
    """Matrix that turns a vector right-handed about an axis."""
    c, s = np.cos(angle), np.sin(angle)
    i, j = (axis + 1) % 3, (axis + 2) % 3
    m = np.eye(3)
    m[i, i] = m[j, j] = c
    m[j, i], m[i, j] = s, -s
    return m


def request(folder: Path, crs: CRS = MAP, **options: Any) -> SensorRequest:
    given = {
        "track": "track.csv", "focal_length_px": FOCAL, "start_time": FIRST, "line_period": PERIOD, "columns": "right",
        "ground_height": 300.0,
    }  # fmt: skip
    given = {name: value for name, value in (given | options).items() if value is not None}
    return SensorRequest("strip 7", SIZE, given, crs, str(folder))


def build(folder: Path, crs: CRS = MAP, **options: Any) -> PushbroomModel:
    model = registry.build("pushbroom", request(folder, crs, **options))
    assert isinstance(model, PushbroomModel)
    return model


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("strip")
    write(path / "track.csv", MAP, "rpy")
    write(path / "grid.csv", MAP, "opk")
    write(path / "world.csv", WORLD, "rpy")
    return path


def truth(count: int = 60, seed: int = 2) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    image = rng.uniform(0.02, 0.98, (count, 2)) * SIZE
    ground = []
    for col, row in image:
        origin, direction = ray(col, (row - 0.5) * PERIOD)
        ground.append(origin + direction * rng.uniform(1700.0, 2100.0))
    return np.array(ground), image


class TestTrack(SensorModelTests):
    """Turns and drifts; a shift of the aircraft and a turn differ by relief alone."""

    @pytest.fixture
    def model(self, folder: Path) -> PushbroomModel:
        return build(folder, sigmas={"position": 0.0})

    @pytest.fixture
    def ground(self) -> FloatArray:
        return truth()[0]


def test_the_plugin_passes_the_check(folder: Path) -> None:
    options = {"angle_unit": "deg", "principal_col": 400.0, "sigmas": {"time": 0.01}}
    check_plugin(registry.plugin("pushbroom"), request(folder, **options))


@pytest.mark.parametrize(("track", "crs"), [("track.csv", MAP), ("grid.csv", MAP), ("world.csv", WORLD)])
def test_against_a_second_implementation(folder: Path, track: str, crs: CRS) -> None:
    """500 poses a second, interpolated between, rocking by degrees: less than a hundredth of a pixel."""
    ground, image = truth()
    np.testing.assert_allclose(build(folder, crs, track=track).ground_to_image(ground), image, atol=5e-3)


def test_columns_to_the_left(folder: Path) -> None:
    ground, image = truth()
    found = build(folder, columns="left").ground_to_image(ground)
    np.testing.assert_allclose(found, np.column_stack([800.0 - image[:, 0], image[:, 1]]), atol=5e-3)


def test_boresight_by_control_points(folder: Path) -> None:
    """The camera sits askew in the aircraft: the corrections are its boresight, and take it out."""
    ground, image = truth(12)
    askew = build(folder)
    values = askew.parameters.values.copy()
    values[:3] = [0.3, -0.2, 0.5]
    askew = askew.with_values(values)
    rows = np.column_stack([Transform(askew.crs, MAP)(ground), askew.ground_to_image(ground)]).tolist()
    points = [dict(zip(("x", "y", "z", "col", "row"), row, strict=True)) | {"sigma": 0.01} for row in rows]
    found = build(folder, points=points, sigmas={"angles": 5.0, "rates": 0.0, "position": 0.0})
    np.testing.assert_allclose(found.parameters.values[:3], [0.3, -0.2, 0.5], atol=1e-5)
    assert np.abs(askew.ground_to_image(ground) - image).max() > 5.0


def test_angles_in_gons_are_read(folder: Path, tmp_path: Path) -> None:
    rows = (folder / "track.csv").read_text().splitlines()
    head, *body = rows
    turned = [",".join([*row.split(",")[:4], *(f"{float(v) / 0.9:.10f}" for v in row.split(",")[4:])]) for row in body]
    (tmp_path / "track.csv").write_text("\n".join([head, *turned]))
    ground, image = truth(10)
    found = build(tmp_path, angle_unit="gon").ground_to_image(ground)
    np.testing.assert_allclose(found, image, atol=5e-3)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"columns": None}, "'columns' is missing"),
        ({"columns": "up"}, "columns = 'up'"),
        ({"start_time": 0.0}, "the track covers"),
        ({"line_period": -1.0}, "out of range"),
        ({"track": "lost.csv"}, "does not exist"),
        ({"track": 7}, "not a file name"),
        ({"angle_unit": "grad"}, "angle_unit"),
        ({"flying_height": 100.0}, "no meaning"),
        ({"crs": CRS.from_epsg(32633)}, "vertical datum"),
    ],
)
def test_bad_inputs_name_the_strip(folder: Path, options: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match="strip 7") as told:
        build(folder, **options)
    assert words in str(told.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "columns of the track are none"),
        ("time,x,y,z,roll,pitch\n", "roll, pitch, heading"),
        ("time,x,y,z,roll,pitch,heading\n1,2,3\n", "3 values"),
        ("time,x,y,z,roll,pitch,heading\n1,2,3,4,5,6,a\n", "row 1, heading"),
        ("time,x,y,z,roll,pitch,heading\n2,2,3,4,5,6,7\n1,2,3,4,5,6,7", "do not grow"),
    ],
)
def test_bad_tables_are_refused_by_line(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "track.csv").write_text(text)
    with pytest.raises(InputError, match=r"track\.csv") as told:
        build(tmp_path)
    assert words in str(told.value)
