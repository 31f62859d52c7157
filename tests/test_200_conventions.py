"""Conventions of other people's real files, shown by reprojection: what they measured falls where we put it."""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from pyproj import Transformer
from scipy.linalg import polar

from geomosaic.cli.main import run
from geomosaic.errors import InputError
from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.geo.transform import Transform
from geomosaic.interchange.files import program_of
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import HasRays, SensorModel, SensorRequest
from geomosaic.types import FloatArray

RealData = Callable[[str], Path]
BERLIN_SIZE, BERLIN_LONGEST = (3264, 2448), 3264.0
LAMBERT = with_heights(parse_crs("EPSG:2154"), "egm96")
PHOTO = "Clermont-111005_0906-22-00002_0000000.tif"


# --- opensfm-berlin ---------------------------------------------------------------------------------------------------


def east_north_up(lla: dict[str, float], enu: FloatArray) -> FloatArray:
    """Places (N, 3) about a reference as geocentric ones, written out."""
    lon, lat = math.radians(lla["longitude"]), math.radians(lla["latitude"])
    origin = Transformer.from_crs(4979, 4978, always_xy=True).transform(
        lla["longitude"], lla["latitude"], lla["altitude"]
    )
    east = np.array([-math.sin(lon), math.cos(lon), 0.0])
    up = np.array([math.cos(lat) * math.cos(lon), math.cos(lat) * math.sin(lon), math.sin(lat)])
    out: FloatArray = np.array(origin) + enu @ np.array([east, np.cross(up, east), up])
    return out


def shot(base: Path, image: str, **changed: Any) -> SensorModel:
    row = {"system": "opensfm", "reconstruction": str(base / "reconstruction_example.json"), **changed}
    options = {"orientation": row, "upwards": True}
    return registry.build("frame", SensorRequest(image, BERLIN_SIZE, options, None))


def pixels(projection: list[float]) -> tuple[float, float]:
    """Pixels of normalised coordinates: from the centre, in units of the longer side, x right, y down."""
    return projection[0] * BERLIN_LONGEST + BERLIN_SIZE[0] / 2, projection[1] * BERLIN_LONGEST + BERLIN_SIZE[1] / 2


@pytest.mark.parametrize("image", ["01.jpg", "02.jpg", "03.jpg"])
def test_points_of_another_program_fall_on_its_measurements(real_data: RealData, image: str) -> None:
    """Features as they were found in the photo, against the points that were computed of them.

    Measured: medians of 0.7, 0.8 and 1.2 px over 1070, 1406 and 606 points; that is the other program's own residual.
    """
    base = real_data("opensfm-berlin")
    (part,) = json.loads((base / "reconstruction_example.json").read_text())
    with (base / "tracks_example.csv").open() as file:
        lines = [line for line in csv.reader(file, delimiter="\t") if line[0] == image and line[1] in part["points"]]
    measured = np.array([pixels([float(line[3]), float(line[4])]) for line in lines])
    enu = np.array([part["points"][line[1]]["coordinates"] for line in lines])
    assert len(lines) > 300
    model = shot(base, image)
    found = model.ground_to_image(east_north_up(part["reference_lla"], enu))
    off = found - measured
    assert np.median(np.hypot(*off.T)) < 1.3
    assert np.abs(np.median(off, axis=0)).max() < 0.2  # half a pixel of another origin would show
    turned = np.array(BERLIN_SIZE) - measured
    assert np.median(np.hypot(*(found - turned).T)) > 300.0


# --- ign-ori-xml ------------------------------------------------------------------------------------------------------


def numbers(text: str, *tags: str) -> list[float]:
    """Values of elements, in the order of the file, read without any reader of XML."""
    return [float(v) for v in re.findall(rf"<(?:{'|'.join(tags)})>\s*([-+.\deE]+)\s*</", text)]


def photo(file: Path, treatment: str = "planar") -> SensorModel:
    row = {"system": "ori", "reconstruction": str(file)}
    options = {"orientation": row, "upwards": True, "treatment": treatment}
    return registry.build("frame", SensorRequest(PHOTO, (1920, 1080), options, LAMBERT))


