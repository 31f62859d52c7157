"""Plane transformations: known coefficients, independent solutions, Table 9-1 of Wolf & Dewitt's text."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from affine import Affine
from pyproj import CRS

from geomosaic.errors import InputError, SolveError
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.solve import fit, image_to_ground
from geomosaic.testing import SensorModelTests, check_plugin
from geomosaic_planar import PlanarModel, Transformation, fit_planar, plugin

UTM = CRS.from_epsg(32633)
SIZE = (6000, 4000)
TRUE_TRANSFORM = Affine(0.35, 0.21, 512_300.0, 0.21, -0.35, 5_403_800.0)  # turned by 31 degrees
LEAST_SQUARES = [("conformal", 1), ("affine", 1), ("projective", 1), *(("polynomial", n) for n in range(1, 6))]
KINDS = [*LEAST_SQUARES, ("tps", 1)]


def scattered(count: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """Map and image positions of one affine photo, away from any symmetry."""
    rng = np.random.default_rng(7)
    colrow = rng.uniform([0.0, 0.0], SIZE, (count, 2))
    t = TRUE_TRANSFORM
    xy = colrow @ np.array([[t.a, t.d], [t.b, t.e]]) + [t.c, t.f]
    return xy, colrow


def bent(kind: str, order: int, xy: np.ndarray, colrow: np.ndarray) -> PlanarModel:
    """A model of one kind with all coefficients away from zero."""
    if kind == "tps":
        wave = 40.0 * np.sin(colrow[:20, ::-1] / 700.0 + [0.3, 1.1])
        return PlanarModel.of(fit_planar("tps", xy[:20], colrow[:20] + wave), UTM, SIZE)
    start = fit_planar(kind, xy, colrow, order=order)
    model = PlanarModel.of(start, UTM, SIZE)
    if kind in ("conformal", "affine"):
        return model
    turns = np.where(np.arange(len(start.values)) % 2, 1.0, -0.7)
    if kind == "projective":
        return model.with_values(start.values + 0.1 * turns * (np.arange(8) > 5))
    return model.with_values(start.values + 20.0 * turns)


def ground3(xy: np.ndarray) -> np.ndarray:
    return np.column_stack([xy, np.zeros(len(xy))])


@pytest.mark.parametrize(("kind", "order"), KINDS)
class TestContract(SensorModelTests):
    @pytest.fixture
    def model(self, kind: str, order: int) -> PlanarModel:
        return bent(kind, order, *scattered())

    @pytest.fixture
    def ground(self, model: PlanarModel) -> np.ndarray:
        points = ground3(scattered()[0])
        image = model.ground_to_image(points)
        return points[((image > 0.0) & (image < SIZE)).all(axis=1)]


def test_the_plugin_passes_the_check() -> None:
    check_plugin(plugin, SensorRequest("an image", SIZE, {"transform": TRUE_TRANSFORM}, UTM))
    assert registry.plugin("planar") is plugin


@pytest.mark.parametrize(("kind", "order"), LEAST_SQUARES)
def test_known_coefficients_come_back(kind: str, order: int) -> None:
    xy, colrow = scattered()
    truth = bent(kind, order, xy, colrow)
    solved = fit_planar(kind, xy, truth.ground_to_image(ground3(xy)), order=order)
    np.testing.assert_array_equal(solved.centre, truth.transformation.centre)
    np.testing.assert_allclose(solved.values, truth.transformation.values, rtol=1e-9, atol=1e-9)
    assert np.abs(solved.residuals).max() < 1e-8
    assert solved.condition < 1e5


@pytest.mark.parametrize(("kind", "order"), LEAST_SQUARES)
def test_general_adjustment_agrees_on_noisy_points(kind: str, order: int) -> None:
    xy, colrow = scattered()
    truth = bent(kind, order, xy, colrow)
    noisy = truth.ground_to_image(ground3(xy)) + np.random.default_rng(3).normal(0.0, 0.5, xy.shape)
    solved = fit_planar(kind, xy, noisy, order=order)
    general = fit(truth, ground3(xy), noisy)
    np.testing.assert_allclose(general.model.transformation.values, solved.values, rtol=1e-7, atol=1e-6)
    np.testing.assert_allclose(general.residuals, solved.residuals, atol=1e-6)
    np.testing.assert_allclose(general.covariance, solved.covariance, rtol=1e-4, atol=1e-9)
    assert general.sigma0 == pytest.approx(solved.sigma0, rel=1e-9)


@pytest.mark.parametrize("order", [1, 2, 3, 4, 5])
def test_polynomial_against_numpy(order: int) -> None:
    """An independent design: Chebyshev products in their own normalisation, numpy.linalg.lstsq."""
    xy, colrow = scattered()
    noisy = colrow + np.random.default_rng(5).normal(0.0, 2.0, colrow.shape)
    weights = np.random.default_rng(6).uniform(0.3, 3.0, len(xy))
    solved = fit_planar("polynomial", xy, noisy, weights, order=order)
    low, high = xy.min(axis=0), xy.max(axis=0)
    s, t = ((xy - low) / (high - low) * 2.0 - 1.0).T
    full = np.polynomial.chebyshev.chebvander2d(s, t, [order, order])
    degree = np.add.outer(np.arange(order + 1), np.arange(order + 1)).ravel()
    design = full[:, degree <= order]
    root = np.sqrt(weights)[:, None]
    solution = np.linalg.lstsq(design * root, noisy * root, rcond=None)[0]
    np.testing.assert_allclose(noisy - design @ solution, solved.residuals, atol=1e-7)


def test_affine_against_gdal() -> None:
    from rasterio.control import GroundControlPoint
    from rasterio.transform import GCPTransformer

    xy, colrow = scattered(12)
    noisy = colrow + np.random.default_rng(8).normal(0.0, 1.0, colrow.shape)
    # GDAL chooses the order itself: 2 from six points on, so five points make it affine.
    few, seen = xy[:5], noisy[:5]
    points = [GroundControlPoint(row=r, col=c, x=x, y=y, z=0.0) for (x, y), (c, r) in zip(few, seen, strict=True)]
    with GCPTransformer(points) as transformer:
        rows, cols = transformer.rowcol(xy[:, 0], xy[:, 1], op=lambda value: value)
    solved = fit_planar("polynomial", few, seen, order=1)
    model = PlanarModel.of(solved, UTM, SIZE)
    np.testing.assert_allclose(model.ground_to_image(ground3(xy)), np.column_stack([cols, rows]), atol=1e-6)


def test_the_published_table_of_residuals_comes_back() -> None:
    """The textbook's example; its pixels are counted by their centres, so 0.5 is added to columns and rows."""
    xy = np.array([[20.4, 30.6], [70.1, 24.9], [37.1, 89.3], [75.8, 74.4]])
    colrow = np.array([[1, 6], [6, 6], [2, 0], [6, 1]]) + 0.5
    request = SensorRequest(
        "scan",
        (8, 8),
        {
            "kind": "conformal",
            "points": [{"x": x, "y": y, "col": c, "row": r} for (x, y), (c, r) in zip(xy, colrow, strict=True)],
        },
        CRS.from_epsg(32633),
    )
    model = plugin.build(request)
    a, b = model.transformation.values[:2] / model.transformation.scale
    # The book's X is the column and its Y is 7 - row, both of pixel centres; ours are col and -row of corners.
    origin = model.ground_to_image(np.zeros((1, 3)))[0]
    tx, ty = origin[0] - 0.5, 7.0 - (origin[1] - 0.5)
    np.testing.assert_allclose([a, b, tx, ty], [0.099208, 0.011475, -0.66590, -2.27011], atol=5e-6)
    p, outside = model.ground_to_image(np.array([[40.0, 50.0, 0.0], [10.0, 10.0, 0.0]])) - 0.5
    np.testing.assert_allclose(p, [2.73, 3.85], atol=0.005)
    assert outside[1] == pytest.approx(8.16, abs=0.005)


