"""Four points of oblique photos, and many of distorted ones: good control is drawn, wrong points are still named."""

from __future__ import annotations

from dataclasses import replace

import pytest
from test_70_georeference_diagnostics import few, lens, solved

from geomosaic.georeferencing.fit_diagnostics import BadControlError


@pytest.mark.parametrize(
    ("tilt", "model"), [(0.0, "conformal"), (1e-6, "conformal"), (5e-6, "projective"), (1e-4, "projective")]
)
def test_four_points_of_an_oblique_photo_make_a_projective_fit_that_nothing_checks(tilt: float, model: str) -> None:
    done = solved(few(4, {}, tilt))
    assert done.model == model
    assert ("no-redundancy" in [found.code for found in done.diagnostics]) == (model == "projective")
    assert ("nothing is left to tell" in done.why) == (model == "projective")
    assert done.fit.rms_total < (1e-6 if model == "projective" else 5.0)


def test_four_points_of_which_three_agree_have_a_wrong_one() -> None:
    for index, shift in ((0, (25.0, -8.0)), (1, (12.0, -90.0)), (2, (300.0, -20.0)), (3, (60.0, 10.0))):
        with pytest.raises(BadControlError) as caught:
            solved(few(4, {index: shift}, tilt=0.0))
        assert {name for found in caught.value.diagnostics for name in found.points} == {f"P{index}"}
    assert solved(few(4, {3: (60.0, 10.0)}, tilt=0.0), robust=True).fit.ids == ("P0", "P1", "P2")


def test_four_points_in_another_order_are_not_drawn() -> None:
    """Whatever two of them are exchanged: no photo shows them so."""
    points = few(4, {})
    for first, second in ((0, 1), (0, 2), (0, 3), (1, 2)):
        order = [0, 1, 2, 3]
        order[first], order[second] = second, first
        with pytest.raises(BadControlError):
            solved(replace(points, colrow=points.colrow[order]))


@pytest.mark.parametrize(("barrel", "power"), [pytest.param(0.05, 4, marks=pytest.mark.slow), (0.25, 2)])
def test_good_points_of_a_distorted_photo_are_drawn_and_a_wrong_one_is_still_named(barrel: float, power: int) -> None:
    """Points to the very corners: every kind misses them, and their neighbours with them."""
    points = lens(7, 5, barrel, power)
    told = solved(points).diagnostics
    assert not {"blunder", "contradiction"} & {found.code for found in told}
    wrong = points.colrow.copy()
    wrong[[16, 23]] += [[40.0, -25.0], [-30.0, 30.0]]
    with pytest.raises(BadControlError) as caught:
        solved(replace(points, colrow=wrong))
    assert {name for found in caught.value.diagnostics if found.severity == "error" for name in found.points} == {
        "P16",
        "P23",
    }
    left = solved(replace(points, colrow=wrong), robust=True)
    assert {name for name, state in zip(points.names, left.states, strict=True) if state == "suspect"} == {"P16", "P23"}
