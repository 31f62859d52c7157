"""Fits of control: known parameters, cofactors against brute force, coverage of the sigmas."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from adjust_rig import CENTRE, OPTIONS, SIZE, UTM, builder, fit_control, names, noisy, places, truth

from geomosaic.errors import InputError, SolveError
from geomosaic.estimation.expected_errors import ExpectedErrors, expected_text
from geomosaic.estimation.statistics import total_rms
from geomosaic.orientation.single.fit import ControlAdjustment, cofactors
from geomosaic.orientation.single.problem import registry_build
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.solve import image_to_ground
from geomosaic_planar import spline

LEAST_SQUARES = ["conformal", "affine", "projective", "poly2", "poly3"]


def ground3(xy: np.ndarray) -> np.ndarray:
    return np.column_stack([xy, np.zeros(len(xy))])


@pytest.mark.parametrize("kind", LEAST_SQUARES)
def test_exact_points_give_the_model_back(kind: str) -> None:
    xy = places(40)
    fit = fit_control(builder(kind, xy, truth(kind, xy)), names(40), xy, truth(kind, xy))
    at = places(200, seed=5)
    np.testing.assert_allclose(fit.model.ground_to_image(ground3(at)), truth(kind, at), rtol=0.0, atol=1e-9 * 2000)
    assert fit.rms_total < 1e-9
    assert fit.leave_one_out_rms < 1e-8
    assert fit.redundancy == 80 - len(fit.model.parameters)
    assert not fit.mirrored


@pytest.mark.parametrize("kind", LEAST_SQUARES)
def test_leave_one_out_is_what_refits_give(kind: str) -> None:
    xy, colrow = noisy(kind, 25, 3)
    sigma = np.random.default_rng(4).uniform(0.3, 3.0, 25)
    build = builder(kind, xy, colrow)
    fit = fit_control(build, names(25), xy, colrow, sigma)
    for index in range(25):
        others = np.delete(np.arange(25), index)
        model = build(others, sigma[others])
        error = colrow[index] - model.ground_to_image(ground3(xy[[index]]))[0]
        np.testing.assert_allclose(fit.leave_one_out[index], error, rtol=0.0, atol=1e-7)


def test_closed_form_is_used_where_it_is_exact() -> None:
    """A linear kind and a spline cost one fit; a projective one a fit for each point."""
    calls = []
    xy, colrow = noisy("affine", 20, 1)
    for kind, expected in (("affine", 1), ("projective", 21), ("tps", 1)):
        inner = builder(kind, xy, colrow)

        def build(selection: Any, sigma: Any, inner: Any = inner) -> Any:
            calls.append(len(selection))
            return inner(selection, sigma)

        calls.clear()
        fit_control(build, names(20), xy, colrow)
        assert len(calls) == expected


@pytest.mark.parametrize("kind", LEAST_SQUARES)
def test_redundancy_numbers_are_what_an_error_leaves_in_its_residual(kind: str) -> None:
    """Redundancy number = −∂v/∂(error of the measurement), by moving one coordinate at a time."""
    xy, colrow = noisy(kind, 22, 9)
    sigma = np.random.default_rng(4).uniform(0.3, 3.0, 22)
    fit = fit_control(builder(kind, xy, colrow), names(22), xy, colrow, sigma)
    assert fit.redundancy_numbers.sum() == pytest.approx(fit.redundancy, abs=1e-6)
    for index, axis in ((0, 0), (7, 1), (21, 0)):
        moved = colrow.copy()
        moved[index, axis] += 0.01
        after = fit_control(builder(kind, xy, moved), names(22), xy, moved, sigma, omission=False)
        share = (after.residuals - fit.residuals)[index, axis] / 0.01
        assert share == pytest.approx(fit.redundancy_numbers[index, axis], abs=1e-3)


def test_against_the_general_adjustment() -> None:
    """Covariance and sigma0 of sensor.solve, which knows nothing of normalised coordinates or closed forms."""
    from geomosaic.sensor.solve import fit as general_fit

    xy, colrow = noisy("projective", 30, 2)
    fit = fit_control(builder("projective", xy, colrow), names(30), xy, colrow)
    general = general_fit(fit.model, ground3(xy), colrow)
    assert fit.sigma0 == pytest.approx(general.sigma0, rel=1e-9)
    np.testing.assert_allclose(fit.covariance, general.covariance, rtol=1e-4, atol=1e-12)


def test_map_residuals_are_where_the_pixel_lies_on_the_map() -> None:
    xy, colrow = noisy("projective", 30, 6)
    fit = fit_control(builder("projective", xy, colrow), names(30), xy, colrow)
    on_map = image_to_ground(fit.model, colrow)[:, :2] - xy
    # The derivative stands for the map over a residual of a pixel: its curvature is 1e-4 of that.
    np.testing.assert_allclose(fit.map_residuals, on_map, rtol=0.0, atol=1e-3)
    assert total_rms(fit.map_residuals) == pytest.approx(fit.rms_total * 500.0 / 900.0, rel=0.05)


def test_rms_by_hand() -> None:
    """Two axes, total, and the textbook's 95 % radius from the numbers themselves."""
    xy, colrow = noisy("affine", 12, 8)
    fit = fit_control(builder("affine", xy, colrow), names(12), xy, colrow)
    col, row = fit.residuals.T
    assert fit.rms == pytest.approx((np.sqrt(np.mean(col**2)), np.sqrt(np.mean(row**2))))
    assert fit.rms_total == pytest.approx(np.sqrt(np.mean(col**2) + np.mean(row**2)))
    assert fit.circular_error_95 == pytest.approx(2.5 * np.sqrt((np.mean(col**2) + np.mean(row**2)) / 2))