def test_transform_and_geotransform() -> None:
    xy, colrow = scattered()
    for option, value in (
        ("transform", TRUE_TRANSFORM),
        ("transform", list(TRUE_TRANSFORM)[:6]),
        ("geotransform", TRUE_TRANSFORM.to_gdal()),
    ):
        model = plugin.build(SensorRequest("ortho", SIZE, {option: value}, UTM))
        np.testing.assert_allclose(model.ground_to_image(ground3(xy)), colrow, atol=1e-6)
        assert (model.parameters.sigmas == 0.0).all()
        np.testing.assert_allclose(image_to_ground(model, colrow)[:, :2], xy, atol=1e-6)


def test_compound_crs_is_flattened() -> None:
    model = plugin.build(SensorRequest("ortho", SIZE, {"transform": TRUE_TRANSFORM}, CRS("EPSG:32633+5773")))
    assert model.crs == UTM


def test_coefficients_as_written() -> None:
    """Explicit coefficients count from map coordinates themselves."""
    coefficients = {"a": 0.099208, "b": 0.011475, "tx": -0.66590, "ty": -2.27011}
    options: dict[str, Any] = {"kind": "conformal", "coefficients": coefficients}
    with pytest.raises(InputError, match="does not name"):
        plugin.build(SensorRequest("scan", (8, 8), {**options, "kind": "affine"}, UTM))
    model = plugin.build(SensorRequest("scan", (8, 8), options, UTM))
    x, y = model.ground_to_image(np.array([[40.0, 50.0, 0.0]]))[0] * [1, -1]
    assert (x, y) == pytest.approx((0.099208 * 40 - 0.011475 * 50 - 0.6659, 0.099208 * 50 + 0.011475 * 40 - 2.27011))


