"""Sweeps of several lines, curved flights and orbits: closed forms and published numbers against the geometry."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pyproj import CRS
from solve_rig import MAP, PLACE

from geomosaic.errors import GeomosaicError
from geomosaic.geo.local_frames import LocalFrame, map_place
from geomosaic.geo.transform import Transform
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.solve import image_to_ground
from geomosaic.surface.model import Plane
from geomosaic.testing import SensorModelTests, check_plugin
from geomosaic.types import FloatArray
from geomosaic_panoramic.model import PanoramicModel

HEIGHT, GROUND = 3450.0, 450.0
H = HEIGHT - GROUND
SIZE = (800, 480)
BETA = 60.0 / 800
GAMMA = math.radians(BETA)
SWEEPS: dict[str, Any] = {
    "kind": "sweeps", "position": [*PLACE[:2], HEIGHT], "heading": 0.0, "north": "true", "advance": 16 * GAMMA * H,
    "field_of_view": 60.0, "ground_height": GROUND,
}  # fmt: skip
SPHERE = CRS.from_proj4("+proj=longlat +R=6371000 +type=crs").to_3d()
LANDSAT: dict[str, Any] = {
    "kind": "sweeps", "position": [11.0, 48.0, 705_000.0], "orbit": {"inclination": 98.2, "pass": "descending"},
    "period": 71.46e-3, "field_of_view": 14.9, "columns": "left", "line_angle": math.degrees(42.5e-6),
}  # fmt: skip
"""Rounded public numbers of Landsat's Thematic Mapper."""
KH4B: dict[str, Any] = {
    "kind": "panoramic", "position": [11.0, 48.0, 170_000.0], "orbit": {"inclination": 82.0, "pass": "descending"},
    "period": 0.36, "pitch": 15.0, "field_of_view": 70.0, "focal_length": 609.6, "pixel_size": 0.5,
    "columns": "left",
}  # fmt: skip
"""Public numbers of KH-4B, the film (745 mm by 55.4 mm) scanned coarsely; the time of a sweep is an example."""
KH4B_SIZE = (1490, 111)


def made(options: dict[str, Any], crs: CRS = MAP, size: tuple[int, int] = SIZE, base: str = ".") -> PanoramicModel:
    model = registry.build("panoramic", SensorRequest("strip", size, options, crs, base))
    assert isinstance(model, PanoramicModel)
    return model


def flat(model: PanoramicModel, colrow: FloatArray) -> FloatArray:
    """Where lines of sight meet a plane `H` below the nominal position, east, north, up (N, 3)."""
    origins, directions = model.rays(np.asarray(colrow, dtype=np.float64))
    o, d = model.frame.to_enu(origins), directions @ model.frame.axes.T
    return o + d * ((-H - o[:, 2]) / d[:, 2])[:, None]


def table_of(tmp_path: Path, rows: FloatArray) -> str:
    text = "time,x,y,z,heading,pitch,roll\n" + "\n".join(",".join(f"{v:.9f}" for v in row) for row in rows)
    (tmp_path / "track.csv").write_text(text)
    return "track.csv"


def circle(seconds: FloatArray, radius: float, speed: float) -> FloatArray:
    """A level turn to the right about a centre `radius` east of the place, heading north at time 0; grid headings."""
    angle = speed / radius * seconds
    x, y = PLACE[0] + radius * (1 - np.cos(angle)), PLACE[1] + radius * np.sin(angle)
    zero = np.zeros_like(seconds)
    return np.column_stack([seconds, x, y, zero + HEIGHT, np.degrees(angle), zero, zero + 3.0])


@pytest.fixture
def model(request: pytest.FixtureRequest, tmp_path: Path) -> PanoramicModel:
    if request.param == "sweeps":
        narrow = {"field_of_view": 10.0, "advance": 16 * GAMMA / 6 * H}  # little bow tie: the kit asks for smoothness
        return made({**SWEEPS, **narrow, "pitch": 1.0, "roll": -2.0, "image_motion": 15.0})
    if request.param == "orbit":
        return made(LANDSAT, CRS.from_epsg(4979), (6320, 5984))
    if request.param == "kh4b":
        return made(KH4B, CRS.from_epsg(4979), KH4B_SIZE)
    rows = circle(np.linspace(-10.0, 10.0, 41), 4000.0, 60.0)
    options = {"kind": "scanner", "field_of_view": 60.0, "ground_height": GROUND, "start_time": -8.0, "period": 1 / 30}
    return made({**options, "track": table_of(tmp_path, rows)}, base=str(tmp_path))