def test_the_textbook_radius_and_the_rms_hold_the_shares_they_name() -> None:
    """Section 9-3: 40 % within the RMS and 95 % within 2.5 of it; so its RMS is that of one axis."""
    from geomosaic.estimation.statistics import total_rms
    from geomosaic.orientation.single.fit import circular_error_95

    errors = np.random.default_rng(1).normal(0.0, 3.0, (200_000, 2))
    lengths = np.hypot(*errors.T)
    assert (lengths < circular_error_95(errors)).mean() == pytest.approx(0.956, abs=0.002)
    assert (lengths < total_rms(errors) / np.sqrt(2.0)).mean() == pytest.approx(0.393, abs=0.004)


def coverage(trials: int) -> None:
    """Errors of parameters inside 3 computed sigmas, and standardised residuals of variance 1."""
    inside, squares = [], []
    for kind in ("conformal", "affine", "projective"):
        xy = places(60, seed=40)
        exact = fit_control(builder(kind, xy, truth(kind, xy)), names(60), xy, truth(kind, xy), omission=False)
        right = exact.model.parameters.values
        for trial in range(trials):
            colrow = truth(kind, xy) + np.random.default_rng([trial, 7]).normal(0.0, 0.5, (60, 2))
            fit = fit_control(builder(kind, xy, colrow), names(60), xy, colrow, omission=False)
            error = np.abs(fit.model.parameters.values - right)
            inside.append(error < 3.0 * np.sqrt(np.diag(fit.covariance)))
            squares.append(np.mean(fit.standardised**2))
    share = np.concatenate(inside).mean()
    assert share >= 0.99, f"{share:.4f}"
    assert np.mean(squares) == pytest.approx(1.0, abs=0.02)


def test_sigmas_cover_the_errors() -> None:
    coverage(40)


@pytest.mark.slow
def test_sigmas_cover_the_errors_of_many_trials() -> None:
    coverage(300)


def test_a_weak_point_counts_little() -> None:
    xy, colrow = noisy("affine", 15, 2, sigma=0.0)
    colrow[4] += [30.0, -20.0]
    sigma = np.ones(15)
    sigma[4] = 1e4
    fit = fit_control(builder("affine", xy, colrow), names(15), xy, colrow, sigma)
    assert np.delete(fit.lengths, 4).max() < 1e-4
    assert fit.lengths[4] == pytest.approx(np.hypot(30, 20), abs=1e-3)


def test_a_spline_has_leave_one_out_errors_only() -> None:
    xy, colrow = noisy("wavy", 40, 3)
    build = builder("tps", xy, colrow)
    fit = fit_control(build, names(40), xy, colrow)
    assert fit.rms_total < 1e-8
    assert fit.redundancy == 0
    assert np.isnan(fit.sigma0)
    assert np.isnan(fit.standardised).all()
    assert (fit.redundancy_numbers == 0.0).all()
    for index in range(40):  # the closed form against splines through the others
        others = np.delete(np.arange(40), index)
        error = colrow[index] - build(others, np.ones(39)).ground_to_image(ground3(xy[[index]]))[0]
        np.testing.assert_allclose(fit.leave_one_out[index], error, rtol=0.0, atol=1e-7)


