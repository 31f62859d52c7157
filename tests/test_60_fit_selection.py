"""Point deletion, check points and the choice of the kind of fit."""

from __future__ import annotations

import numpy as np
import pytest
from adjust_rig import CENTRE, SIZE, UTM, builder, fit_control, names, noisy, places, spoil, truth

from geomosaic.errors import InputError, SolveError
from geomosaic.estimation.statistics import total_rms
from geomosaic.orientation.single.check_points import check_errors, check_model
from geomosaic.orientation.single.fit import ControlAdjustment
from geomosaic.orientation.single.model_selection import choose_model, delete_points, planar_problems
from geomosaic.sensor.plugin import SensorRequest


def test_deletion_takes_the_worst_until_the_threshold() -> None:
    xy, colrow = noisy("affine", 20, 1)
    bad = spoil(colrow, 0.2, 1)
    build = builder("affine", xy, colrow)
    whole = fit_control(build, names(20), xy, colrow)
    done = delete_points(ControlAdjustment.of(build, names(20), xy, colrow), 1.0)
    assert done.reached
    assert {row.id for row in done.deleted} >= bad
    assert done.deleted[0].id == whole.ids[int(np.argmax(whole.lengths))]
    assert done.deleted[0].rms_before == pytest.approx(whole.rms_total)
    assert [row.order for row in done.deleted] == list(range(1, len(done.deleted) + 1))
    for one, two in zip(done.deleted, done.deleted[1:], strict=False):
        assert one.rms_after == two.rms_before > 1.0
        assert one.left == two.left + 1
    last = done.deleted[-1]
    assert last.rms_after == pytest.approx(done.fit.rms_total)
    assert done.fit.rms_total < 1.0
    # The table by a fit of one's own to the points left.
    kept = [i for i in range(20) if f"P{i}" in done.kept]
    design = np.column_stack([np.ones(len(kept)), xy[kept] - CENTRE])
    left = colrow[kept] - design @ np.linalg.lstsq(design, colrow[kept], rcond=None)[0]
    assert last.rms_after == pytest.approx(np.sqrt((left**2).sum(axis=1).mean()), rel=1e-6)
    assert np.isfinite(done.fit.leave_one_out).all()
    assert "below 1 px" in done.summary


@pytest.mark.parametrize(("limits", "deleted"), [((2.0, 2.0), ["P7", "P12"]), ((4.0, 2.0), ["P12"]), ((4.0, 4.0), [])])
def test_deletion_by_limits_of_both_axes_takes_what_exceeds_one_of_them(
    limits: tuple[float, float], deleted: list[str]
) -> None:
    """Bellman, Deakin and Rollings take residuals "in both x and y of less than 2 pixels"; a total RMS hides them."""
    xy = places(20, 4)
    colrow = truth("affine", xy) + np.random.default_rng(4).normal(0, 0.1, xy.shape)
    colrow[7] += (3.5, 0.5)
    colrow[12] += (0.2, -3.0)
    problem = ControlAdjustment.of(builder("affine", xy, colrow), names(20), xy, colrow)
    assert not delete_points(problem, 2.0).deleted
    done = delete_points(problem, None, limits)
    assert done.reached
    assert {row.id for row in done.deleted} == set(deleted)
    # Residuals by a fit of one's own.
    kept = [i for i in range(20) if f"P{i}" in done.kept]
    design = np.column_stack([np.ones(len(kept)), xy[kept] - CENTRE])
    left = colrow[kept] - design @ np.linalg.lstsq(design, colrow[kept], rcond=None)[0]
    assert (np.abs(left).max(axis=0) <= limits).all()
    assert f"within {limits[0]:g} and {limits[1]:g} px" in done.summary
    both = delete_points(problem, 0.3, limits)
    assert both.fit.rms_total < 0.3
    assert {row.id for row in both.deleted} == {"P7", "P12"}


@pytest.mark.parametrize(("kind", "least"), [("conformal", 2), ("affine", 3), ("projective", 4), ("poly2", 6)])
def test_deletion_leaves_one_point_more_than_needed(kind: str, least: int) -> None:
    """With noise of half a pixel no five points or so come below 1e-6."""
    xy, colrow = noisy(kind, 12, 2)
    done = delete_points(ControlAdjustment.of(builder(kind, xy, colrow), names(12), xy, colrow), 1e-6)
    assert not done.reached
    assert len(done.kept) == least + 1
    assert "no more can be spared" in done.summary


def test_deletion_of_good_control_deletes_nothing() -> None:
    xy, colrow = noisy("affine", 12, 2)
    done = delete_points(ControlAdjustment.of(builder("affine", xy, colrow), names(12), xy, colrow), 2.0)
    assert done.deleted == ()
    assert done.kept == tuple(names(12))