@pytest.mark.parametrize("model", ["sweeps", "orbit", "kh4b", "turn"], indirect=True)
class TestContract(SensorModelTests):
    @pytest.fixture
    def ground(self, model: PanoramicModel) -> FloatArray:
        rng = np.random.default_rng(3)
        w, h = model.size
        colrow = rng.uniform([0.02 * w, 0.05 * h], [0.98 * w, 0.95 * h], (24, 2))
        if model.scan.kind == "sweeps":  # away from where one sweep takes over from the next
            n = model.scan.sweeps.lines
            colrow[:, 1] = np.floor(colrow[:, 1] / n) * n + rng.uniform(0.3, 0.7, 24) * n
        origins, directions = model.rays(colrow)
        down = -(directions * model.frame.axes[2]).sum(axis=1)
        above = float(np.linalg.norm(model.frame.origin)) - 6.37e6  # roughly; of an aircraft it is known
        length = (above if above > 1e5 else H) * rng.uniform(0.95, 1.0, 24) / down
        return origins + directions * length[:, None]

    def test_rays_agree_with_the_general_inverse(self, model: PanoramicModel, ground: FloatArray) -> None:
        if model.scan.kind != "sweeps":  # the jump between sweeps is more than a search by derivatives passes
            super().test_rays_agree_with_the_general_inverse(model, ground)


def test_the_plugin_takes_sweeps_and_orbits() -> None:
    plugin = registry.plugin("panoramic")
    check_plugin(plugin, SensorRequest("strip", SIZE, SWEEPS, MAP))
    check_plugin(plugin, SensorRequest("strip", (6320, 5984), LANDSAT, CRS.from_epsg(4979)))


def test_bow_tie_is_that_of_the_closed_form() -> None:
    """Lines of a sweep cover n·γ·H·sec θ: at the advance n·γ·H sweeps touch below the scanner and overlap aside."""
    strip = made(SWEEPS)
    for degrees in (0.0, 15.0, 29.0):
        col = 400 + degrees / BETA
        low, high, next_low = flat(strip, np.array([[col, 160.0], [col, 176.0 - 1e-9], [col, 176.0]]))
        across = 16 * GAMMA * H / math.cos(math.radians(degrees))
        # 8 lines of γ each side: the rows are even on the cylinder's tangent, f·tan ψ.
        assert high[1] - low[1] == pytest.approx(across, rel=1e-7)
        overlap = high[1] - next_low[1]
        drift = 16 * GAMMA * H  # of the scanner from one sweep to the next
        assert overlap == pytest.approx(across - drift, abs=1e-4)


def test_a_place_in_the_overlap_is_given_to_the_nearer_sweep_and_both_ways_agree() -> None:
    strip = made({**SWEEPS, "directions": "both", "active": 0.85, "image_motion": 13.6})
    c, r = np.meshgrid(np.linspace(1, 799, 15), np.arange(480) + 0.5)
    colrow = np.column_stack([c.ravel(), r.ravel()])
    ground = strip.frame.to_geocentric(flat(strip, colrow))
    back = strip.ground_to_image(ground)
    within = np.abs(colrow[:, 1] % 16 - 8)
    secant = 1 / np.cos((colrow[:, 0] - 400) * GAMMA)
    # Nearer to the middle of its own sweep than to that of the next; the corrector is too much by sec θ aside.
    turned = 0.85 * 16 * (1 - 1 / secant) / 2
    sure = within < 8 / secant - turned - 0.01
    assert sure.mean() > 0.7
    assert np.abs(back - colrow)[sure].max() < 1e-7
    assert np.abs(back - colrow)[:, 1].max() < 16 * (1 / math.cos(math.radians(30.0)) - 1) + 2 * turned.max() + 0.01


def test_lines_zigzag_without_a_corrector_and_run_straight_with_it() -> None:
    """Uncorrected, a sweep moves on by active·advance while it crosses; every other one runs the other way."""
    plain = made({**SWEEPS, "directions": "both", "active": 0.85})
    ends = np.array([[0.0, 8.0], [800.0, 8.0], [0.0, 24.0], [800.0, 24.0]])
    ground = flat(plain, ends)
    way = 0.85 * SWEEPS["advance"]
    assert ground[1, 1] - ground[0, 1] == pytest.approx(way, rel=1e-9)
    assert ground[3, 1] - ground[2, 1] == pytest.approx(-way, rel=1e-9)
    # The corrector turns the view by an angle, so that it is exact below the scanner and too much by sec θ aside.
    turned = made({**SWEEPS, "directions": "both", "active": 0.85, "image_motion": 0.85 * 16})
    near = np.array([[399.0, 8.0], [401.0, 8.0], [399.0, 24.0], [401.0, 24.0]])
    north = flat(turned, near)[:, 1]
    assert abs(north[1] - north[0]) < 1e-4
    assert abs(north[3] - north[2]) < 1e-4


