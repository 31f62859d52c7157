"""The frame camera: the contract, truth written a second time, and what it says to bad input."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from pyproj import CRS

from geomosaic.errors import HeightDatumError, InputError
from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.geo.engineering_crs import local_frame_crs
from geomosaic.geo.local_frames import LocalFrame, enu_axes
from geomosaic.geo.transform import Transform
from geomosaic.sensor import corrected as state_of
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.solve.newton import difference_jacobian
from geomosaic.testing import SensorModelTests, check_plugin
from geomosaic.testing.synthetic.block import PlainCamera
from geomosaic.types import FloatArray
from geomosaic_frame import plugin
from geomosaic_frame.model import FrameModel

SIZE = (1200, 800)
CAMERA = {
    "size": list(SIZE),
    "focal_length": 24.0,
    "sensor_size": [36.0, 24.0],
    "principal_point": [0.12, -0.2],
    "distortion": {"model": "brown", "k1": -0.12, "k2": 0.06, "k3": -0.01, "p1": 4e-4, "p2": -3e-4},
}
UTM = with_heights(parse_crs("EPSG:32633"), "egm96")
# Far from the central meridian: 1.9° of convergence, and a scale of 1.0004.
POSITION = (690_000.0, 5_300_000.0, 1500.0)
ANGLES = (4.0, -6.0, 130.0)


def options(**changes: Any) -> dict[str, Any]:
    given: dict[str, Any] = {
        "camera": CAMERA,
        "position": list(POSITION),
        "orientation": dict(zip(("omega", "phi", "kappa"), ANGLES, strict=True)) | {"system": "opk"},
        "ground_height": 400.0,
    }
    return {key: value for key, value in (given | changes).items() if value is not None}


def build(crs: CRS | None = UTM, size: tuple[int, int] = SIZE, image: str = "photo 7", **changes: Any) -> FrameModel:
    model = registry.build("frame", SensorRequest(image, size, options(**changes), crs))
    assert isinstance(model, FrameModel)
    return model


def ground_of(model: FrameModel, count: int = 40, near: float = 800.0, far: float = 1300.0) -> FloatArray:
    """Points in front of the camera at uneven distances, inside the image."""
    rng = np.random.default_rng(11)
    origins, directions = model.rays(rng.uniform(0.03, 0.97, (count, 2)) * model.size)
    points: FloatArray = origins + directions * rng.uniform(near, far, (count, 1))
    return points


FISHEYE = {"focal_length_px": 700.0, "distortion": {"model": "fisheye", "k1": 0.02, "k2": -0.004}}


class TestBrown(SensorModelTests):
    @pytest.fixture
    def model(self) -> FrameModel:
        return build()

    @pytest.fixture
    def ground(self, model: FrameModel) -> FloatArray:
        return ground_of(model)


class TestPlanar(TestBrown):
    @pytest.fixture
    def model(self) -> FrameModel:
        return build(treatment="planar")


class TestFisheye(TestBrown):
    @pytest.fixture
    def model(self) -> FrameModel:
        return build(camera=FISHEYE)


class TestCertificate(TestBrown):
    @pytest.fixture
    def model(self) -> FrameModel:
        distortion = {"model": "brown", "convention": "photogrammetric", "k1": 1e-4, "p1": 1e-6}
        return build(camera=CAMERA | {"distortion": distortion})


class TestOblique(TestBrown):
    @pytest.fixture
    def model(self) -> FrameModel:
        gimbal = {"system": "dji", "gimbal_yaw": 75.0, "gimbal_pitch": -50.0, "gimbal_roll": 1.0}
        return build(orientation=gimbal)


def test_the_plugin_passes_the_check() -> None:
    check_plugin(plugin, SensorRequest("an image", SIZE, options(angle_unit="deg"), UTM))


# --- truth ------------------------------------------------------------------------------------------------------------


def test_rigorous_against_a_second_implementation() -> None:
    plain = PlainCamera(CAMERA, UTM, POSITION, ANGLES)
    model = build()
    rng = np.random.default_rng(2)
    xyz = np.column_stack([rng.uniform(-500, 500, (500, 2)) + POSITION[:2], rng.uniform(200, 600, 500)])
    here = model.ground_to_image(Transform(UTM, model.crs)(xyz))
    there = plain.project(xyz)
    assert np.abs(here - there)[(np.abs(there) < 3000).all(axis=1)].max() < 1e-5
    pixels = rng.uniform(0, 1, (50, 2)) * SIZE
    assert np.abs(model.rays(pixels)[1] - plain.rays(pixels)[1]).max() < 1e-8


def test_planar_is_the_collinearity_equation() -> None:
    """Plain scalars, elements of the rotation matrix as textbooks print them."""
    model = build(treatment="planar", camera=CAMERA | {"distortion": {"model": "none"}})
    w, p, k = (math.radians(v) for v in ANGLES)
    cw, sw, cp, sp, ck, sk = math.cos(w), math.sin(w), math.cos(p), math.sin(p), math.cos(k), math.sin(k)
    r11, r12, r13 = cp * ck, -cp * sk, sp
    r21, r22, r23 = cw * sk + sw * sp * ck, cw * ck - sw * sp * sk, -sw * cp
    r31, r32, r33 = sw * sk - cw * sp * ck, sw * ck + cw * sp * sk, cw * cp
    rng = np.random.default_rng(4)
    xyz = np.column_stack([rng.uniform(-600, 600, (50, 2)) + POSITION[:2], rng.uniform(200, 600, 50)])
    image = model.ground_to_image(xyz)
    for point, (col, row) in zip(xyz.tolist(), image.tolist(), strict=True):
        dx, dy, dz = (a - b for a, b in zip(point, POSITION, strict=True))
        depth = r13 * dx + r23 * dy + r33 * dz
        x = 0.12 - 24.0 * (r11 * dx + r21 * dy + r31 * dz) / depth
        y = -0.2 - 24.0 * (r12 * dx + r22 * dy + r32 * dz) / depth
        assert abs(col - (x / 0.03 + 600)) < 1e-8
        assert abs(row - (400 - y / 0.03)) < 1e-8


def test_planar_misses_the_curvature_of_the_earth() -> None:
    """Right below a camera on the central meridian the map is true; at r the Earth has dropped by r² / 2R."""
    here = parse_crs("+proj=tmerc +lon_0=15 +lat_0=48 +k=1 +datum=WGS84 +type=crs").to_3d()
    camera = {"focal_length_px": 10_000.0}
    nadir = {"system": "opk", "omega": 0, "phi": 0, "kappa": 0}
    made = {"camera": camera, "position": [0, 0, 5000.0], "orientation": nadir, "ground_height": 0.0}
    rigorous, planar = (build(here, treatment=t, **made) for t in ("rigorous", "planar"))
    for r in (1000.0, 3000.0, 5000.0):
        xyz = np.array([[r, 0.0, 0.0]])
        true = rigorous.ground_to_image(Transform(here, rigorous.crs)(xyz))
        shift = planar.ground_to_image(xyz)[0, 0] - true[0, 0]
        drop = r**2 / (2 * 6.389e6)  # radius of the prime vertical at 48°
        assert shift == pytest.approx(10_000 * r * drop / 5000**2, rel=0.02)
    assert shift > 3.5


def test_heights_go_through_the_geoid() -> None:
    ellipsoidal = with_heights(parse_crs("EPSG:32633"), "ellipsoidal")
    up = build().centre - build(ellipsoidal).centre
    undulation = Transform(UTM, CRS.from_epsg(4979))(np.array([[*POSITION[:2], 0.0]]))[0, 2]
    assert np.linalg.norm(up) == pytest.approx(undulation, abs=1e-6)
    assert 40 < undulation < 50


def test_grid_and_true_north_differ_by_the_convergence() -> None:
    grid, local = build(), build(angle_frame="local")
    gamma = math.degrees(math.atan(math.tan(math.radians(2.555)) * math.sin(math.radians(47.82))))
    off = grid.rotation @ local.rotation.T
    assert math.degrees(math.acos((np.trace(off) - 1) / 2)) == pytest.approx(gamma, abs=0.03)


@pytest.mark.parametrize("frame", ["grid", "local"])
def test_planar_and_rigorous_treat_the_convergence_alike(frame: str) -> None:
    """Near the camera only the map's scale is between them; the convergence, 1.9°, would be 13 px here."""
    rigorous, planar = (build(angle_frame=frame, treatment=t) for t in ("rigorous", "planar"))
    here = np.array(POSITION)
    xyz = here + np.array([[0, 0, -1000], [300, 0, -1000], [0, 300, -1000], [-300, -300, -1000]])
    off = planar.ground_to_image(xyz) - rigorous.ground_to_image(Transform(UTM, rigorous.crs)(xyz))
    assert np.abs(off).max() < 0.5


