"""A smooth bend of the image is no blunder: points that a fit misses, held against those around them."""

from __future__ import annotations

import numpy as np
import pytest

from geomosaic.estimation.blunders.neighbour_tests import explained_by_distortion, powers, predictions


def lens(across: int, down: int, barrel: float, power: int) -> tuple[np.ndarray, np.ndarray]:
    """Ground and measured pixels of a grid to the very corners, under lens distortion."""
    c, r = np.meshgrid(np.linspace(20, 3980, across), np.linspace(20, 2980, down))
    colrow = np.column_stack([c.ravel(), r.ravel()])
    flat = colrow - (2000, 1500)
    xy = 0.5 * flat * (1.0 + barrel * (np.hypot(*flat.T) / 2500.0)[:, None] ** power) * [1, -1]
    return xy, colrow + np.random.default_rng(4).normal(0.0, 0.3, colrow.shape)


def corners(across: int, down: int) -> np.ndarray:
    which = np.zeros(across * down, dtype=bool)
    which[[0, across - 1, -across, -1]] = True
    return which


@pytest.mark.parametrize("order", [2, 3, 4])
def test_powers_below_the_order_are_predicted_exactly(order):
    random = np.random.default_rng(order)
    places = random.uniform(-1, 1, (40, 2))
    image = powers(places, order) @ random.normal(0, 100, (order * (order + 1) // 2, 2))
    kept = np.arange(40) != 7
    errors, variance = predictions(places, image, kept, order=order)
    assert np.abs(errors).max() < 1e-4
    assert (variance > 0).all()


@pytest.mark.parametrize("order", [2, 3, 4])
def test_errors_left_out_are_those_of_a_spline_without_the_point(order):
    random = np.random.default_rng(order)
    places, image = random.uniform(-1, 1, (30, 2)), random.normal(0, 10, (30, 2))
    all_errors, all_variance = predictions(places, image, np.ones(30, dtype=bool), order=order)
    for i in (0, 11, 29):
        errors, variance = predictions(places, image, np.arange(30) != i, order=order)
        assert errors[i] == pytest.approx(all_errors[i], rel=1e-5, abs=1e-5)
        assert variance[i] == pytest.approx(all_variance[i], rel=1e-5)


@pytest.mark.parametrize(("barrel", "power"), [(0.02, 4), (0.05, 4), (0.12, 2), (0.12, 4), (0.25, 2), (0.25, 4)])
def test_corners_of_a_distorted_photo_are_explained(barrel, power):
    xy, colrow = lens(12, 9, barrel, power)
    accused = corners(12, 9)
    assert (explained_by_distortion(xy, colrow, accused) == accused).all()


def test_what_was_measured_elsewhere_is_not():
    """At any place, the corners too, which are extrapolated: by 30 px and more."""
    pardoned = []
    for seed in range(40):
        random = np.random.default_rng(seed)
        xy, colrow = lens(12, 9, 0.12, 4)
        wrong = random.permutation(len(xy))[:6]
        wrong[:2] = (0, 107)
        angle, length = random.uniform(0, 2 * np.pi, 6), random.uniform(30, 200, 6)
        colrow[wrong] += np.column_stack([length * np.cos(angle), length * np.sin(angle)])
        accused = corners(12, 9)
        accused[wrong] = True
        explained = explained_by_distortion(xy, colrow, accused)
        assert not explained[wrong].any(), seed
        pardoned += [bool(explained[i]) for i in (11, 96) if i not in wrong]
    assert np.mean(pardoned) > 0.9


def test_too_few_points_explain_nothing():
    xy, colrow = lens(4, 3, 0.05, 2)
    assert not explained_by_distortion(xy, colrow, corners(4, 3)).any()
    nobody = np.zeros(12, dtype=bool)
    assert not explained_by_distortion(xy, colrow, nobody).any()