def test_cofactors_of_a_spline_are_those_of_its_design_which_is_never_built(monkeypatch: pytest.MonkeyPatch) -> None:
    xy, colrow = noisy("wavy", 30, 3)
    sigma = np.random.default_rng(4).uniform(0.3, 3.0, 30)
    build = builder("tps", xy, colrow)
    decomposed = cofactors(build(np.arange(30), sigma), ground3(xy), sigma)
    sizes, svd = [], np.linalg.svd
    monkeypatch.setattr(np.linalg, "svd", lambda a, *rest, **more: [sizes.append(a.size), svd(a, *rest, **more)][1])
    # Influences of all nodes at all nodes are the identity.
    monkeypatch.setattr(spline, "influence", lambda nodes, uv: pytest.fail("the design was built"))
    solved, inverse = [], np.linalg.inv
    monkeypatch.setattr(np.linalg, "inv", lambda a: [solved.append(len(a)), inverse(a)][1])
    fit = fit_control(build, names(30), xy, colrow, sigma)
    assert max(sizes) <= 3 * 30
    assert solved.count(33) == 1
    assert fit.cofactors.parameters.shape == (60,)
    np.testing.assert_allclose(np.diag(fit.cofactors.parameters), decomposed.parameters, atol=1e-9)
    np.testing.assert_allclose(fit.cofactors.share, decomposed.share, atol=1e-9)
    assert fit.redundancy == decomposed.redundancy == 0


def test_errors_expected_of_a_spline_rest_on_its_leave_one_out_errors() -> None:
    xy, colrow = noisy("wavy", 40, 3)
    fits = [fit_control(builder("tps", xy, seen), names(40), xy, seen) for seen in (colrow, truth("wavy", xy))]
    factors = [fit.variance_factor for fit in fits]
    assert factors[0] == pytest.approx(np.nanmean(fits[0].leave_one_out ** 2))
    assert factors[0] > factors[1]
    alone = fit_control(builder("conformal", xy[:2], colrow[:2]), names(2), xy[:2], colrow[:2])
    assert alone.variance_factor == 1.0


def test_expected_errors_say_what_they_rest_on() -> None:
    places, sigmas = np.random.default_rng(0).uniform(0, 9, (2, 5, 2)), np.ones((2, 5))
    one, both = (["a"], places[:1], sigmas[:1]), (["a", "b"], places, sigmas)
    for given, fits, left_out, basis, words in (
        (one, [(0, 4)], False, "a-priori", "taken to be off by 1 px"),
        (both, [(0, 4), (8, 12)], False, "residuals, a-priori", "where nothing is redundant"),
        (one, [(0, 40)], True, "leave-one-out", "leave-one-out"),
    ):
        facts = ExpectedErrors.of(*given, fits, left_out=left_out).facts
        assert facts["basis"] == basis
        assert words in expected_text(facts)
    shown = ExpectedErrors.of(*both, [(8, 12), (8, 12)]).facts
    assert shown["basis"] == "residuals"
    assert expected_text(shown).endswith("in its middle")