@pytest.mark.parametrize("name", ["conic", "conic2"])
def test_ign_by_its_own_formulas(real_data: RealData, name: str) -> None:
    """The formulas of the format, written out here: the same pixels to 1e-6."""
    file = real_data("ign-ori-xml") / f"{name}.ori.xml"
    text = file.read_text("latin-1")
    matrix = np.array(numbers(re.findall(r"<mat3d>.*?</mat3d>", text, re.DOTALL)[0], "x", "y", "z")).reshape(3, 3)
    to_ground = polar(matrix)[0]
    assert np.abs(to_ground - matrix).max() < 1e-5
    centre = np.array(numbers(text, "easting", "northing", "altitude"))
    focal = numbers(text, "focale")[0]
    cols, rows = numbers(text, "c"), numbers(text, "l")
    ppa, pps = np.array([cols[0], rows[0]]), np.array([cols[1], rows[1]])
    rng = np.random.default_rng(3)
    camera = np.column_stack([rng.uniform(-0.65, 0.65, 60), rng.uniform(-0.36, 0.36, 60), np.ones(60)])
    ground = centre + (camera * rng.uniform(4.0, 90.0, (60, 1))) @ to_ground.T
    ideal = ppa + focal * camera[:, :2]
    r2 = ((ideal - pps) ** 2).sum(axis=1)
    r3, r5, r7 = numbers(text, "r3", "r5", "r7")
    expected = ideal + (ideal - pps) * (r2 * (r3 + r2 * (r5 + r2 * r7)))[:, None]
    assert np.hypot(*(expected - ideal).T).max() > 5.0  # there is something to get wrong
    model = photo(file)
    assert np.abs(model.ground_to_image(ground) - expected).max() < 1e-6
    assert isinstance(model, HasRays)
    origins, directions = model.rays(expected)
    along = ground - origins
    assert np.abs(along / np.linalg.norm(along, axis=1)[:, None] - directions).max() < 1e-9
    again = registry.plugin("frame").model.from_dict(model.to_dict())
    assert np.array_equal(again.ground_to_image(ground), model.ground_to_image(ground))
    assert program_of(file) == "ori"


def test_ign_quaternion_and_panorama_say_the_same(real_data: RealData) -> None:
    """The same rotation is in the file as a quaternion; and the panorama of the same moment has the photo in front."""
    from scipy.spatial.transform import Rotation

    base = real_data("ign-ori-xml")
    text = (base / "conic.ori.xml").read_text("latin-1")
    model = photo(base / "conic.ori.xml")
    assert isinstance(model, HasRays)
    axis = model.rays(np.array([[960.860, 536.884]]))[1][0]  # the distortion at the principal point is far below 1 px
    quaternion = numbers(re.findall(r"<quaternion>.*?</quaternion>", text, re.DOTALL)[0], "x", "y", "z", "w")
    assert np.abs(Rotation.from_quat(quaternion).as_matrix()[:, 2] - axis).max() < 1e-5
    around = (base / "spheric.ori.xml").read_text("latin-1")
    matrix = np.array(numbers(re.findall(r"<mat3d>.*?</mat3d>", around, re.DOTALL)[0], "x", "y", "z")).reshape(3, 3)
    x, y, z = matrix.T @ axis
    width, height = numbers(around, "width", "height")
    middle = width * (0.5 - math.atan2(y, x) / (2 * math.pi)), height * (0.5 - math.asin(z) / math.pi)
    assert middle == pytest.approx((width / 2, height / 2), abs=0.01)
    with pytest.raises(InputError, match="spherical panorama"):
        photo(base / "spheric.ori.xml")


def test_new_knows_ign(real_data: RealData, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Its files are recognised, and what they say of their map is passed on; a map is not guessed of a name."""
    with rasterio.open(tmp_path / PHOTO, "w", driver="GTiff", width=1920, height=1080, count=1, dtype="uint8"):
        pass
    file = str(real_data("ign-ori-xml") / "conic.ori.xml")
    given = ["new", str(tmp_path / "p.toml"), str(tmp_path / PHOTO), "--sensor", "frame", "--exterior", file]
    assert run([*given, "--json"]) == 0
    made = json.loads(capsys.readouterr().out)
    assert "angle system: ori, by the name and the first lines" in made["recognised"]
    assert any("crs, such as" in text and "the file calls it Lambert93" in text for text in made["needed"])
    assert any("heights" in text and "the file calls it Raf98" in text for text in made["needed"])


def test_the_rigorous_and_the_flat_model_of_ign_see_a_facade_alike(real_data: RealData) -> None:
    """On the curved Earth and in the map, a facade 20 m away is seen alike, but for the scale that heights lack."""
    file = real_data("ign-ori-xml") / "conic.ori.xml"
    rigorous, flat = photo(file, "rigorous"), photo(file)
    assert isinstance(flat, HasRays)
    origins, directions = flat.rays(np.array([[100.0, 100.0], [960.0, 540.0], [1800.0, 1000.0]]))
    ground = origins + 20.0 * directions
    at = rigorous.ground_to_image(Transform(LAMBERT, rigorous.crs)(ground))
    assert 0.01 < np.abs(at - flat.ground_to_image(ground)).max() < 1.0