def test_projective_sees_one_side_of_its_horizon() -> None:
    xy, colrow = scattered()
    model = bent("projective", 1, xy, colrow)
    own = model.transformation
    c = own.values[6:]
    beyond = own.centre - own.scale * c / (c @ c) * np.array([[0.99], [1.01]])
    image = model.ground_to_image(ground3(beyond))
    assert np.isfinite(image[0]).all()
    assert np.isnan(image[1]).all()


@pytest.mark.parametrize("seed", [47, 372])
def test_projective_from_bad_points_is_a_minimum(seed: int) -> None:
    """Errors of hundreds of pixels, where undamped Gauss-Newton steps throw a point behind the horizon."""
    rng = np.random.default_rng(seed)
    count = int(rng.integers(5, 8))
    xy = rng.uniform(-1.0, 1.0, (count, 2))
    xy -= xy.mean(axis=0)
    values = np.array([2000, 1800, 100, 1500, -90, -1700, *rng.uniform(-0.6, 0.6, 2)])
    truth = PlanarModel.of(Transformation("projective", 1, np.zeros(2), 1.0, values), UTM, SIZE)
    seen = truth.ground_to_image(ground3(xy))
    noisy = seen + rng.normal(0.0, rng.choice([50, 200, 400]), (count, 2))
    solved = fit_planar("projective", xy, noisy)
    model = PlanarModel.of(solved, UTM, SIZE)
    design = model.jacobian(ground3(xy))[0].reshape(-1, 8)
    design /= np.linalg.norm(design, axis=0)
    assert np.abs(design.T @ solved.residuals.ravel()).max() < 1e-6 * np.linalg.norm(solved.residuals)


def test_polynomial_stays_finite_far_away() -> None:
    xy, colrow = scattered()
    model = bent("polynomial", 5, xy, colrow)
    assert np.isfinite(model.ground_to_image(ground3(xy * 1e3))).all()


