"""Corrections spread over the image: met at the points, smooth, faded at their reach, told where they contradict."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from geomosaic.errors import GeomosaicWarning
from geomosaic.orientation.edges import spread


def names(count: int) -> tuple[str, ...]:
    return tuple(f"p{k}" for k in range(count))


def test_a_row_of_equal_corrections_neither_sags_nor_swells() -> None:
    points = np.column_stack([np.full(8, 1800.0), np.linspace(100.0, 1900.0, 8)])
    reach = 3.0 * 1800.0 / 7.0
    grid = spread(points, np.tile([1.0, -2.0], (8, 1)), reach, names(8))
    np.testing.assert_allclose(grid.at(points), np.tile([1.0, -2.0], (8, 1)), atol=1e-8)
    along = grid.at(np.column_stack([np.full(1801, 1800.0), np.linspace(100.0, 1900.0, 1801)]))
    assert np.abs(along / [1.0, -2.0] - 1.0).max() < 0.06
    # Away from the row it falls without rising again (beyond a hundredth), to nothing at the reach.
    away = grid.at(np.column_stack([np.linspace(1800.0, 1800.0 - reach, 500), np.full(500, 1000.0)]))[:, 0]
    assert np.diff(away).max() < 1e-3
    assert abs(away[-1]) < 0.01
    half = away[250]
    assert 0.15 < half < 0.7


@pytest.mark.parametrize(("count", "noise"), [(1, 1.0), (2, 1.0), (8, 1.0), (100, 0.5)])
def test_noisy_points_are_met_without_wild_swings(count: int, noise: float) -> None:
    rng = np.random.default_rng(count)
    points = rng.uniform([1600.0, 0.0], [2000.0, 2000.0], (count, 2))
    values = rng.normal(0.0, noise, (count, 2))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        grid = spread(points, values, 600.0, names(count))
    assert np.abs(grid.at(points) - values).max() < 1e-3
    everywhere = rng.uniform([800.0, -800.0], [2800.0, 2800.0], (20000, 2))
    assert np.linalg.norm(grid.at(everywhere), axis=1).max() <= 2.0 * np.linalg.norm(values, axis=1).max()
    outside = points.mean(axis=0) + np.array([[0.0, 9000.0], [-9000.0, 0.0]])
    np.testing.assert_array_equal(grid.at(outside), 0.0)


def test_dense_points_of_a_smooth_misfit() -> None:
    """1500 points 2 to 70 pixels apart: each is met, and between them the function they came from."""

    def truth(p: np.ndarray) -> np.ndarray:
        return np.column_stack([np.sin(p[:, 1] / 300.0), np.cos((p[:, 0] + p[:, 1]) / 400.0)])

    rng = np.random.default_rng(3)
    points = rng.uniform([3000.0, 0.0], [4000.0, 4000.0], (1500, 2))
    grid = spread(points, truth(points), 300.0, names(1500))
    assert np.abs(grid.at(points) - truth(points)).max() < 1e-3
    between = rng.uniform([3050.0, 50.0], [3950.0, 3950.0], (5000, 2))
    assert np.sqrt(((grid.at(between) - truth(between)) ** 2).mean()) < 0.01


def test_contradictions_meet_in_the_mean_and_are_reported() -> None:
    points = np.array([[500.0, 500.0], [500.3, 500.0], [900.0, 900.0]])
    values = np.array([[1.0, 0.0], [0.0, 0.0], [0.5, 0.5]])
    with pytest.warns(GeomosaicWarning, match=r"2 of 3 points .* 'p0' and 'p1'"):
        grid = spread(points, values, 400.0, names(3))
    np.testing.assert_allclose(grid.at(points)[2], values[2], atol=1e-3)
    np.testing.assert_allclose(grid.at(np.array([[500.15, 500.0]])), [[0.5, 0.0]], atol=2e-3)


def test_the_same_point_twice_is_no_contradiction() -> None:
    points = np.array([[500.0, 500.0], [500.0, 500.0], [900.0, 900.0]])
    grid = spread(points, np.array([[1.0, 0.2], [1.0, 0.2], [0.5, 0.5]]), 400.0, names(3))
    np.testing.assert_allclose(grid.at(points[:1]), [[1.0, 0.2]], atol=1e-3)
