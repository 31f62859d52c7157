"""The panoramic sensor: what textbooks say of scanners comes out of its geometry; parameters are found again."""

from __future__ import annotations

import json
import math
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from pyproj import CRS
from rasterio.errors import NotGeoreferencedWarning
from scipy.spatial.transform import Rotation
from solve_rig import MAP, PLACE, control

from geomosaic.errors import GeomosaicError, GeomosaicWarning, HeightDatumError, InputError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.grid import Grid
from geomosaic.geo.local_frames import LocalFrame, map_place
from geomosaic.geo.transform import Transform
from geomosaic.inputs.declarations import Block
from geomosaic.kernels.warp import Geometry, coordinates
from geomosaic.options.inputs import Area
from geomosaic.options.render import RenderOptions
from geomosaic.products.orthos import make_ortho
from geomosaic.sensor import registry
from geomosaic.sensor.lattice import build
from geomosaic.sensor.map_to_image import BlockGround, MapToImage
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.ray_corrections import refraction_constant
from geomosaic.sensor.solve import image_to_ground, resect
from geomosaic.surface.model import Plane
from geomosaic.testing import SensorModelTests, check_plugin
from geomosaic.types import FloatArray
from geomosaic_panoramic.model import PanoramicModel

SIZE = (1000, 1200)
HEIGHT, GROUND = 3450.0, 450.0

SCANNER: dict[str, Any] = {
    "kind": "scanner", "position": [*PLACE[:2], HEIGHT], "heading": 30.0, "course": 33.0, "pitch": 1.5, "roll": -2.0,
    "rates": [0.002, -0.001, 0.0015], "advance": 4.0, "climb": 0.01, "field_of_view": 90.0, "ground_height": GROUND,
}  # fmt: skip
CAMERA: dict[str, Any] = {
    "kind": "panoramic", "position": [*PLACE[:2], HEIGHT], "heading": 200.0, "pitch": 15.0, "roll": 1.0,
    "advance": 6.0, "field_of_view": 70.0, "focal_length": 609.6, "pixel_size": 0.5, "image_motion": 3.0,
    "columns": "left", "ground_height": GROUND,
}  # fmt: skip
LEVEL: dict[str, Any] = {
    "kind": "scanner", "position": [*PLACE[:2], HEIGHT], "heading": 0.0, "north": "true", "advance": 4.0,
    "field_of_view": 90.0, "ground_height": GROUND,
}  # fmt: skip


def made(options: dict[str, Any], crs: CRS = MAP, size: tuple[int, int] = SIZE) -> PanoramicModel:
    model = registry.build("panoramic", SensorRequest("strip", size, options, crs))
    assert isinstance(model, PanoramicModel)
    return model


def flat(model: PanoramicModel, colrow: FloatArray, below: float) -> FloatArray:
    """Where lines of sight meet a plane `below` the nominal position, east, north, up (N, 3)."""
    origins, directions = model.rays(colrow)
    o, d = model.frame.to_enu(origins), directions @ model.frame.axes.T
    return o + d * ((-below - o[:, 2]) / d[:, 2])[:, None]


BENT: dict[str, Any] = {**SCANNER, "treatment": "planar", "curvature": True, "refraction": True}


@pytest.mark.parametrize("options", [SCANNER, CAMERA, BENT], ids=["scanner", "camera", "bent"])
class TestContract(SensorModelTests):
    @pytest.fixture
    def model(self, options: dict[str, Any]) -> PanoramicModel:
        return made(options)

    @pytest.fixture
    def ground(self, model: PanoramicModel) -> FloatArray:
        return control(model, 20)


def test_the_plugin_passes_the_registry() -> None:
    check_plugin(registry.plugin("panoramic"), SensorRequest("strip", SIZE, SCANNER, MAP))