def test_position_in_degrees_and_in_geocentric_metres() -> None:
    there = build()
    for code in (4979, 4978):
        crs = CRS.from_epsg(code)
        position = Transform(UTM, crs)(np.array([POSITION]))[0].tolist()
        turned = dict(zip(("omega", "phi", "kappa"), there.parameters.values[3:].tolist(), strict=True))
        same = build(crs, position=position, orientation=turned | {"system": "opk"}, ground_height=440.0)
        assert np.abs(same.ground_to_image(ground_of(there)) - there.ground_to_image(ground_of(there))).max() < 1e-5


def test_linear_alteration_is_undone() -> None:
    plain, corrected = build(), build(scale_correction=True)
    lower = np.linalg.norm(plain.centre) - np.linalg.norm(corrected.centre)
    scale = 0.9996 * math.cosh(190_000 / (0.9996 * 6.385e6))
    assert lower == pytest.approx(1100 * (1 - 1 / scale), rel=0.02)
    assert "linear alteration" in corrected.notes[0]


def test_opensfm_and_angles_agree() -> None:
    """A camera 30 m east and 40 m north of the reference, looking down, image top north."""
    reference = [15.0, 48.0, 300.0]
    shot = {"system": "opensfm", "rotation": [math.pi, 0, 0], "translation": [-30, 40, 100], "reference": reference}
    camera = {"focal_length_px": 1000.0}
    model = build(None, camera=camera, orientation=shot, position=None, ground_height=300.0)
    below = Transform(CRS.from_epsg(4979), model.crs)(np.array([reference]))[0]
    ground = below + np.array([[30, 40, 0], [40, 40, 0], [30, 50, 0]]) @ enu_axes(15.0, 48.0)
    assert np.abs(model.ground_to_image(ground) - [[600, 400], [700, 400], [600, 300]]).max() < 1e-4
    inside = build(UTM, camera=camera, orientation=shot, position=None, ground_height=300.0)
    assert np.linalg.norm(inside.centre - model.centre) == pytest.approx(44.5, abs=2.0)  # the altitude is egm96 then


