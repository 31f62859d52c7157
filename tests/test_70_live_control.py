"""Control of an image while it is measured: states, words, sub-scenes, and the next point from the first on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from adjust_rig import SIZE, noisy
from solve_rig import ECEF, Level, camera, control

from geomosaic.control.points import ControlPoints
from geomosaic.errors import InputError, SolveError
from geomosaic.georeferencing.live_control import Subscene, live_control, next_control

COUNT = 16


def points(wrong: dict[int, float] | None = None, kind: str = "affine", seed: int = 7) -> ControlPoints:
    xy, colrow = noisy(kind, COUNT, seed, 0.4)
    for number, error in (wrong or {}).items():
        colrow[number, 0] += error
    return ControlPoints.from_arrays(colrow, xy, "EPSG:32633", names=[f"gcp{number:02d}" for number in range(COUNT)])


def test_a_wrong_point_is_named_with_what_it_does_and_what_to_do() -> None:
    found = live_control(points({5: 25.0}), SIZE, "affine")
    (told,) = [one for one in found.diagnostics if one.code == "blunder"]
    assert told.points == ("gcp05",)
    assert "point gcp05 contradicts the others: 2" in told.what
    assert "measure point gcp05 again, or switch it off" in told.hint
    off = live_control(points({5: 25.0}).without(["gcp05"]), SIZE, "affine")
    assert not off.diagnostics
    assert off.states[5] == "off"
    assert off.solution.fit.rms_total == pytest.approx(found.solution.clean_rms)


def test_check_points_judge_and_take_no_part() -> None:
    whole = points()
    checked = replace(whole, roles=tuple("check" if n < 4 else "control" for n in range(COUNT)))
    found = live_control(checked, SIZE, "affine")
    alone = live_control(whole.select([n >= 4 for n in range(COUNT)]), SIZE, "affine")
    assert found.states.count("check") == 4
    assert found.solution.fit.rms_total == alone.solution.fit.rms_total
    assert 0.1 < found.check_rms < 2.0


def test_a_sub_scene_is_fitted_by_its_own_points() -> None:
    """An image that is bent as a whole is nearly affine in a part of it."""
    bent = points(kind="poly2")
    part = Subscene(0.0, 0.0, 1200.0, 2000.0)
    found = live_control(bent, SIZE, "affine", part)
    inside = part.holds(bent.colrow)
    assert [state == "control" for state in found.states] == inside.tolist()
    assert found.states.count("outside") > 3
    whole = live_control(bent, SIZE, "affine")
    assert found.solution.fit.sigma0 < 0.7 * whole.solution.fit.sigma0


def test_few_points_have_no_solution_but_predict() -> None:
    two = points().select([n < 2 for n in range(COUNT)])
    found = live_control(two, SIZE, "poly2")
    assert found.solution is None
    assert found.reason
    np.testing.assert_allclose(
        found.model.ground_to_image(np.column_stack([two.xy, [0.0, 0.0]])), two.colrow, atol=1e-6
    )
    assert live_control(None, SIZE, "affine").reason == "no point is measured yet"


def test_the_next_point_is_told_from_the_first_on() -> None:
    """The image's corners first; each prediction is what the next solution has, up to its scatter."""
    none = next_control(live_control(None, SIZE, "affine"), SIZE, "affine", count=4)
    first = none.grid.colrow.reshape(-1, 2)[none.order.chosen[:3]]
    assert (np.abs(first - 1000.0).max(axis=1) > 800.0).all()
    assert next_control(live_control(points(), SIZE, "affine"), SIZE, "affine").rms < 1.0
    with pytest.raises(SolveError, match="passes through"):
        next_control(live_control(points(), SIZE, "tps"), SIZE, "tps")


def test_a_sensor_model_is_adjusted_as_it_came() -> None:
    model = camera()
    xyz = control(model, 14)
    colrow = model.ground_to_image(xyz) + np.random.default_rng(2).normal(0.0, 0.3, (14, 2))
    measured = ControlPoints.from_arrays(colrow, xyz, ECEF)
    start = model.with_values(model.parameters.values + 10.0 * model.parameters.steps * [1, 1, -1, 1, 1, -1, 0])
    found = live_control(measured, model.size, start)
    assert found.solution.fit.rms_total < 0.6
    np.testing.assert_allclose(found.model.parameters.values[:3], model.parameters.values[:3], atol=2.0)
    advice = next_control(found, model.size, start, Level(450.0), count=3)
    assert 0.0 < advice.predicted[3] < advice.rms < 2.0
    before = next_control(live_control(None, model.size, start), model.size, start, Level(450.0), count=3)
    assert before.predicted[3] < 0.01 * before.rms
    with pytest.raises(InputError, match="has no height"):
        live_control(replace(measured, ground=measured.xy), model.size, start)