def test_deletion_needs_residuals_and_a_threshold() -> None:
    xy, colrow = noisy("affine", 12, 2)
    with pytest.raises(SolveError, match="passes through all"):
        delete_points(ControlAdjustment.of(builder("tps", xy, colrow), names(12), xy, colrow), 1.0)
    with pytest.raises(InputError, match="threshold"):
        delete_points(ControlAdjustment.of(builder("affine", xy, colrow), names(12), xy, colrow), 0.0)
    with pytest.raises(InputError, match="threshold of nothing"):
        delete_points(ControlAdjustment.of(builder("affine", xy, colrow), names(12), xy, colrow))


def test_statistics_of_known_errors() -> None:
    errors = np.array([[3.0, 4.0], [-3.0, 4.0], [3.0, -4.0], [-3.0, -4.0]])
    found = check_errors(names(4), errors, "m", survey_rms=12.0)
    assert found.rms == (3.0, 4.0)
    assert found.rms_total == 5.0
    assert found.mean == (0.0, 0.0)
    assert found.nssda == pytest.approx(8.654)
    assert found.circular_error_95 == pytest.approx(2.5 * 5 / np.sqrt(2))
    assert found.rms_with_survey == pytest.approx(13.0)
    assert found.shift_probability == pytest.approx(1.0)
    assert not found.shifted


def test_the_nssda_radius_holds_the_share_it_names() -> None:
    errors = np.random.default_rng(2).normal(0.0, 0.7, (100_000, 2))
    found = check_errors(names(100_000), errors, "m")
    assert (np.hypot(*errors.T) < found.nssda).mean() == pytest.approx(0.95, abs=0.002)


@pytest.mark.parametrize(
    ("count", "nssda", "asprs"), [(19, False, False), (20, True, False), (29, True, False), (30, True, True)]
)
def test_words_only_where_there_are_points_enough(count: int, nssda: bool, asprs: bool) -> None:
    found = check_errors(names(count), np.random.default_rng(count).normal(0.0, 1.0, (count, 2)), "m")
    assert found.nssda_statement.startswith("Tested") == nssda
    assert found.asprs_statement.startswith("Tested") == asprs
    for said, statement in ((nssda, found.nssda_statement), (asprs, found.asprs_statement)):
        assert said or f"there are {count}" in statement


def test_unequal_axes_are_reported() -> None:
    errors = np.random.default_rng(3).normal(0.0, [1.0, 0.2], (40, 2))
    assert "differ too much" in check_errors(names(40), errors, "m").nssda_statement


def test_a_shift_is_distinguished_from_chance() -> None:
    random = np.random.default_rng(5)
    alarms = [check_errors(names(10), random.normal(0.0, 1.0, (10, 2)), "m").shifted for _ in range(1000)]
    assert 0.002 < np.mean(alarms) < 0.02  # alpha is 1 %
    moved = check_errors(names(10), random.normal([2.0, -1.5], 1.0, (10, 2)), "m")
    assert moved.shifted
    assert "the map is shifted by" in moved.shift_statement
    assert moved.mean == pytest.approx((2.0, -1.5), abs=1.0)
    assert "too few" in check_errors(names(3), random.normal(0.0, 1.0, (3, 2)), "m").shift_statement


def test_shift_probability_against_scipy() -> None:
    """In one axis Hotelling's test is Student's: with a second axis that says nothing, nearly so."""
    from scipy.stats import f

    errors = np.random.default_rng(8).normal([0.4, 0.0], 1.0, (15, 2))
    mean, covariance = errors.mean(axis=0), np.cov(errors.T)
    squared = 15 * mean @ np.linalg.inv(covariance) @ mean
    expected = f.sf(squared * 13 / (2 * 14), 2, 13)
    assert check_errors(names(15), errors, "m").shift_probability == pytest.approx(expected, rel=1e-9)


def test_check_points_of_a_model() -> None:
    """Control shifted by 2 m east: the fit hides it, check points show it, with its sign."""
    xy, colrow = noisy("affine", 20, 3)
    wrong = xy + np.array([2.0, 0.0])
    fit = fit_control(builder("affine", wrong, colrow), names(20), wrong, colrow)
    assert fit.rms_total < 1.0
    at, seen = noisy("affine", 25, 9)
    found = check_model(fit.model, names(25), at, seen, "m")
    assert found.shifted
    assert found.mean == pytest.approx((2.0, 0.0), abs=0.2)
    with pytest.raises(InputError, match="no check points"):
        check_model(fit.model, [], at[:0], seen[:0], "m")