def test_swath_and_cells_are_those_of_the_textbook() -> None:
    """Swath 2·H·tan(θ/2), a cell β·H·sec² φ across the track."""
    model = made(LEVEL)
    edges = flat(model, np.array([[0.0, 600.0], [1000.0, 600.0]]), HEIGHT - GROUND)
    assert np.hypot(*(edges[1] - edges[0])[:2]) == pytest.approx(
        2.0 * (HEIGHT - GROUND) * math.tan(math.radians(45.0)), rel=1e-9
    )
    beta = math.radians(90.0) / 1000
    for degrees in (0.0, 20.0, 40.0):
        col = 500 + math.radians(degrees) / beta
        ends = flat(model, np.array([[col - 0.5, 600.0], [col + 0.5, 600.0]]), HEIGHT - GROUND)
        across = np.hypot(*(ends[1] - ends[0])[:2])
        assert across == pytest.approx(beta * (HEIGHT - GROUND) / math.cos(math.radians(degrees)) ** 2, rel=2e-6)


def test_tangential_distortion_compresses_the_edges_and_bends_what_runs_aslant() -> None:
    model = made(LEVEL)
    frame, h = model.frame, HEIGHT - GROUND

    def seen(enu: list[list[float]]) -> FloatArray:
        return model.ground_to_image(frame.to_geocentric(np.array(enu)))

    image = seen([[x, 0.0, -h] for x in (-2500.0, -2400.0, 0.0, 100.0)])
    assert image[3, 0] - image[2, 0] > 1.6 * (image[1, 0] - image[0, 0])
    # A straight road aslant becomes an S: its ends leave the chord through its middle to opposite sides.
    aslant = seen([[x, 0.4 * x, -h] for x in (-2500.0, -1250.0, 0.0, 1250.0, 2500.0)])
    bend = aslant[:, 1] - np.interp(aslant[:, 0], aslant[[0, 4], 0], aslant[[0, 4], 1])
    assert bend[1] * bend[3] < 0
    assert abs(bend[1]) > 10
    assert bend[2] == pytest.approx(0.0, abs=1e-6)
    # Along and across the flight nothing bends.
    along = seen([[800.0, y, -h] for y in (-2000.0, 0.0, 2000.0)])
    assert np.ptp(along[:, 0]) < 1e-6


def test_relief_is_displaced_across_the_track_only() -> None:
    model = made(LEVEL)
    foot = np.array([[1200.0, 500.0, -(HEIGHT - GROUND)]])
    top = foot + np.array([0.0, 0.0, 100.0])
    low, high = (model.ground_to_image(model.frame.to_geocentric(place))[0] for place in (foot, top))
    assert high[1] == pytest.approx(low[1], abs=1e-6)
    beta, h = math.radians(90.0) / 1000, HEIGHT - GROUND
    assert high[0] - low[0] == pytest.approx((math.atan2(1200, h - 100) - math.atan2(1200, h)) / beta, abs=1e-6)


def test_lines_follow_the_flight_and_heading_counts_from_the_north_that_was_named() -> None:
    model = made(LEVEL)
    first, second = flat(model, np.array([[500.0, 100.5], [500.0, 101.5]]), HEIGHT - GROUND)
    assert (second - first)[1] == pytest.approx(4.0, abs=1e-9)
    assert (second - first)[0] == pytest.approx(0.0, abs=1e-9)
    grid = made({**LEVEL, "north": "grid"})
    turn = map_place(MAP, *PLACE[:2]).convergence
    assert grid.parameters.values[6] - model.parameters.values[6] == pytest.approx(turn)
    right = flat(model, np.array([[900.0, 600.0]]), HEIGHT - GROUND)[0]
    left = flat(made({**LEVEL, "columns": "left"}), np.array([[900.0, 600.0]]), HEIGHT - GROUND)[0]
    assert right[0] == pytest.approx(-left[0])
    assert right[0] > 2000
    banked = flat(made({**LEVEL, "roll": 5.0}), np.array([[500.0, 600.0]]), HEIGHT - GROUND)[0]
    assert banked[0] == pytest.approx(-(HEIGHT - GROUND) * math.tan(math.radians(5.0)))  # right wing down looks left
    pitched = flat(made({**LEVEL, "pitch": 5.0}), np.array([[500.0, 600.0]]), HEIGHT - GROUND)[0]
    assert pitched[1] == pytest.approx((HEIGHT - GROUND) * math.tan(math.radians(5.0)))  # nose up looks ahead