@pytest.mark.parametrize(("latitude", "direction"), [(0.0, "descending"), (48.0, "descending"), (-30.0, "ascending")])
def test_skew_by_the_turning_earth_is_that_of_the_closed_form(latitude: float, direction: str) -> None:
    """On a sphere the ground track leaves the inertial direction by atan(vₑ cos α / (v − vₑ sin α)).

    v is the speed of the point below the satellite, vₑ = ω·R·cos φ that of the ground to the east, α the azimuth.
    """
    options = {**LANDSAT, "position": [11.0, latitude, 705_000.0]}
    options["orbit"] = {"inclination": 98.2, "pass": direction}
    strip = made(options, SPHERE, (6320, 5984))
    middle = np.array([[3160.0, 2992.0 - 160.0], [3160.0, 2992.0 + 160.0], [3150.0, 2984.0], [3170.0, 2984.0]])
    ground = image_to_ground(strip, middle, Plane(SPHERE, 0.0))
    x, y = np.radians(ground[:, 0]) * math.cos(math.radians(latitude)), np.radians(ground[:, 1])
    along, across = np.array([x[1] - x[0], y[1] - y[0]]), np.array([x[3] - x[2], y[3] - y[2]])
    azimuth = math.asin(math.cos(math.radians(98.2)) / math.cos(math.radians(latitude)))
    azimuth = azimuth if direction == "ascending" else math.pi - azimuth
    radius = 6_371_000.0
    v = math.sqrt(3.986004418e14 / (radius + 705_000.0) ** 3) * radius
    ve = 7.292115e-5 * radius * math.cos(math.radians(latitude))
    track = math.atan2(v * math.sin(azimuth) - ve, v * math.cos(azimuth))
    assert math.atan2(*along) == pytest.approx(track, abs=2e-5)
    skew = math.atan2(ve * math.cos(azimuth), v - ve * math.sin(azimuth))
    assert math.degrees(abs(skew)) > 1.5
    # The line of scan is at a right angle to the inertial motion, but for the way during its own sweep.
    line = math.atan2(across[0], across[1])
    scanned = 0.0034  # the way of 20 columns' share of a sweep against 20 columns
    assert abs(math.remainder(line - azimuth - math.pi / 2, math.pi)) < 2 * scanned


def test_swath_and_pixels_of_landsat_are_those_that_are_published() -> None:
    strip = made(LANDSAT, CRS.from_epsg(4979), (6320, 5984))
    ends = image_to_ground(strip, np.array([[0.0, 2984.0], [6320.0, 2984.0]]), Plane(CRS.from_epsg(4979), 0.0))
    from pyproj import Geod

    length = Geod(ellps="WGS84").inv(*ends[0, :2], *ends[1, :2])[2]
    assert length == pytest.approx(185_000.0, rel=0.01)
    two = image_to_ground(strip, np.array([[3160.0, 2976.0], [3160.0, 2992.0]]), Plane(CRS.from_epsg(4979), 0.0))
    assert Geod(ellps="WGS84").inv(*two[0, :2], *two[1, :2])[2] / 16 == pytest.approx(30.0, rel=0.03)


def test_corona_sweeps_the_ground_that_is_published_and_its_compensation_holds_the_image_still() -> None:
    """f·V/H image motion: without compensation a place moves by the way of the camera during the sweep, cos θ aside."""
    ellipsoid = CRS.from_epsg(4979)
    photo = made({**KH4B, "pitch": 0.0}, ellipsoid, KH4B_SIZE)
    ends = np.array([[0.0, 55.5], [1490.0, 55.5], [745.0, 0.0], [745.0, 111.0]])
    ground = image_to_ground(photo, ends, Plane(ellipsoid, 0.0))
    from pyproj import Geod

    across = Geod(ellps="WGS84").inv(*ground[0, :2], *ground[1, :2])[2]
    along = Geod(ellps="WGS84").inv(*ground[2, :2], *ground[3, :2])[2]
    # 2·H·tan(θ/2) is 238 km over a plane; the Earth curves away, and the sweep grows.
    sphere = 6_378_000.0
    sight = math.radians(35.0)
    arc = math.asin((sphere + 170_000.0) / sphere * math.sin(sight)) - sight
    assert across == pytest.approx(2 * sphere * arc, rel=0.005)
    assert along == pytest.approx(170_000.0 * 55.5 / 609.6, rel=0.005)
    # One degree of scan takes 0.36 s / 70. The speed over ground in the image is f·V/H.
    place = image_to_ground(photo, np.array([[745.0, 55.5]]), Plane(ellipsoid, 0.0))
    xyz = Transform(ellipsoid, photo.crs)(place)
    flight, tau = photo.track, np.array([-1e-3, 1e-3])
    forward, right, down = flight.to_body(photo._enu(np.repeat(xyz, 2, axis=0)), tau)
    rate = -(np.diff(forward / np.hypot(right, down))[0] / 2e-3) * 1219.2
    # Circular speed, less what the Earth turns under an orbit of 82 degrees; and the nose stays level with the ground.
    angular = math.sqrt(3.986004418e14 / 6_536_000.0**3)
    speed = angular * 6_366_000.0
    assert rate * 0.5 / 0.36 == pytest.approx(609.6 * speed / 170_000.0, rel=0.02)


