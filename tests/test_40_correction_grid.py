"""Correction grids: interpolation against independent splines, what lies beyond, the way back, what is refused."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline, RegularGridInterpolator

from geomosaic.errors import InputError
from geomosaic.sensor.corrected import CorrectionGrid

ORIGIN, SPACING, SHAPE = np.array([-30.0, 12.5]), np.array([80.0, 50.0]), (9, 12)


def grid(method: str = "bicubic", beyond: str = "zero", size: float = 4.0) -> CorrectionGrid:
    nodes = np.random.default_rng(4).uniform(-size, size, (*SHAPE, 2))
    return CorrectionGrid(ORIGIN, SPACING, nodes, method, beyond)


def inside(count: int, cells: float = 1.0) -> np.ndarray:
    """Places at least some cells from the border."""
    high = ORIGIN + SPACING * (np.array(SHAPE[::-1]) - 1 - cells)
    return np.random.default_rng(8).uniform(ORIGIN + cells * SPACING, high, (count, 2))


def axes() -> tuple[np.ndarray, np.ndarray]:
    rows, columns = SHAPE
    return ORIGIN[1] + SPACING[1] * np.arange(rows), ORIGIN[0] + SPACING[0] * np.arange(columns)


def test_bilinear_against_scipy() -> None:
    g, places = grid("bilinear"), inside(500, 0.0)
    expected = RegularGridInterpolator(axes(), g.nodes)(places[:, ::-1])
    np.testing.assert_allclose(g.at(places), expected, atol=1e-12)


def test_bicubic_against_hermite_splines() -> None:
    """Keys' kernel is the Hermite spline whose slopes are central differences, along one axis after the other."""
    g, places = grid(), inside(60)
    rows, columns = axes()
    for place, found in zip(places, g.at(places), strict=True):
        lines = CubicHermiteSpline(columns, g.nodes, np.gradient(g.nodes, SPACING[0], axis=1), axis=1)(place[0])
        expected = CubicHermiteSpline(rows, lines, np.gradient(lines, SPACING[1], axis=0), axis=0)(place[1])
        np.testing.assert_allclose(found, expected, atol=1e-12)


@pytest.mark.parametrize("method", ["bicubic", "bilinear"])
@pytest.mark.parametrize("beyond", ["zero", "held"])
def test_nodes_are_met_and_borders_are_as_declared(method: str, beyond: str) -> None:
    g = grid(method, beyond)
    rows, columns = axes()
    c, r = np.meshgrid(columns, rows)
    nodes = np.column_stack([c.ravel(), r.ravel()])
    np.testing.assert_allclose(g.at(nodes), g.nodes.reshape(-1, 2), atol=1e-12)
    last = nodes[-1]
    far = np.array([last + 2.001 * SPACING, last + 1e12, ORIGIN - 2.001 * SPACING, [-1e15, last[1]]])
    held = np.array([g.nodes[-1, -1], g.nodes[-1, -1], g.nodes[0, 0], g.nodes[-1, 0]])
    np.testing.assert_allclose(g.at(far), held if beyond == "held" else 0.0, atol=1e-12)
    np.testing.assert_allclose(g.slopes(far[:3]), 0.0, atol=1e-12)
    # No jump anywhere on the way out.
    way = np.column_stack([np.linspace(ORIGIN[0] - 300.0, ORIGIN[0] + 300.0, 60001), np.full(60001, 200.0)])
    assert np.abs(np.diff(g.at(way), axis=0)).max() < 0.02 * g.steepest


def test_slopes_against_differences() -> None:
    g = grid()
    places = np.vstack([inside(200), inside(50, -1.5)])
    for axis in (0, 1):
        step = 1e-4 * np.eye(2)[axis]
        measured = (g.at(places + step) - g.at(places - step)) / 2e-4
        np.testing.assert_allclose(g.slopes(places)[:, :, axis], measured, atol=1e-6)


def test_weights_say_what_at_does() -> None:
    for beyond in ("zero", "held"):
        g, places = grid(beyond=beyond), inside(100, 0.0)
        index, weight = g.weights(places)
        total = np.einsum("nij,nijk->nk", weight, g.nodes.reshape(-1, 2)[index])
        np.testing.assert_allclose(total, g.at(places), atol=1e-12)


@pytest.mark.parametrize("method", ["bicubic", "bilinear"])
def test_ideal_is_the_way_back(method: str) -> None:
    """Under the steepest corrections that are admitted, over kinks and borders, to 1e-9 pixel."""
    g = grid(method)
    g = CorrectionGrid(g.origin, g.spacing, g.nodes * (0.499 / g.steepest), method)
    places = np.vstack([inside(3000, -2.5), [[np.nan, 1.0]]])
    back = g.ideal(places + g.at(places))
    assert np.abs(back - places)[:-1].max() < 1e-9
    assert np.isnan(back[-1]).all()


def test_a_grid_of_one_node_shifts_the_whole_image() -> None:
    held = CorrectionGrid([0.0, 0.0], [10.0, 10.0], [[[0.3, -0.2]]], beyond="held")
    np.testing.assert_allclose(held.at(np.array([[-5.0, 3.0], [900.0, 1e9]])), [[0.3, -0.2]] * 2, atol=1e-15)


def test_a_grid_comes_back_from_its_dictionary() -> None:
    g = grid("bilinear", "held")
    back = CorrectionGrid.from_dict(json.loads(json.dumps(g.to_dict())))
    np.testing.assert_array_equal(back.nodes, g.nodes)
    assert (back.method, back.beyond) == (g.method, g.beyond)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"method": "cubic"}, "no method 'cubic'"),
        ({"beyond": "mirror"}, "no beyond 'mirror'"),
        ({"nodes": np.full((2, 2, 2), np.nan)}, "not finite"),
        ({"nodes": np.zeros((0, 3, 2))}, "no node"),
        ({"spacing": [0.0, 1.0]}, "not positive"),
        ({"nodes": np.array([[[0.0, 0.0], [9.0, 0.0]]])}, "fold"),
    ],
)
def test_grids_that_cannot_be_are_refused(change: dict[str, object], words: str) -> None:
    given = {"origin": [0.0, 0.0], "spacing": [10.0, 10.0], "nodes": np.zeros((2, 2, 2)), **change}
    with pytest.raises(InputError, match=words):
        CorrectionGrid(**given)