def test_v_over_h_is_the_advance() -> None:
    rest = {name: value for name, value in LEVEL.items() if name != "advance"}
    assert made({**rest, "v_over_h": 4.0 / 3000.0}).parameters.values[4] == pytest.approx(4.0)


@pytest.mark.parametrize("options", [SCANNER, CAMERA], ids=["scanner", "camera"])
def test_both_ways_agree(options: dict[str, Any]) -> None:
    model = made(options)
    c, r = np.meshgrid(np.linspace(1, SIZE[0] - 1, 9), np.linspace(1, SIZE[1] - 1, 9))
    colrow = np.column_stack([c.ravel(), r.ravel()])
    origins, directions = model.rays(colrow)
    for length in (2500.0, 3400.0):
        assert np.abs(model.ground_to_image(origins + length * directions) - colrow).max() < 1e-7


def test_motion_during_the_sweep_and_its_compensation() -> None:
    still, moving = made({**CAMERA, "advance": 0.0, "image_motion": 0.0}), made({**CAMERA, "image_motion": 0.0})
    ground = flat(still, np.array([[100.0, 600.0], [500.0, 600.0], [900.0, 600.0]]), HEIGHT - GROUND)
    seen = moving.ground_to_image(moving.frame.to_geocentric(ground))
    # Half a sweep before the middle the camera is half the advance behind: the ground lies farther ahead, rows less.
    assert seen[0, 1] < 600 < seen[2, 1]
    assert seen[1, 1] == pytest.approx(600.0, abs=1e-6)
    compensated = made({**CAMERA, "image_motion": 3.0}).ground_to_image(moving.frame.to_geocentric(ground))
    angle = np.radians((seen[:, 0] - 500) * 70.0 / 1000)
    np.testing.assert_allclose(compensated[:, 1] - seen[:, 1], 3.0 * np.sin(angle), atol=1e-9)


@pytest.mark.parametrize("options", [SCANNER, CAMERA], ids=["scanner", "camera"])
def test_position_and_attitude_come_back_from_control(options: dict[str, Any]) -> None:
    truth = made(options)
    ground = control(truth, 25)
    image = truth.ground_to_image(ground)
    free = np.array([0, 1, 2, 6, 7, 8])
    values = truth.parameters.values.copy()
    values[free] += np.array([4.0, -3.0, 5.0, 0.2, -0.1, 0.15])
    priors = np.zeros(len(values))
    priors[free] = np.inf
    solved = resect(truth.with_values(values), ground, image, priors=priors)
    found = solved.model.ground_to_image(ground)
    assert np.abs(found - image).max() < 1e-6
    np.testing.assert_allclose(solved.model.parameters.values[free[:3]], 0.0, atol=1e-4)


def test_ground_of_the_image_is_found_on_a_plane() -> None:
    model = made(SCANNER)
    ground = image_to_ground(model, np.array([[10.0, 10.0], [990.0, 1190.0]]), Plane(MAP, GROUND))
    assert np.isfinite(ground).all()


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"kind": "scaner"}, "did you mean 'scanner'"),
        ({"field_of_view": 190.0}, "field_of_view"),
        ({"advance": 0.0}, "positive advance"),
        ({"v_over_h": 0.1}, "together"),
        ({"focal_length": 100.0}, "no meaning for a scanner"),
        ({"positon": [1, 2, 3]}, "did you mean 'position'"),
        ({"position": [1, 2]}, "not 3 finite numbers"),
        ({"ground_height": 9000.0}, "below ground_height"),
        ({"roll": 170.0}, "sky"),
        ({"columns": "up"}, "right, left"),
    ],
)
def test_what_is_wrong_is_said(change: dict[str, Any], said: str) -> None:
    with pytest.raises(GeomosaicError) as caught:
        made({**SCANNER, **change})
    assert said in str(caught.value)


def test_cells_far_from_square_are_reported() -> None:
    """A field of 90 degrees given in radians: pixels of 8 cm by 4 m."""
    with pytest.warns(GeomosaicWarning, match=r"a pixel is 0\.0\d+ m across and 4 m along .*field_of_view in degrees"):
        made({**SCANNER, "field_of_view": 1.5708})