@pytest.mark.parametrize(
    ("kind", "order", "xy", "says"),
    [
        ("affine", 1, [[0, 0], [1, 1]], "2 control points do not determine"),
        ("affine", 1, [[0, 0]], "1 control point does not determine"),
        ("polynomial", 2, [[0, 0], [1, 0], [0, 1], [1, 1], [2, 1]], "needs 6"),
        ("affine", 1, [[5e5 + k, 5e6 + 2 * k] for k in range(6)], "on a line"),
        ("projective", 1, [[0, 0], [1, 1], [2, 2], [0, 5]], "three of four"),
        ("polynomial", 2, [[np.cos(k), np.sin(k)] for k in range(9)], "line or curve"),
        ("conformal", 1, [[3, 4]] * 4, "one place"),
    ],
)
def test_points_that_do_not_determine_a_fit_are_refused(
    kind: str, order: int, xy: list[list[float]], says: str
) -> None:
    ground = np.array(xy, dtype=float)
    with pytest.raises(SolveError, match=says):
        fit_planar(kind, ground, ground * 3.0 + 1.0, order=order, where="scan 7")


def test_two_points_are_enough_for_conformal() -> None:
    solved = fit_planar("conformal", np.array([[0.0, 0.0], [10.0, 0.0]]), np.array([[5.0, 5.0], [25.0, 5.0]]))
    assert np.isnan(solved.sigma0)
    np.testing.assert_allclose(solved.residuals, 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({}, "nothing to place"),
        ({"transfrom": [1, 0, 0, 0, -1, 0]}, "no input 'transfrom'"),
        ({"transform": [1, 0, 0, 0, -1]}, "6 finite numbers"),
        ({"transform": "north up"}, "6 finite numbers"),
        ({"transform": [1, 2, 0, 2, 4, 0]}, "onto a line"),
        ({"transform": [1, 0, 0, 0, -1, 0], "points": []}, "given together"),
        ({"points": []}, "not a list of points"),
        ({"points": [{"x": 1, "y": 2, "col": 3}]}, "control point 1 has no row"),
        ({"points": [{"x": 1, "y": 2, "col": 3, "row": "left"}]}, "number 1"),
        ({"points": [{"x": 1, "y": 2, "col": 3, "row": 4, "sigma": 0}]}, "sigma"),
        ({"points": [{"x": 1, "y": 2, "col": 3, "row": 4}], "kind": "cubic"}, "'cubic'"),
        ({"points": [{"x": 1, "y": 2, "col": 3, "row": 4}], "kind": "polynomial", "order": 6}, "'order' is 6"),
        ({"points": [{"x": 1, "y": 2, "col": 3, "row": 4}], "kind": "affine", "order": 2}, "no meaning"),
        ({"coefficients": [0, 0, 0, 0], "kind": "conformal"}, "no ground at the middle"),
        ({"coefficients": [1, 0, 0, 0], "kind": "conformal", "scale": 0}, "out of range"),
    ],
)
def test_bad_inputs_name_image_and_input(options: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=says) as caught:
        plugin.build(SensorRequest("photo 12", SIZE, options, UTM))
    assert caught.value.where == "photo 12"


POINT = {"x": 1, "y": 2, "col": 3, "row": 4}


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"Transfrom": [1, 0, 0, 0, -1, 0]}, "did you mean 'transform'"),
        ({"POINTS": [POINT]}, "did you mean 'points'"),
        ({"points": [POINT], "kind": "Affine"}, "did you mean 'affine'"),
        ({"points": [POINT], "kind": "POLYNOM"}, "did you mean 'polynomial'"),
        ({"points": [{"X": 1, "y": 2, "col": 3, "row": 4}]}, "did you mean 'x'"),
        ({"points": [{"x": 1, "y": 2, "Column": 3, "row": 4}]}, "did you mean 'col'"),
        ({"coefficients": {"A00": 1, "a10": 1, "a01": 0, "b00": 0, "b10": 0, "b01": 1}}, "did you mean 'a00'"),
    ],
)
def test_what_was_meant_is_suggested_whatever_its_case(options: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError) as caught:
        plugin.build(SensorRequest("photo 12", SIZE, options, UTM))
    assert says in str(caught.value.hint)


def test_a_planar_image_without_a_crs_is_refused() -> None:
    with pytest.raises(InputError, match="horizontal CRS"):
        plugin.build(SensorRequest("photo 12", SIZE, {"transform": TRUE_TRANSFORM}))