def test_behind_the_camera_is_nan() -> None:
    model = build()
    origins, directions = model.rays(np.array([[600.0, 400.0], [10.0, 10.0]]))
    for distance in (-1000.0, -1e-3, 0.0):
        assert np.isnan(model.ground_to_image(origins + distance * directions)).all()
    assert np.isfinite(model.ground_to_image(origins + 1e-2 * directions)).all()


def test_no_ghosts_of_the_landscape() -> None:
    """A wide oblique photo of a plain: only what is in front of the lens, inside its field, falls on the image."""
    lens = {"model": "brown", "k1": -0.264, "k2": 0.1019, "k3": -0.0258, "p1": 7e-4, "p2": -3e-4}
    gimbal = {"system": "dji", "gimbal_yaw": 0.0, "gimbal_pitch": -40.0, "gimbal_roll": 0.0}
    model = build(camera={"focal_length_px": 1000.0, "distortion": lens}, orientation=gimbal, treatment="planar")
    x, y = np.meshgrid(np.linspace(-60_000, 60_000, 401), np.linspace(-60_000, 60_000, 401))
    x, y = (np.concatenate([a.ravel(), a.ravel() / 20]) for a in (x, y))
    xyz = np.column_stack([x + POSITION[0], y + POSITION[1], np.full(x.size, 400.0)])
    image = model.ground_to_image(xyz)
    inside = ((image > 0) & (image < SIZE)).all(axis=1)
    ideal = build(camera={"focal_length_px": 1000.0}, orientation=gimbal, treatment="planar").ground_to_image(xyz)
    assert inside.sum() > 100
    assert (np.abs(ideal[inside] - [600, 400]) < [780, 560]).all()


