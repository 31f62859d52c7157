"""Left- and right-handed image axes: every kind fits both, and says which it met."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.solve import resect
from geomosaic.testing import SensorModelTests
from geomosaic_planar import PlanarModel, Transformation, fit_planar, plugin

UTM = CRS.from_epsg(32633)
SIZE = (6000, 4000)
KINDS = [("conformal", 1), ("affine", 1), ("projective", 1), ("polynomial", 3), ("tps", 1)]
FLIPS = {
    "left": lambda colrow: colrow,
    "right": lambda colrow: colrow * [1.0, -1.0] + [0.0, SIZE[1]],
    "columns": lambda colrow: colrow * [-1.0, 1.0] + [SIZE[0], 0.0],
    "exchanged": lambda colrow: colrow[:, ::-1],
}


def conformal_photo(count: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Ground and image of a photo turned by 31 degrees, rows downwards."""
    rng = np.random.default_rng(12)
    colrow = rng.uniform([0.0, 0.0], SIZE, (count, 2))
    turn = 0.4 * np.array([[np.cos(0.54), np.sin(0.54)], [np.sin(0.54), -np.cos(0.54)]])
    return colrow @ turn.T + [512_300.0, 5_403_800.0], colrow


def points_of(xy: np.ndarray, colrow: np.ndarray) -> list[dict[str, float]]:
    return [{"x": x, "y": y, "col": c, "row": r} for (x, y), (c, r) in zip(xy, colrow, strict=True)]


def ground3(xy: np.ndarray) -> np.ndarray:
    return np.column_stack([xy, np.zeros(len(xy))])


class TestMirroredConformal(SensorModelTests):
    @pytest.fixture
    def model(self) -> PlanarModel:
        xy, colrow = conformal_photo()
        return PlanarModel.of(fit_planar("conformal", xy, FLIPS["right"](colrow)), UTM, SIZE)

    @pytest.fixture
    def ground(self) -> np.ndarray:
        return ground3(conformal_photo()[0])


@pytest.mark.parametrize("flip", list(FLIPS))
@pytest.mark.parametrize(("kind", "order"), KINDS)
def test_both_hands_fit_exactly_and_are_reported(kind: str, order: int, flip: str) -> None:
    xy, colrow = conformal_photo()
    seen = FLIPS[flip](colrow)
    request = SensorRequest("scan", SIZE, {"kind": kind, "order": order, "points": points_of(xy, seen)}, UTM)
    model = plugin.build(request)
    np.testing.assert_allclose(model.ground_to_image(ground3(xy)), seen, rtol=0.0, atol=1e-6)
    assert model.transformation.axes == ("left" if flip == "left" else "right")
    again = PlanarModel.from_dict(model.to_dict())
    assert again.transformation.axes == model.transformation.axes
    np.testing.assert_array_equal(again.ground_to_image(ground3(xy)), model.ground_to_image(ground3(xy)))


def test_parameters_of_a_mirrored_conformal_come_back() -> None:
    xy, _ = conformal_photo()
    values = np.array([2000.0, -700.0, 3000.0, 2100.0])
    given = Transformation("conformal", 1, xy.mean(axis=0), 1200.0, values, "right")
    truth = PlanarModel.of(given, UTM, SIZE)
    solved = fit_planar("conformal", xy, truth.ground_to_image(ground3(xy)))
    assert solved.axes == "right"
    np.testing.assert_allclose(solved.values[:2] / solved.scale, values[:2] / given.scale, rtol=1e-9)
    np.testing.assert_allclose(solved.values[2:], values[2:], rtol=1e-9)  # both count from the mean of the points
    moved = truth.with_values(values + np.array([5.0, -5.0, 9.0, 3.0]))
    back = resect(moved, ground3(xy), truth.ground_to_image(ground3(xy)))
    np.testing.assert_allclose(back.model.transformation.values, values, rtol=1e-9)


@pytest.mark.parametrize("flip", ["left", "right"])
def test_noise_and_a_third_of_blunders_leave_the_hand(flip: str) -> None:
    xy, colrow = conformal_photo(30)
    rng = np.random.default_rng(8)
    seen = FLIPS[flip](colrow) + rng.normal(0.0, 2.0, colrow.shape)
    seen[:10] = rng.uniform([0.0, 0.0], SIZE, (10, 2))
    assert fit_planar("conformal", xy, seen).axes == flip


def test_points_that_tell_no_hand_are_taken_for_left() -> None:
    """Two points, and points on a line, fit either way: the usual one is taken; declaring the other gives the other."""
    xy, colrow = conformal_photo(2)
    seen = FLIPS["right"](colrow)
    fitted = fit_planar("conformal", xy, seen)
    assert fitted.axes == "left"
    assert np.abs(fitted.residuals).max() < 1e-8
    declared = fit_planar("conformal", xy, seen, axes="right")
    assert declared.axes == "right"
    assert np.abs(declared.residuals).max() < 1e-8
    line = np.linspace(0.0, 1.0, 9)[:, None] * [800.0, 300.0] + [5e5, 5e6]
    for seed in range(20):
        noise = np.random.default_rng(seed).normal(0.0, 0.3, (9, 2))
        assert fit_planar("conformal", line, (line - line[0]) * [2.0, -2.0] + noise).axes == "left"


def test_declared_axes_of_the_plugin() -> None:
    xy, colrow = conformal_photo()
    options: dict[str, Any] = {"kind": "conformal", "points": points_of(xy, FLIPS["right"](colrow))}
    model = plugin.build(SensorRequest("scan", SIZE, {**options, "axes": "right"}, UTM))
    np.testing.assert_allclose(model.ground_to_image(ground3(xy)), FLIPS["right"](colrow), rtol=0.0, atol=1e-6)
    forced = plugin.build(SensorRequest("scan", SIZE, {**options, "axes": "left"}, UTM))
    assert np.abs(forced.ground_to_image(ground3(xy)) - FLIPS["right"](colrow)).max() > 100.0
    with pytest.raises(InputError, match="axes = 'up' is not known"):
        plugin.build(SensorRequest("scan", SIZE, {**options, "axes": "up"}, UTM))
    with pytest.raises(InputError, match="no meaning for kind 'affine'"):
        plugin.build(SensorRequest("scan", SIZE, {**options, "kind": "affine", "axes": "left"}, UTM))