CASES = [("conformal", "conformal"), ("affine", "affine"), ("projective", "projective"), ("poly2", "poly2")]


@pytest.mark.parametrize(("kind", "expected"), [*CASES, ("poly3", "poly3"), ("wavy", "tps")])
def test_the_kind_the_photo_has_is_chosen(kind: str, expected: str) -> None:
    for seed in (1, 2):
        xy, colrow = noisy(kind, 40, seed)
        request = SensorRequest("scan", SIZE, {}, UTM)
        choice = choose_model(planar_problems(request, names(40), xy, colrow))
        assert choice.name == expected
        assert choice.summary.startswith(expected)
        assert choice.outliers == ()
        rows = {row.name: row for row in choice.table}
        assert list(rows) == ["conformal", "affine", "projective", "poly2", "poly3", "poly4", "poly5", "tps"]
        alone = fit_control(builder(expected, xy, colrow), names(40), xy, colrow)
        assert rows[expected].leave_one_out == pytest.approx(alone.leave_one_out_rms, rel=1e-9)
        assert rows[expected].fit is choice.fit


def test_richer_kinds_do_not_win_by_chance() -> None:
    """Conformal photos with noise: leave-one-out alone would often prefer a richer kind."""
    plain, chosen = 0, 0
    for seed in range(12):
        xy, colrow = noisy("conformal", 12, seed)
        choice = choose_model(planar_problems(SensorRequest("scan", SIZE, {}, UTM), names(12), xy, colrow))
        errors = [row.leave_one_out for row in choice.table if not row.refused]
        plain += int(np.argmin(errors)) == 0
        chosen += choice.name == "conformal"
    assert chosen >= 11
    assert plain < chosen


def test_the_spline_is_taken_where_it_is_nearer_to_an_uneven_map_than_high_polynomials() -> None:
    """Sums of waves with noise, held against the true map at places that are no control."""
    within = CENTRE + 0.9 * (places(400, 1) - CENTRE)
    nodes = np.stack(np.meshgrid(*[np.linspace(-420.0, 420.0, 6)] * 2), axis=-1).reshape(-1, 2) + CENTRE
    errors: dict[str, list[float]] = {"chosen": [], "tps": [], "poly4": []}
    for seed in (2, 5, 11):
        random = np.random.default_rng([seed, 5])
        pace, start, size = random.normal(size=(2, 40)), random.uniform(0.0, 6.3, 40), random.normal(size=(40, 2))
        xy = nodes + 0.1 * (places(36, seed) - CENTRE)
        both = np.vstack([xy, within])
        exact = truth("affine", both) + 1.1 * np.cos((both - CENTRE) / 300.0 @ pace + start) @ size
        colrow = exact[:36] + random.normal(scale=0.5, size=(36, 2))
        choice = choose_model(planar_problems(SensorRequest("scan", SIZE, {}, UTM), names(36), xy, colrow))
        fits = {row.name: row.fit for row in choice.table} | {"chosen": choice.fit}
        for name, found in errors.items():
            fit = fits[name]
            assert fit is not None
            image = fit.model.ground_to_image(np.column_stack([within, np.zeros(400)]))
            found.append(total_rms(image - exact[36:]))
    assert np.mean(errors["tps"]) < 0.8 * np.mean(errors["poly4"])
    assert np.mean(errors["chosen"]) < 1.1 * np.mean(errors["tps"])


def test_points_exact_but_for_rounding_are_no_outliers() -> None:
    xy, colrow = places(12), truth("affine", places(12))
    colrow[5] += [0.02, -0.03]
    choice = choose_model(planar_problems(SensorRequest("scan", SIZE, {}, UTM), names(12), xy, colrow))
    assert choice.outliers == ()


def test_too_few_points_for_a_choice_of_model() -> None:
    xy, colrow = noisy("affine", 5, 2)
    choice = choose_model(planar_problems(SensorRequest("scan", SIZE, {}, UTM), names(5), xy, colrow))
    assert choice.name in ("conformal", "affine")
    refused = {row.name: row.refused for row in choice.table}
    assert "needs 6" in refused["poly2"]
    xy, colrow = places(2), truth("affine", places(2))
    with pytest.raises(SolveError, match="leave none to choose"):
        choose_model(planar_problems(SensorRequest("scan", SIZE, {}, UTM), names(2), xy, colrow))


def test_a_blunder_does_not_decide_the_kind_and_is_named() -> None:
    xy, colrow = noisy("affine", 24, 7)
    colrow[5] += [300.0, -200.0]
    choice = choose_model(planar_problems(SensorRequest("scan", SIZE, {}, UTM), names(24), xy, colrow))
    assert choice.outliers == ("P5",)
    assert "no kind predicts P5" in choice.summary