def test_closed_form_derivatives() -> None:
    for changes in ({}, {"camera": FISHEYE}, {"treatment": "planar"}):
        model = build(**changes)
        ground = ground_of(model)
        for exact, measured in zip(model.jacobian(ground), difference_jacobian(model, ground), strict=True):
            scale = np.abs(measured).max(axis=(0, 1))
            assert (np.abs(exact - measured).max(axis=(0, 1)) < 1e-5 * scale).all()


def test_a_photo_can_be_put_at_another_pose_in_another_frame() -> None:
    model = build()
    ground = ground_of(model)
    centre, rotation = model.pose
    local, nowhere = LocalFrame.at(UTM, np.array(POSITION) - (900.0, 700.0, 1200.0)), local_frame_crs()
    # The same scene about a frame without a place: photo and points move together, so the image stays.
    moved = model.posed(local.to_enu(centre), rotation @ local.axes.T, local.to_enu(ground[0]), nowhere)
    assert moved.crs == nowhere
    assert np.abs(moved.ground_to_image(local.to_enu(ground)) - model.ground_to_image(ground)).max() < 1e-6
    back = moved.posed(centre, rotation, ground[0], model.crs)
    assert np.abs(back.parameters.steps / model.parameters.steps - 1.0).max() < 0.5
    assert back.parameters.units == model.parameters.units
    assert np.abs(back.ground_to_image(ground) - model.ground_to_image(ground)).max() < 1e-6
    eastwards = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    level = model.posed(centre, eastwards @ local.axes, centre + 1000.0 * local.axes[0])
    ahead = centre + (1000.0, 300.0, 200.0) * np.array([[1, 0.2, 0.1], [1, -0.3, 0.4]]) @ local.axes
    for exact, measured in zip(level.jacobian(ahead), difference_jacobian(level, ahead), strict=True):
        assert np.isfinite(measured).all()
        assert np.abs(exact - measured).max() < 1e-5 * np.abs(measured).max()
    assert np.linalg.cond(level.jacobian(ahead)[0].reshape(-1, 6)[:, 3:]) < 100.0  # a gimbal lock has none


def test_an_unoriented_photo_knows_its_camera_and_refuses_a_place() -> None:
    model = build(None, unoriented=True, position=None, orientation=None, ground_height=None)
    assert model.crs == local_frame_crs()
    width, height = SIZE
    centre, rotation = model.pose
    assert centre.tolist() == [0.0, 0.0, 0.0]
    assert np.abs(rotation - np.diag([1.0, -1.0, -1.0])).max() < 1e-15
    posed = build()
    pixels = np.array([[10.0, 20.0], [width / 2, height / 2], [width - 5.0, 300.0]])
    assert np.array_equal(model.directions(pixels), posed.directions(pixels))
    for name, value in (("position", list(POSITION)), ("orientation", {"system": "opk"}), ("points", [])):
        with pytest.raises(InputError, match=f"'{name}' is given for a photo that is unoriented"):
            build(**({"unoriented": True, "position": None, "orientation": None} | {name: value}))


def test_state_is_exact_and_keeps_the_crs() -> None:
    for changes in ({"sigmas": {"position": 0.05, "kappa": 0.0}}, {"treatment": "planar"}, {"camera": FISHEYE}):
        model = build(**changes)
        text = json.dumps(state_of.model_to_dict("frame", model), allow_nan=False)
        back = state_of.model_from_dict(json.loads(text))
        assert json.dumps(state_of.model_to_dict("frame", back), allow_nan=False) == text
        ground = ground_of(model)
        assert np.array_equal(back.ground_to_image(ground), model.ground_to_image(ground))
        assert back.crs.to_wkt() == model.crs.to_wkt()
    assert build(sigmas={"position": 0.05, "kappa": 0.0}).parameters.sigmas.tolist() == [0.05] * 3 + [np.inf] * 2 + [
        0.0
    ]


