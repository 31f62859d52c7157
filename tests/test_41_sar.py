"""Radar: the sensor 'sar' held against an analytic orbit that shares nothing with it."""

from __future__ import annotations

import json

import numpy as np
import pytest
from sar_rig import Scene, geocentric

from geomosaic.errors import InputError
from geomosaic.sensor.plugin import HasSensorPositions
from geomosaic.sensor.solve import resect_control
from geomosaic.testing import SensorModelTests
from geomosaic_sar.model import SarModel
from geomosaic_sar.orbit import Orbit, StateVectors
from geomosaic_sar.scene import RadarScene
from geomosaic_sar.table import read_table

SCENE = Scene()


def _read(table: dict) -> RadarScene:
    return read_table(json.dumps(table), "scene.radar.json")


def _model(scene: Scene = SCENE, table: dict | None = None, kind: str = "shift") -> SarModel:
    found = _read(table or scene.table())
    return SarModel.of(found.geometry, found.size, kind)


def _ground(scene: Scene = SCENE, count: int = 60) -> np.ndarray:
    """Ground within a scene, at heights of -100 to 3000 m."""
    lon, lat = scene.middle()
    rng = np.random.default_rng(1)
    off = rng.uniform(-0.03, 0.03, (3 * count, 2))
    ground = geocentric(lon + off[:, 0], lat + off[:, 1], rng.uniform(-100, 3000, 3 * count))
    image = scene.image(ground)
    inside = ((image > 0.0) & (image < np.array(scene.size))).all(axis=1)
    return ground[inside][:count]


class TestRightLooking(SensorModelTests):
    @pytest.fixture
    def model(self):
        return _model(kind="drift")

    @pytest.fixture
    def ground(self):
        return _ground(count=40)


class TestLeftLookingInGroundRange(SensorModelTests):
    @pytest.fixture
    def model(self):
        scene = SCENE.left()
        return _model(scene, scene.ground_table()[0])

    @pytest.fixture
    def ground(self):
        return _ground(SCENE.left(), 40)


@pytest.mark.parametrize("scene", [SCENE, SCENE.left()], ids=["right", "left"])
@pytest.mark.parametrize("velocities", [True, False], ids=["Hermite", "Lagrange"])
def test_image_of_ground_is_that_of_the_exact_orbit(scene, velocities):
    ground = _ground(scene)
    found = _model(scene, scene.table(velocities=velocities)).ground_to_image(ground)
    assert np.abs(found - scene.image(ground)).max() < 1e-4  # 0.01 px are asked for


def test_states_a_minute_apart_are_still_enough():
    found = _model(table=SCENE.table(np.arange(-150.0, 151.0, 60.0))).ground_to_image(_ground())
    assert np.abs(found - SCENE.image(_ground())).max() < 1e-4


def test_interpolated_orbit_is_exact_between_states_and_its_mismatch_bounds_the_error():
    times = np.arange(-150.0, 151.0, 30.0)
    between = np.linspace(-149.0, 149.0, 397)
    exact, speed = SCENE.states(between)
    p, v = SCENE.states(times)
    for velocities in (v, None):
        orbit = Orbit.through(StateVectors.checked(times, p, velocities, "test"))
        position, velocity, acceleration = orbit.at(between)
        off = np.linalg.norm(position - exact, axis=1).max()
        assert off < 1e-3
        assert off < orbit.mismatch() < 1.0
        assert np.abs(velocity - speed).max() < 1e-3
        step = 0.5
        by_difference = (orbit.at(between + step)[1] - orbit.at(between - step)[1]) / (2 * step)
        assert np.abs(acceleration - by_difference).max() < 1e-4


def test_columns_over_ground_range_are_lengths_on_the_ground_at_their_azimuth_time():
    table, spacing = SCENE.ground_table()
    ground = _ground()
    slant = SCENE.image(ground)
    times = SCENE.first_row + (slant[:, 1] - 0.5) * SCENE.row_interval
    ranges = SCENE.near + (slant[:, 0] - 0.5) * SCENE.spacing
    origin = SCENE.ground_range(np.array([SCENE.near]), SCENE.first_row)[0]
    length = np.array([SCENE.ground_range(np.array([r]), t)[0] for r, t in zip(ranges, times, strict=True)]) - origin
    found = _model(table=table).ground_to_image(ground)
    assert np.abs(found[:, 0] - (length / spacing + 0.5)).max() < 0.001
    assert np.abs(found[:, 1] - slant[:, 1]).max() < 1e-4