def test_a_scanner_that_does_not_advance() -> None:
    with pytest.raises(InputError) as caught:
        made({name: value for name, value in SCANNER.items() if name != "advance"})
    assert caught.value.hint == "give advance or v_over_h"


def test_heights_are_declared() -> None:
    with pytest.raises(HeightDatumError):
        made(SCANNER, CRS.from_epsg(32633))
    assert isinstance(made(SCANNER).frame, LocalFrame)


def test_a_strip_becomes_an_ortho_that_shows_the_ground_where_it_is(tmp_path: Path) -> None:
    size = (500, 400)
    options = {**SCANNER, "advance": 12.0, "rates": [0.004, -0.003, 0.006]}
    model = made(options, size=size)
    c, r = np.meshgrid(np.arange(size[0]) + 0.5, np.arange(size[1]) + 0.5)
    ground = image_to_ground(model, np.column_stack([c.ravel(), r.ravel()]), Plane(MAP, GROUND))
    image = np.round(texture(ground[:, 0], ground[:, 1])).astype(np.uint16).reshape(1, size[1], size[0])
    path, out = tmp_path / "strip.tif", tmp_path / "ortho.tif"
    profile = {"driver": "GTiff", "width": size[0], "height": size[1], "count": 1, "dtype": "uint16"}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", NotGeoreferencedWarning)
        with rasterio.open(path, "w", **profile) as dataset:
            dataset.write(image)
    inputs = Block((path,), "panoramic", options=options, crs="EPSG:32633", heights="egm96", height=GROUND)
    made_of = make_ortho(inputs, Area(None, 10.0), out, RenderOptions(resampling="cubic"))
    assert made_of.lattice_error <= 0.02
    with rasterio.open(out) as dataset:
        values, valid, transform = dataset.read(1), dataset.dataset_mask() > 0, dataset.transform
    inner = erosion(valid, 4)
    rows, cols = np.nonzero(inner)
    x, y = transform @ (cols + 0.5, rows + 0.5)
    miss = values[inner] - texture(x, y)
    assert inner.sum() > 100_000
    # The texture changes by up to 45 a metre, pixels are 6 to 19 m: a tenth of a pixel would be 40 and more.
    assert np.sqrt((miss**2).mean()) < 12


def texture(x: FloatArray, y: FloatArray) -> FloatArray:
    waves = np.sin((x - PLACE[0]) / 180.0) + np.cos((y - PLACE[1]) / 150.0 + 1.0)
    return np.asarray(30000 + 6000 * waves)


def erosion(valid: np.ndarray, by: int) -> np.ndarray:
    inner = valid.copy()
    for _ in range(by):
        padded = np.pad(inner, 1)
        inner = padded[1:-1, 1:-1] & padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
    return inner


def test_a_word_that_reads_as_a_boolean_is_a_word() -> None:
    """TOML and the command line take true for a boolean; 'north' takes it for a direction."""
    from geomosaic.errors import SensorInputError
    from geomosaic_panoramic.flight import word

    assert word({"north": True}, "north", ("grid", "true"), "a.tif") == "true"
    with pytest.raises(SensorInputError, match="north = 'false'"):
        word({"north": False}, "north", ("grid", "true"), "a.tif")