def test_seed_lies_on_the_ground_under_the_centre() -> None:
    for changes in ({}, {"treatment": "planar"}):
        model = build(**changes)
        seed = np.array([model.seed])
        assert np.abs(model.ground_to_image(seed) - [600, 400]).max() < 1e-6
        assert Transform(model.crs, UTM)(seed)[0, 2] == pytest.approx(400.0, abs=1e-3)


def test_a_reduced_copy_scales_the_camera() -> None:
    full, copy = build(), build(size=(400, 267))
    ground = ground_of(full)
    factor = np.array([400, 267]) / SIZE
    assert np.abs(copy.ground_to_image(ground) - full.ground_to_image(ground) * factor).max() < 1e-9
    assert "reduced by 3" in copy.notes[0]
    assert not full.notes


# --- what it says -----------------------------------------------------------------------------------------------------

SKY = {"system": "opk", "omega": 180.0, "phi": 3.0, "kappa": 0.0}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"positon": [0, 0, 0]}, ["has no input 'positon'", "did you mean 'position'"]),
        ({"camera": None}, ["'camera' is missing"]),
        ({"position": None}, ["'position' is missing"]),
        ({"position": [1.0, 2.0]}, ["position has 2 values, not 3"]),
        ({"position": [1e9, 2.0, 3.0], "ground_height": None}, ["has no place", "order"]),
        ({"orientation": None}, ["'orientation' is missing"]),
        ({"orientation": "opk"}, ["not a table"]),
        ({"orientation": SKY}, ["looks at the sky", "86.7° above", "angle_unit", "roll"]),
        ({"angle_unit": "degrees"}, ["angle_unit", "deg"]),
        ({"treatment": "flat"}, ["rigorous, planar"]),
        ({"scale_correction": 1}, ["neither true nor false"]),
        ({"scale_correction": True, "ground_height": None}, ["give ground_height"]),
        ({"scale_correction": True, "treatment": "planar"}, ["planar treatment"]),
        ({"ground_height": 1600.0}, ["at height 1500.00, is not above the ground at 1600.00"]),
        ({"sigmas": {"omega": -1.0}}, ["sigma of omega is negative"]),
        ({"sigmas": {"omga": 1.0}}, ["did you mean 'omega'"]),
        ({"camera": "nowhere.toml"}, ["nowhere.toml): the camera file does not exist"]),
        ({"camera": CAMERA | {"focal": 3.0}}, ["unknown key 'focal'"]),
    ],
)
def test_errors_say_what_where_and_how(changes: dict[str, Any], words: list[str]) -> None:
    given = {**options(), **changes}
    request = SensorRequest("photo 7", SIZE, {k: v for k, v in given.items() if v is not None}, UTM)
    with pytest.raises(InputError) as caught:
        registry.build("frame", request)
    text = str(caught.value)
    assert "photo 7" in text
    for word in words:
        assert word in text


def test_a_turned_photo_is_named() -> None:
    with pytest.raises(InputError, match="EXIF"):
        build(size=(800, 1200))
    with pytest.raises(InputError, match="cropped"):
        build(size=(1200, 700))


def test_heights_without_a_datum_say_what_it_may_cost() -> None:
    with pytest.raises(HeightDatumError) as caught:
        build(parse_crs("EPSG:32633"))
    assert "differ by 43.9 m" in str(caught.value)
    assert "px in the image" in str(caught.value)
    assert "'egm96'" in str(caught.value)


def test_no_crs_and_no_map() -> None:
    with pytest.raises(InputError, match="no CRS"):
        build(None)
    with pytest.raises(InputError, match="needs a map"):
        build(CRS.from_epsg(4979), position=[15, 48, 1500.0], treatment="planar")


def test_camera_from_a_file(tmp_path: Any) -> None:
    (tmp_path / "camera.toml").write_text("focal_length = 24.0\nsensor_size = [36.0, 24.0]\n")
    request = SensorRequest("photo 7", SIZE, options(camera="camera.toml"), UTM, str(tmp_path))
    model = plugin.build(request)
    assert model.camera.focal == pytest.approx((800.0, 800.0))
    (tmp_path / "camera.toml").write_text(f"focal_length = {'[' * 5000}")
    with pytest.raises(InputError, match="the camera file is nested too deeply"):
        plugin.build(request)