def test_sensor_positions_are_those_of_the_exact_orbit_and_square_to_its_velocity():
    model, ground = _model(), _ground()
    assert isinstance(model, HasSensorPositions)
    found = model.sensor_positions(ground)
    rows = SCENE.image(ground)[:, 1]
    exact, velocity = SCENE.states(SCENE.first_row + (rows - 0.5) * SCENE.row_interval)
    assert np.abs(found - exact).max() < 1e-3
    assert np.abs(np.sum((ground - found) * velocity, axis=1) / 7500.0).max() < 1e-3


def test_points_on_the_other_side_of_the_track_and_behind_the_earth_are_not_seen():
    ground = _ground()
    mirrored = _model(SCENE.left()).ground_to_image(ground)
    assert np.isnan(mirrored).all()
    assert np.isnan(_model().ground_to_image(-ground)).all()


def test_shift_and_drift_come_back_from_control_and_a_blunder_is_named():
    true = np.array([37.0, 0.004, -2.5, 0.0011])
    ground = _ground(count=14)
    # One metre later in range and so many seconds later in time, as the exact orbit has them.
    at = SCENE.image(ground)
    u = (at[:, 1] - SCENE.size[1] / 2) / (SCENE.size[1] / 2)
    measured = at + np.column_stack(
        [(true[0] + true[2] * u) / SCENE.spacing, (true[1] + true[3] * u) / SCENE.row_interval]
    )
    measured[5] += [0.0, 9.0]
    model = _model(kind="drift")
    found = resect_control(model, ground, measured, 0.1, [f"p{k}" for k in range(14)])
    assert [one.id for one in found.left_out] == ["p5"]
    assert np.abs((found.solved.model.parameters.values - true) / model.parameters.steps).max() < 1e-3


@pytest.mark.parametrize("epoch", [86_399.0, 1.7e9])
def test_times_count_from_any_epoch(epoch):
    """Seconds of the day, and since 1970, of which a number has only 7 digits after the point."""
    table, _ = SCENE.ground_table()
    moved = json.loads(json.dumps(table))
    moved["first_row_time"] += epoch
    moved["orbit"]["times"] = [t + epoch for t in moved["orbit"]["times"]]
    for record in moved["ground_range"]["polynomials"]:
        record["time"] += epoch
    found = _model(table=moved).ground_to_image(_ground())
    assert np.abs(found - _model(table=table).ground_to_image(_ground())).max() < 1e-3


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t: t["orbit"].update(times=[x + 50.0 for x in t["orbit"]["times"]]), "orbit is too short"),
        (
            lambda t: t["orbit"]["positions"][3].__setitem__(0, t["orbit"]["positions"][3][0] + 99.0),
            "contradict each other",
        ),
        (lambda t: t["orbit"].update(positions=[[x / 1e3 for x in p] for p in t["orbit"]["positions"]]), "satellite"),
        (lambda t: t["slant_range"].update(near=400_000.0), "does not reach the ground"),
        (lambda t: t["slant_range"].update(near=-1.0), "slant_range, near"),
        (lambda t: t.update(looking="down"), "choose from"),
        (lambda t: t.update(lookng="left"), "did you mean 'looking'"),
        (lambda t: t["orbit"].update({k: v[3:5] for k, v in t["orbit"].items()}), "at least 3 of different times"),
        (lambda t: t.update(size=[800.5, 1000]), "is no size of an image"),
        (lambda t: t.pop("row_interval"), "'row_interval' is missing"),
    ],
)
def test_a_bad_table_is_refused_with_what_to_do(change, message):
    table = SCENE.table()
    change(table)
    with pytest.raises(InputError) as caught:
        _model(table=table)
    assert message in f"{caught.value.what} {caught.value.hint}"
    assert caught.value.hint


def test_velocities_of_an_inertial_frame_are_refused():
    table = SCENE.table()
    positions = np.array(table["orbit"]["positions"])
    table["orbit"]["velocities"] = (
        np.array(table["orbit"]["velocities"]) + np.cross([0, 0, 7.292115e-5], positions)
    ).tolist()
    with pytest.raises(InputError, match="contradict each other"):
        _model(table=table)