@pytest.mark.parametrize("north", ["grid", "true"])
def test_planar_treatment_takes_the_map_for_a_plane(north: str, tmp_path: Path) -> None:
    """The closed form in map coordinates: y is the way, x = H·tan θ, turned by the heading; straight and as a track."""
    place = [680_000.0, 5_400_000.0, HEIGHT]
    turn = map_place(MAP, place[0], place[1]).convergence if north == "true" else 0.0
    heading = math.radians(30.0 - turn)
    rng = np.random.default_rng(2)
    colrow = rng.uniform(0.0, SIZE, (50, 2))
    z = rng.uniform(300.0, 700.0, 50)
    way = (colrow[:, 1] - 600) * 4.0
    aside = (HEIGHT - z) * np.tan(np.radians((colrow[:, 0] - 500) * 0.09))
    x = place[0] + way * math.sin(heading) + aside * math.cos(heading)
    y = place[1] + way * math.cos(heading) - aside * math.sin(heading)
    ground = np.column_stack([x, y, z])
    options = {"kind": "scanner", "north": north, "field_of_view": 90.0, "ground_height": GROUND}
    straight = {**options, "position": place, "heading": 30.0, "advance": 4.0}
    flown = (np.linspace(-700.0, 700.0, 29)[:, None] * 4.0) * [math.sin(heading), math.cos(heading)] + place[:2]
    rows = [f"{i * 50 - 700},{e:.9f},{n:.9f},{HEIGHT},30,0,0" for i, (e, n) in enumerate(flown)]
    (tmp_path / "track.csv").write_text("\n".join(["time,x,y,z,heading,pitch,roll", *rows]))
    track = {**options, "track": str(tmp_path / "track.csv"), "start_time": -600.0, "period": 1.0}
    for given in (straight, track):
        planar = made({**given, "treatment": "planar"})
        assert planar.crs == MAP
        # Along a track the convergence is taken at each place, and changes by some 0.02° over this one.
        exact = 1e-6 if north == "grid" or given is straight else 0.3
        assert np.abs(planar.ground_to_image(ground) - colrow).max() < exact
    rigorous = made(straight)
    away = rigorous.ground_to_image(Transform(MAP, rigorous.crs)(ground)) - colrow
    assert np.abs(away).max() > 0.05


@pytest.mark.parametrize(("given", "constant"), [(True, refraction_constant(HEIGHT, GROUND)), (35.0, 35e-6)])
def test_refraction_shifts_columns_by_its_constant(given: bool | float, constant: float) -> None:
    """A point is seen K·tan α farther from the nadir, K of the standard atmosphere or as given."""
    straight, bent = made(LEVEL), made({**LEVEL, "refraction": given})
    angle = np.radians([-40.0, -10.0, 0.0, 25.0, 44.0])
    enu = np.column_stack([(HEIGHT - GROUND) * np.tan(angle), np.full(5, 200.0), np.full(5, GROUND - HEIGHT)])
    ground = straight.frame.to_geocentric(enu)
    shift = bent.ground_to_image(ground) - straight.ground_to_image(ground)
    np.testing.assert_allclose(shift[:, 0], constant * np.tan(angle) / math.radians(0.09), rtol=1e-3, atol=1e-9)
    assert any(f"{1e6 * constant:.1f} µrad" in note for note in bent.notes)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"treatment": "flat"}, "planar"),
        ({"curvature": True}, "curvature corrects the planar treatment"),
        ({"refraction": 9000.0}, "none of the Earth's atmosphere"),
        ({"refraction": "yes"}, "refraction"),
    ],
)
def test_wrong_treatments_and_corrections_are_refused(options: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError) as error:
        made({**LEVEL, **options})
    assert said in f"{error.value.what} {error.value.hint}"


def optical_bar(direction: str, velocity: FloatArray | None) -> dict[str, Any]:
    """Camera like those of KH-4, tilted forward by 15 degrees, with a principal point aside of the middle."""
    frame = LocalFrame.at(CRS.from_epsg(4979), np.array([14.0, 49.0, 170e3]))
    east, north, up = frame.axes
    camera = {
        "image_size": [110507, 7904], "image_center": [55200.0, 3970.5], "pitch": 7e-6, "f": 0.61, "scan_time": 0.5,
        "forward_tilt": 0.26, "iC": frame.origin,
        "iR": np.column_stack([east, -north, -up]) @ Rotation.from_euler("xyz", [-0.26, 0.01, -0.02]).as_matrix(),
        "speed": 7700.0, "mean_earth_radius": 6371000.0, "mean_surface_elevation": 400.0,
        "motion_compensation_factor": 0.9 if velocity is None else 0.012, "scan_dir": direction,
    }  # fmt: skip
    return camera if velocity is None else {**camera, "velocity": velocity}


def written(camera: dict[str, Any], path: Path) -> Path:
    texts = {k: v if isinstance(v, str) else " ".join(map(repr, np.ravel(v).tolist())) for k, v in camera.items()}
    lines = [f"{name} = {text}" for name, text in texts.items()]
    path.write_text("\n".join(["VERSION_4", "OPTICAL_BAR", *lines, ""]))
    return path