def test_a_spline_of_too_many_nodes_is_refused_before_its_matrix_is_made(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("geomosaic.options.control.MOST_SPLINE_POINTS", 30)
    xy, colrow = noisy("wavy", 31, 3)
    with pytest.raises(SolveError, match="31 control points are too many"):
        fit_control(builder("tps", xy, colrow), names(31), xy, colrow)


def test_a_spline_through_points_that_need_one_of_them() -> None:
    """Without the point beside the line the others determine no spline."""
    xy = np.array([[0.0, 0.0], [100.0, 50.0], [200.0, 100.0], [300.0, 150.0], [0.0, 300.0]]) + CENTRE
    fit = fit_control(builder("tps", xy, truth("affine", xy)), names(5), xy, truth("affine", xy))
    assert np.isnan(fit.leave_one_out[4]).all()
    assert np.abs(fit.leave_one_out[:4]).max() < 1e-6


def test_many_points_hold_the_linearisation(monkeypatch: pytest.MonkeyPatch) -> None:
    from geomosaic.orientation.single import fit as omission

    xy, colrow = noisy("projective", 41, 3)
    closed = fit_control(builder("projective", xy, colrow), names(41), xy, colrow).leave_one_out
    monkeypatch.setattr(omission, "FEW", 41)
    refitted = fit_control(builder("projective", xy, colrow), names(41), xy, colrow).leave_one_out
    difference = np.abs(closed - refitted).max()
    assert 0.0 < difference < 0.002 * np.abs(refitted).max()


def test_refits_of_many_points_are_a_sample(monkeypatch: pytest.MonkeyPatch) -> None:
    """A model that passes through its points and has no closed form."""
    from types import SimpleNamespace

    from geomosaic.orientation.single import fit as omission

    monkeypatch.setattr(omission, "MOST_REFITS", 30)
    monkeypatch.setattr(omission, "SAMPLE", 10)
    count = 40
    xy, colrow = noisy("wavy", count, 3)
    inner = builder("tps", xy, colrow)

    def build(selection: Any, sigma: Any) -> Any:
        model: Any = inner(selection, sigma)
        members = (
            "crs",
            "size",
            "parameters",
            "seed",
            "ground_to_image",
            "jacobian",
            "with_values",
            "to_dict",
            "from_dict",
        )
        return SimpleNamespace(**{name: getattr(model, name) for name in members})

    fit = fit_control(build, names(count), xy, colrow)
    known = np.isfinite(fit.leave_one_out).all(axis=1)
    assert known.sum() == 10
    whole = fit_control(inner, names(count), xy, colrow)
    np.testing.assert_allclose(fit.leave_one_out[known], whole.leave_one_out[known], rtol=0.0, atol=1e-6)


def test_no_redundancy_says_nothing() -> None:
    xy, colrow = noisy("affine", 3, 1)
    fit = fit_control(builder("affine", xy, colrow), names(3), xy, colrow)
    assert fit.redundancy == 0
    assert np.isnan(fit.sigma0)
    assert np.isnan(fit.leave_one_out).all()
    assert np.isnan(fit.leave_one_out_rms)


def test_mirrored_control_is_reported() -> None:
    xy, colrow = noisy("conformal", 12, 1)
    colrow[:, 1] = SIZE[1] - colrow[:, 1]
    fit = fit_control(builder("conformal", xy, colrow), names(12), xy, colrow)
    assert fit.mirrored
    assert fit.rms_total < 1.5


def test_any_sensor_a_frame_camera_on_relief() -> None:
    """Nothing here knows planar models: a camera with six free parameters, fitted by the general resection."""
    from geomosaic.geo.crs import parse_crs, with_heights
    from geomosaic.geo.transform import Transform
    from geomosaic.sensor.registry import build
    from geomosaic.sensor.solve import resect
    from geomosaic.testing.synthetic import CAMERA

    crs = with_heights(parse_crs("EPSG:32633"), "ellipsoidal")
    options = {
        "camera": CAMERA,
        "position": [400_000.0, 5_500_000.0, 2500.0],
        "orientation": {"system": "opk", "omega": 1.0, "phi": -2.0, "kappa": 30.0},
    }
    camera: Any = build("frame", SensorRequest("photo", tuple(CAMERA["size"]), options, crs))
    random = np.random.default_rng(3)
    flat = random.uniform(-400.0, 400.0, (30, 2)) + np.array([400_000.0, 5_500_000.0])
    place = np.column_stack([flat, random.uniform(200.0, 500.0, 30)])
    xyz = Transform(crs, camera.crs)(place)
    colrow = camera.ground_to_image(xyz) + random.normal(0.0, 0.5, (30, 2))

    def refit(selection: Any, sigma: Any) -> Any:
        return resect(camera, xyz[selection], colrow[selection], sigma).model

    fit = fit_control(refit, names(30), xyz, colrow)
    assert fit.redundancy == 60 - 6
    assert fit.rms_total < 1.2
    # A pixel on the ground, in metres east and north.
    on_ground = np.linalg.norm(fit.map_residuals, axis=1) / fit.lengths
    assert (on_ground > 0.01).all()
    assert (on_ground < 5.0).all()
    assert not fit.mirrored


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda xy, cr, s: (xy[:0], cr[:0], s[:0]), "no control points"),
        (lambda xy, cr, s: (np.where(np.arange(9)[:, None] == 4, np.nan, xy), cr, s), "'P4' has a coordinate"),
        (lambda xy, cr, s: (xy, cr, np.where(np.arange(9) == 2, 0.0, s)), "'P2' has a sigma"),
    ],
)
def test_bad_input_is_named(change: Any, says: str) -> None:
    xy, colrow = noisy("affine", 9, 1)
    places_, image, sigma = change(xy, colrow, np.ones(9))
    with pytest.raises(InputError, match=says):
        fit_control(builder("affine", xy, colrow), names(len(places_)), places_, image, sigma)


def test_undetermined_control_is_refused() -> None:
    line = np.linspace(0.0, 400.0, 8)[:, None] * [1.0, 0.5] + CENTRE
    for kind in ("affine", "projective", "poly2", "tps"):
        with pytest.raises(SolveError):
            fit_control(builder(kind, line, truth("affine", line)), names(8), line, truth("affine", line))


def test_a_subset_is_the_problem_of_its_points() -> None:
    xy, colrow = noisy("affine", 12, 5)
    whole = ControlAdjustment.of(builder("affine", xy, colrow), names(12), xy, colrow)
    part = whole.subset(np.arange(12) % 2 == 0).subset(np.arange(6) < 5)
    assert part.ids == ("P0", "P2", "P4", "P6", "P8")
    alone = registry_build("planar", SensorRequest("scan", SIZE, OPTIONS["affine"], UTM), xy[:10:2], colrow[:10:2])
    np.testing.assert_array_equal(part.model().parameters.values, alone(np.arange(5), np.ones(5)).parameters.values)
