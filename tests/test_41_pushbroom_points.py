"""Scenes of which nothing is reported: the straight flight found again, and a true orbit that it stands in for."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pyproj import CRS
from spot_rig import SIZE, Satellite, with_places

from geomosaic.errors import GeomosaicWarning, InputError, SolveError
from geomosaic.geo.crs import parse_crs, with_heights
from geomosaic.geo.local_frames import LocalFrame
from geomosaic.geo.transform import Transform
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.testing import SensorModelTests, check_plugin
from geomosaic.types import FloatArray
from geomosaic_pushbroom.model import ECEF, PushbroomModel, initial_model
from geomosaic_pushbroom.platform import ADDITIONAL, StraightFlight
from geomosaic_pushbroom.pose import LookDirections

MAP = with_heights(parse_crs("EPSG:32633"), "egm96")
FRAME = LocalFrame.at(MAP, np.array([510_000.0, 5_400_000.0, 300.0]))
STRIP = (1200, 2000)
FOCAL = 2500.0
SATELLITE = Satellite()


def strip(additional: dict[str, float] | None = None) -> PushbroomModel:
    """An airborne strip, 3 km up, 1.5 m per row, looking some degrees aside."""
    start, end = np.array([-300.0, 2_900.0, 2_000.0]), np.array([200.0, 3_050.0, -1_000.0])
    values = np.zeros(17)
    values[:9] = [start[0], start[2], start[1], end[0], end[2], end[1], 4.0, -6.0, -8.0]
    for name, value in (additional or {}).items():
        values[StraightFlight.names.index(name)] = value
    sides = np.array([0.0, STRIP[0]])
    look = LookDirections(sides, (sides - 610.0) / FOCAL, np.zeros(2))
    sigmas = np.where(np.arange(17) < 9, np.inf, [0.0 if additional is None else np.inf] * 17)
    return initial_model(
        StraightFlight(FRAME, STRIP[1], FOCAL), look, STRIP, values, sigmas, 345.0, "strip", crs=FRAME.crs
    )


DISTURBED = dict(zip(ADDITIONAL, (0.4, -0.3, 0.5, 0.1, -0.2, 0.3, 6.0, -9.0), strict=True))


def ground_of(model: PushbroomModel, count: int = 40, relief: float = 500.0, seed: int = 5) -> FloatArray:
    rng = np.random.default_rng(seed)
    origins, directions = model.rays(rng.uniform(0.0, 1.0, (count, 2)) * model.size)
    points: FloatArray = origins + directions * (3000.0 + rng.uniform(-0.5, 0.5, (count, 1)) * relief)
    return points


class TestIdeal(SensorModelTests):
    @pytest.fixture
    def model(self) -> PushbroomModel:
        return strip()

    @pytest.fixture
    def ground(self, model: PushbroomModel) -> FloatArray:
        return ground_of(model)


class TestDisturbed(TestIdeal):
    @pytest.fixture
    def model(self) -> PushbroomModel:
        return strip(DISTURBED)


def request(
    xyz: FloatArray, image: FloatArray, crs: CRS, size: tuple[int, int], sigma: float = 0.3, **options: Any
) -> SensorRequest:
    rows = np.column_stack([xyz, image, np.full(len(xyz), sigma)]).tolist()
    points = [dict(zip(("x", "y", "z", "col", "row", "sigma"), row, strict=True)) for row in rows]
    return SensorRequest("a strip", size, {"points": points, **options}, crs)


def solve(xyz: FloatArray, image: FloatArray, crs: CRS, size: tuple[int, int], **options: Any) -> PushbroomModel:
    model = registry.build("pushbroom", request(xyz, image, crs, size, **options))
    assert isinstance(model, PushbroomModel)
    return model


def test_the_plugin_passes_the_check() -> None:
    truth = strip()
    ground = ground_of(truth, 12)
    xyz = Transform(ECEF, MAP)(ground)
    asked = request(xyz, truth.ground_to_image(ground), MAP, STRIP, focal_length_px=FOCAL, principal_col=600.0)
    check_plugin(registry.plugin("pushbroom"), asked)


def test_the_centre_moves_as_the_published_equation_says() -> None:
    """X of row j is X_A + j/n (X_E − X_A), by plain numbers; A looks at its ground point from da away."""
    model = strip(DISTURBED)
    assert isinstance(model.platform, StraightFlight)
    start, end = model.platform.ends(model.parameters.values)
    origins, _ = model.rays(np.column_stack([np.full(5, 610.0), [0.0, 500.0, 1000.0, 1500.0, 2000.0]]))
    np.testing.assert_allclose(FRAME.to_enu(origins), start + np.linspace(0, 1, 5)[:, None] * (end - start), atol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(start - [-300.0, 2000.0, 0.0]), 2900.0, atol=1e-9)


def test_every_term_does_what_is_said_of_it() -> None:
    """Over flat ground, in pixels: the coordinate a term moves, and by which function of row and column."""
    base, half = strip(), 0.5 * np.array(STRIP)
    c, r = np.meshgrid(np.linspace(0, STRIP[0], 7), np.linspace(0, STRIP[1], 7))
    image = np.column_stack([c.ravel(), r.ravel()])
    v, s = ((image - half) / half).T
    origins, directions = base.rays(image)
    high, down = FRAME.to_enu(origins), directions @ FRAME.axes.T
    ground = FRAME.to_geocentric(high - high[:, 2:] / down[:, 2:] * down)
    for name, coordinate, shape in (
        ("bend", 1, 1.5 * v * v - 0.5), ("stretch", 0, 1.5 * v * v - 0.5), ("kappa1", 1, (v - 10 / 600) * s),
    ):  # fmt: skip
        step = {"bend": 3.0, "stretch": 3.0, "kappa1": 0.1}[name]
        moved = (strip({name: step}).ground_to_image(ground) - base.ground_to_image(ground))[:, coordinate]
        assert abs(np.corrcoef(moved, shape)[0, 1]) > 0.995, name
        # 1.52 m per row against 1.2 m per pixel of the line.
        size = {"bend": 3.0 * 1.2 / 1.52, "stretch": 3.0, "kappa1": np.radians(0.1) * 600 * 1.2 / 1.52}[name]
        assert np.abs(moved).max() == pytest.approx(size, rel=0.12), name


@pytest.mark.parametrize("additional", [None, DISTURBED])
def test_found_again_without_start_values(additional: dict[str, float] | None) -> None:
    """Noise-free points, no start: check points to a millionth of a pixel, A and E to a tenth of a millimetre."""
    truth = strip(additional)
    ground = ground_of(truth, 30)
    image = truth.ground_to_image(ground)
    wanted = "all" if additional else "none"
    camera = {"focal_length_px": FOCAL, "principal_col": 610.0}
    xyz = Transform(ECEF, MAP)(ground)
    # A small sigma of the points: the a-priori sigmas of view and change then pull by next to nothing.
    found = solve(xyz, image, MAP, STRIP, sigma=1e-4, **camera, additional=wanted)
    check = ground_of(truth, 50, seed=6)
    off = found.ground_to_image(check) - truth.ground_to_image(check)
    assert np.abs(off).max() < 1e-6
    assert isinstance(found.platform, StraightFlight)
    assert isinstance(truth.platform, StraightFlight)
    mine = [found.platform.frame.to_geocentric(e[None])[0] for e in found.platform.ends(found.parameters.values)]
    true = [FRAME.to_geocentric(e[None])[0] for e in truth.platform.ends(truth.parameters.values)]
    assert np.abs(np.array(mine) - np.array(true)).max() < 1e-4


@pytest.mark.parametrize("trial", range(2))
def test_a_true_orbit_by_sixteen_points(trial: int) -> None:
    """SPOT-like scene, 800 m of relief, 0.3 px noise: col 0.24 px, row 0.23 px on average of 20 trials."""
    ground, image = SATELLITE.points(16, 800.0, 100 + trial, with_places(16))
    noisy = image + np.random.default_rng(trial).normal(0.0, 0.3, image.shape)
    check, truth = SATELLITE.points(80, 800.0, 9)
    model = solve(ground, noisy, ECEF, SIZE, flying_height=832_000.0)
    rms = np.sqrt(((model.ground_to_image(check) - truth) ** 2).mean(axis=0))
    assert rms[0] < 0.5
    assert rms[1] < 0.35
    assert "omega1" in model.notes[1]


def test_a_true_orbit_without_noise() -> None:
    """What straight path and eight parameters cannot hold: 0.14 px of columns, 0.03 px of rows."""
    ground, image = SATELLITE.points(16, 800.0, 100, with_places(16))
    check, truth = SATELLITE.points(80, 800.0, 9)
    ideal, full = (
        solve(ground, image, ECEF, SIZE, flying_height=832_000.0, additional=words) for words in ("none", "all")
    )
    rms = [np.sqrt(((m.ground_to_image(check) - truth) ** 2).mean(axis=0)) for m in (ideal, full)]
    print(f"col, row RMS: ideal flight {rms[0].round(3)}, additional parameters {rms[1].round(3)}")
    assert (rms[1] < [0.2, 0.06]).all()
    assert (rms[0] > 2 * rms[1]).all()


@pytest.mark.parametrize("options", [{"flying_height": 832_000.0}, {"focal_length_px": 41_551.0}])
def test_height_and_camera_constant_are_one_thing(options: dict[str, float]) -> None:
    ground, image = SATELLITE.points(16, 800.0, 100, with_places(16))
    model = solve(ground, image, ECEF, SIZE, **options)
    assert isinstance(model.platform, StraightFlight)
    assert model.platform.focal == pytest.approx(41_551.0, rel=0.01)
    check, truth = SATELLITE.points(40, 800.0, 9)
    assert np.abs(model.ground_to_image(check) - truth).max() < 0.5


def test_flat_ground_still_gives_a_model() -> None:
    """Without relief the view cannot be told; on that ground it does not matter."""
    ground, image = SATELLITE.points(16, 1.0, 100, with_places(16))
    model = solve(ground, image, ECEF, SIZE, flying_height=832_000.0)
    check, truth = SATELLITE.points(40, 1.0, 9)
    assert np.abs(model.ground_to_image(check) - truth).max() < 0.3


def test_nine_points_keep_to_the_ideal_flight() -> None:
    ground, image = SATELLITE.points(9, 800.0, 100, with_places(9))
    model = solve(ground, image, ECEF, SIZE, flying_height=832_000.0)
    np.testing.assert_array_equal(model.parameters.values[9:], 0.0)
    chosen = solve(ground, image, ECEF, SIZE, flying_height=832_000.0, additional=["phi1", "bend"])
    assert np.count_nonzero(chosen.parameters.values[9:]) == 2


@pytest.mark.parametrize("off", [50.0, pytest.param(-300.0, marks=pytest.mark.slow)])
def test_a_gross_point_is_named(off: float) -> None:
    """A flight bends towards it; the other fifteen say which one it is and by how much it is off."""
    ground, image = SATELLITE.points(16, 800.0, 100, with_places(16))
    image = image + np.random.default_rng(3).normal(0.0, 0.3, image.shape)
    others = np.arange(16) != 5
    alone = solve(ground[others], image[others], ECEF, SIZE, flying_height=832_000.0)
    image[5, 0] += off
    with pytest.warns(GeomosaicWarning, match="1 of 16 .* left out: point '6' is off by"):
        found = solve(ground, image, ECEF, SIZE, flying_height=832_000.0)
    assert found.left_out[0].length == pytest.approx(abs(off), rel=0.1)
    check, _ = SATELLITE.points(40, 800.0, 9)
    np.testing.assert_allclose(found.ground_to_image(check), alone.ground_to_image(check), atol=1e-4)


def test_wrong_input_of_control_points_is_reported() -> None:
    ground, image = SATELLITE.points(16, 800.0, 100, with_places(16))
    good = {"flying_height": 832_000.0}
    for count, options, words in (
        (16, {}, "focal_length_px"),
        (5, good, "5 control points cannot place"),
        (8, good | {"additional": list(ADDITIONAL)}, "too few for 8 additional"),
        (16, good | {"additional": ["omega3"]}, "did you mean 'omega"),
        (16, good | {"additional": 3}, "additional = 3"),
        (16, good | {"refine": "none"}, "refine = none"),
        (16, {"flying_height": -1.0}, "-1 is out of range"),
        (16, good | {"band": 1}, "no meaning"),
    ):
        with pytest.raises(InputError, match="a strip") as told:
            solve(ground[:count], image[:count], ECEF, SIZE, **options)
        assert words in str(told.value)
    line = np.tile(image[:1], (16, 1)) + np.arange(16)[:, None] * [100.0, 50.0]
    with pytest.raises(SolveError, match="on a line"):
        solve(ground, line, ECEF, SIZE, **good)


def test_six_points_that_leave_the_view_open_are_named_with_what_helps() -> None:
    """Over flat ground, or beside a wrong point, the direction of view turns without end."""
    rng = np.random.default_rng(4)
    ground, image = SATELLITE.points(6, 1.0, 104, rng.uniform(0.02, 0.98, (6, 2)) * np.array(SIZE))
    image = image + 0.3 * rng.normal(size=image.shape)
    with pytest.raises(SolveError, match="6 control points do not determine the flight") as told:
        solve(ground, image, ECEF, SIZE, focal_length_px=41_551.0)
    assert "at least 10" in (told.value.hint or "")
    assert "flying_height in place of focal_length_px" in (told.value.hint or "")
    solve(ground, image, ECEF, SIZE, flying_height=832_000.0)