def rays_of_optical_bar(camera: dict[str, Any], colrow: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Equations of the Vision Workbench's OpticalBarModel, pixel by pixel; it counts pixels from their centres."""
    (width, _), focal, pitch = camera["image_size"], camera["f"], camera["pitch"]
    origins, directions = [], []
    for col, row in colrow - 0.5:
        share = col / (width - 1) if camera["scan_dir"] == "right" else (width - 1 - col) / (width - 1)
        x, y = (np.array([col, row]) - camera["image_center"]) * pitch
        alpha = x / focal
        if "velocity" in camera:
            place = camera["iC"] + share * camera["velocity"]
            moved = focal * np.sin(alpha) * camera["motion_compensation_factor"]
        else:
            tilted = camera["iR"] @ Rotation.from_rotvec([camera["forward_tilt"], 0.0, 0.0]).as_matrix()
            place = camera["iC"] + share * camera["scan_time"] * tilted @ [0.0, camera["speed"], 0.0]
            over = np.linalg.norm(place) - camera["mean_surface_elevation"] - camera["mean_earth_radius"]
            rate = (width - 1) * pitch / focal / camera["scan_time"]
            moved = focal * camera["speed"] / (over * rate) * np.sin(alpha) * camera["motion_compensation_factor"]
        y += moved if camera["scan_dir"] == "right" else -moved
        ray = camera["iR"] @ [focal * np.sin(alpha), y, focal * np.cos(alpha)]
        origins.append(place)
        directions.append(ray / np.linalg.norm(ray))
    return np.array(origins), np.array(directions)


@pytest.mark.parametrize("direction", ["right", "left"])
@pytest.mark.parametrize("velocity", [None, np.array([1200.0, -3100.0, 1800.0])], ids=["speed", "velocity"])
def test_an_optical_bar_camera_sees_what_its_equations_say(
    tmp_path: Path, direction: str, velocity: FloatArray | None
) -> None:
    camera = optical_bar(direction, velocity)
    options = {"optical_bar": str(written(camera, tmp_path / "scene.tsai"))}
    model = registry.build("panoramic", SensorRequest("scene", (110507, 7904), options, None))
    colrow = np.stack(np.meshgrid(np.linspace(0.5, 110506.5, 9), np.linspace(0.5, 7903.5, 5)), axis=-1).reshape(-1, 2)
    origins, directions = rays_of_optical_bar(camera, colrow)
    ground = origins + 190e3 * directions
    # By speed the compensation goes with the height over a sphere, which changes by tens of metres during the scan.
    allowed = 1e-6 if velocity is not None else 0.05
    np.testing.assert_allclose(model.ground_to_image(ground), colrow, atol=allowed)
    again = PanoramicModel.from_dict(json.loads(json.dumps(model.to_dict())))
    np.testing.assert_array_equal(again.ground_to_image(ground), model.ground_to_image(ground))
    found, seen = model.rays(colrow)
    np.testing.assert_allclose(found, origins, atol=1e-6)
    np.testing.assert_allclose(seen, directions, atol=allowed * 1.2e-5)


@pytest.mark.parametrize(
    ("change", "options", "said"),
    [
        ({"image_size": [55254, 3952]}, {}, "55254 x 3952 pixels, and this one has 110507 x 7904"),
        ({"f": -0.61}, {}, "f is '-0.61', not above 0"),
        ({"final_pose": [0.0, 0.0, 0.0]}, {}, "final_pose is not known here"),
        ({"iR": np.ones(9)}, {}, "iR is no rotation"),
        ({}, {"heading": 3.0}, "'heading' is given together with optical_bar"),
    ],
)
def test_optical_bar_cameras_that_do_not_fit_are_refused_with_a_way_on(
    tmp_path: Path, change: dict[str, Any], options: dict[str, Any], said: str
) -> None:
    file = written({**optical_bar("right", None), **change}, tmp_path / "scene.tsai")
    with pytest.raises(InputError, match=said) as error:
        made({"optical_bar": str(file), **options}, size=(110507, 7904))
    assert error.value.hint


def turbulent(folder: Path, gusts: float) -> PanoramicModel:
    """Scanner 1350 m above ground whose attitude swings by a few degrees, times `gusts`, within a second or two."""
    seconds = np.arange(-1.0, 25.0, 0.04)
    swings = [
        gusts * most * np.mean([np.sin(2 * np.pi * f * seconds + i + f) for i, f in enumerate(rates)], axis=0)
        for most, rates in ((1.4, (0.2, 0.5, 0.8)), (1.4, (0.4, 0.9, 1.5)), (2.8, (0.3, 0.7, 1.3)))
    ]
    x, y, z = PLACE[0] + 3 * np.sin(seconds / 4), PLACE[1] + 60.0 * (seconds - 12.0), HEIGHT + 2 * np.sin(seconds / 3)
    rows = np.column_stack([seconds, x, y, z, *swings])
    np.savetxt(folder / "track.csv", rows, "%.6f", ",", header="time,x,y,z,heading,pitch,roll", comments="")
    track = {"track": str(folder / "track.csv"), "start_time": 0.0, "period": 0.02, "ground_height": HEIGHT - 1350.0}
    return made({"kind": "scanner", "field_of_view": 60.0, **track})


@pytest.mark.parametrize("gusts", [0.2, 1.0])
def test_ground_that_scans_pass_more_than_once_is_found_on_one_of_them(gusts: float, tmp_path: Path) -> None:
    """In strong gusts the scan turns back over the ground."""
    model = turbulent(tmp_path, gusts)
    seen = np.random.default_rng(4).uniform((1.0, 1.0), (SIZE[0] - 1.0, SIZE[1] - 1.0), (4000, 2))
    ground = model.frame.to_geocentric(flat(model, seen, 1350.0))
    image = model.ground_to_image(ground)
    origins, directions = model.rays(image)
    assert np.linalg.norm(np.cross(ground - origins, directions), axis=1).max() < 1e-5  # metres
    once = np.abs(image - seen).max(axis=1) < 1e-6
    assert once.all() if gusts < 1.0 else 0.2 < once.mean() < 0.9


def test_turbulence_asks_the_sensor_not_much_more_than_once_per_pixel_and_height(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, asked = turbulent(tmp_path, 0.06), []
    original = PanoramicModel.ground_to_image
    monkeypatch.setattr(
        PanoramicModel, "ground_to_image", lambda self, xyz: asked.append(len(xyz)) or original(self, xyz)
    )
    grid = Grid.from_bounds(horizontal(MAP), (PLACE[0] - 64.0, PLACE[1] - 64.0, PLACE[0] + 64.0, PLACE[1] + 64.0), 2.0)
    mapper = MapToImage.between(horizontal(MAP), MAP, model)
    low, high = HEIGHT - 1400.0, HEIGHT - 1300.0
    ground = BlockGround(grid.window, None, (low, high))
    lattices = build(mapper, grid, ground, 0.02)
    assert sum(asked) < 10 * 64 * 64
    assert len(asked) < 60  # few places at a time cost more on the way to the model than by its answer
    assert sum(lattice.window.width * lattice.window.height for lattice in lattices) == 64 * 64
    off = []
    for lattice in lattices:
        window, (cols, rows) = lattice.window, np.empty((2, lattice.window.height, lattice.window.width))
        c, r = np.meshgrid(window.col + np.arange(window.width) + 0.5, window.row + np.arange(window.height) + 0.5)
        xy = grid.xy(np.column_stack([c.ravel(), r.ravel()]))
        for z in (low, 0.7 * low + 0.3 * high):
            places, heights = np.zeros((*lattice.nodes.shape[:2], 2)), np.full((2, 2), z, dtype=np.float32)
            geometry = Geometry(
                lattice.nodes, places, heights, lattice.z_middle, 1 / lattice.z_half, False, lattice.step
            )
            coordinates(geometry, 0, 1, SIZE, np.ones((2, 2), dtype=np.uint8), cols, rows)
            off.append(np.column_stack([cols.ravel(), rows.ravel()]) - mapper.image(xy, np.full(len(xy), z)))
    errors = np.concatenate(off)
    assert np.abs(errors).max() < 0.02
    assert np.abs(errors.mean(axis=0)).max() < 0.0005