def test_a_turn_is_followed(tmp_path: Path) -> None:
    """In a level turn with the roll of 3° each line looks along the radius, to H·tan 3° from the circle."""
    rows = circle(np.linspace(-10.0, 10.0, 41), 4000.0, 60.0)
    options: dict[str, Any] = {"kind": "scanner", "field_of_view": 60.0, "ground_height": GROUND}
    options |= {"track": table_of(tmp_path, rows), "start_time": -8.0, "period": 1 / 30}
    strip = made(options, base=str(tmp_path))
    cols, lines = np.array([400.0, 100.0, 700.0] * 3), np.repeat([30.0, 240.0, 450.0], 3)
    ground = image_to_ground(strip, np.column_stack([cols, lines]), Plane(MAP, GROUND))
    seconds = -8.0 + lines / 30
    angle = 60.0 / 4000.0 * seconds
    tilt = np.radians((cols - 400) * BETA - 3.0)
    k = map_place(MAP, *PLACE[:2]).scale
    distance = 4000.0 - k * H * np.tan(tilt)
    x, y = PLACE[0] + 4000.0 - distance * np.cos(angle), PLACE[1] + distance * np.sin(angle)
    # Curvature and the normals at the ends of the line of sight: centimetres.
    assert np.abs(ground[:, 0] - x).max() < 0.4
    assert np.abs(ground[:, 1] - y).max() < 0.4
    straight = made({**SWEEPS, "kind": "scanner", "advance": 2.0})
    assert isinstance(straight.frame, LocalFrame)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"active": 1.5}, "share above 0"),
        ({"lines_per_sweep": 2.5}, "whole number"),
        ({"directions": "two"}, "choose from: one, both"),
        ({"line_angle": -1.0}, "degrees above 0"),
        ({"track": "none.csv"}, "together with 'track'"),
        ({"orbit": {"inclination": 98.0}}, "together with 'orbit'"),
        ({"period": 1.0}, "needs a track or an orbit"),
        ({"height_above_ground": 10.0}, "without relative"),
        ({"relative": 1}, "true or false"),
        ({"relative": True}, "together with relative"),
    ],
)
def test_what_is_wrong_is_said(change: dict[str, Any], said: str) -> None:
    with pytest.raises(GeomosaicError) as caught:
        made({**SWEEPS, **change})
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"orbit": {"inclination": 30.0, "pass": "descending"}}, "does not reach the latitude"),
        ({"orbit": {"inclination": 98.0, "pass": "down"}}, "choose from: ascending, descending"),
        ({"orbit": {"inclinaton": 98.0, "pass": "descending"}}, "did you mean 'inclination'"),
        ({"orbit": 98.0}, "no table"),
        ({"period": 0.0}, "seconds of one"),
        ({"heading": 3.0}, "together with 'orbit'"),
    ],
)
def test_what_is_wrong_with_an_orbit_is_said(change: dict[str, Any], said: str) -> None:
    with pytest.raises(GeomosaicError) as caught:
        made({**LANDSAT, **change}, CRS.from_epsg(4979))
    assert said in str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("time,x,y,z,heading,pitch\n", "no column roll"),
        ("time,x,y,z,heading,pitch,roll\n0,1,2,3,4,5,x\n", "not whole"),
        ("time,x,y,z,heading,pitch,roll\n1,1,2,3,4,5,6\n0,1,2,3,4,5,6\n", "times of the track"),
        ("time,x,y,z,heading,pitch,roll\n0,512000,5404000,3450,4,5,6\n1,512000,5404010,3450,4,5,6\n", "covers"),
    ],
)
def test_what_is_wrong_with_a_track_is_said(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "track.csv").write_text(text)
    options = {"kind": "scanner", "field_of_view": 60.0, "track": "track.csv", "start_time": 0.0, "period": 1.0}
    with pytest.raises(GeomosaicError) as caught:
        made(options, base=str(tmp_path))
    assert said in str(caught.value)
