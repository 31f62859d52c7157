"""Where one more control point helps most: predictions against adjustments with that point, and other orders."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from adjust_rig import CENTRE, OPTIONS, truth
from pyproj import CRS
from solve_rig import Level, camera, scanner

from geomosaic.estimation.optimal_design import updated_covariance, variance_decreases
from geomosaic.geo.crs import geographic
from geomosaic.geo.local_frames import enu_axes
from geomosaic.geo.transform import Transform
from geomosaic.orientation.single.next_point import ImageGrid, expected_accuracy, missing_points, parameter_covariance
from geomosaic.sensor import registry
from geomosaic.sensor.plugin import SensorModel, SensorRequest
from geomosaic.sensor.solve import resect
from geomosaic.sensor.solve.newton import difference_jacobian
from geomosaic.types import FloatArray

MODELS = ("affine", "poly2", "projective", "frame", "scanner")
SIGMA = 0.5


@cache
def model_of(name: str) -> SensorModel:
    if name == "frame":
        return camera()
    if name == "scanner":
        return scanner()
    places = np.stack(np.meshgrid(*[np.linspace(-500.0, 500.0, 7)] * 2), axis=2).reshape(-1, 2) + CENTRE
    image = truth(name, places)
    points = [
        {"x": float(x), "y": float(y), "col": float(c), "row": float(r), "sigma": 1.0}
        for (x, y), (c, r) in zip(places, image, strict=True)
    ]
    return registry.build(
        "planar", SensorRequest("a.tif", (2000, 2000), {**OPTIONS[name], "points": points}, CRS.from_epsg(32633))
    )


def grid_of(model: SensorModel, cells: int = 16) -> ImageGrid:
    return ImageGrid.of(model, Level(450.0) if model.crs.is_geocentric else None, cells)


@cache
def coarse(name: str) -> ImageGrid:
    return grid_of(model_of(name), 10)


@cache
def fine(name: str) -> FloatArray:
    return grid_of(model_of(name), 24).xyz.reshape(-1, 3)


@cache
def slopes(name: str) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Image places of a fine grid, and derivatives there by differences: of the image, and of metres on the map."""
    model = model_of(name)
    grid = grid_of(model, 24)
    xyz = grid.xyz.reshape(-1, 3)
    by_parameters, by_ground = difference_jacobian(model, xyz)
    if model.crs.is_geocentric:
        degrees = Transform(model.crs, geographic(model.crs))(xyz)
        level = np.array([enu_axes(longitude, latitude)[:2] for longitude, latitude, _ in degrees])
        by_ground = by_ground @ level.transpose(0, 2, 1)
    free = model.parameters.sigmas > 0.0
    return (
        grid.colrow.reshape(-1, 2),
        by_parameters[:, :, free],
        np.linalg.inv(by_ground[:, :, :2]) @ (by_parameters[:, :, free]),
    )


def true_rms(name: str, chosen: list[int], noise: FloatArray) -> float:
    """RMS error on the map, metres, of least squares on noisy points of the fine grid: 40 trials, all places judged."""
    _, design, targets = slopes(name)
    rows = design[chosen].reshape(-1, design.shape[2])
    scale = np.linalg.norm(design.reshape(-1, design.shape[2]), axis=0)
    wrong = np.linalg.lstsq(rows / scale, noise[chosen].reshape(len(rows), -1), rcond=None)[0] / scale[:, None]
    errors = targets @ wrong
    return float(np.sqrt((errors**2).sum(axis=1).mean()))


def farthest_first(places: FloatArray, chosen: list[int], candidates: list[int]) -> int:
    apart = np.linalg.norm(places[candidates][:, None] - places[chosen][None], axis=2).min(axis=1)
    return candidates[int(np.argmax(apart))]


def points_needed(name: str, way: str, seed: int) -> int:
    """Number of points until the map is as accurate as with 16 points at random."""
    random = np.random.default_rng(seed)
    places, design, _ = slopes(name)
    noise = np.random.default_rng(1000 + seed).normal(0.0, SIGMA, (len(places), 2, 40))
    # Points can be identified at 30 places only.
    candidates = random.permutation(len(places))[:30].tolist()
    least = -(-design.shape[2] // 2) + 1
    goal = true_rms(name, candidates[:16], noise)
    model, grid, xyz = model_of(name), coarse(name), fine(name)
    chosen, left = candidates[:least], candidates[least:]
    while left and true_rms(name, chosen, noise) > goal:
        if way == "next point":
            covariance = parameter_covariance(model, xyz[chosen], np.full(len(chosen), SIGMA))
            found = expected_accuracy(model, grid, covariance, xyz[left], sigma_px=SIGMA, count=1)
            step = left[int(found.order.chosen[0])]
        else:
            step = farthest_first(places, chosen, left) if way == "farthest" else left[0]
        chosen.append(step)
        left.remove(step)
    return len(chosen)


def test_following_the_next_point_needs_fewer_points_than_other_orders() -> None:
    """Fifty seeded cases of five sensors; accuracy by least squares with derivatives by differences and real noise."""
    cases = [(MODELS[seed % len(MODELS)], seed) for seed in range(50)]
    counts = {
        way: np.array([points_needed(name, way, seed) for name, seed in cases])
        for way in ("next point", "farthest", "random")
    }
    assert np.median(counts["next point"]) < np.median(counts["random"])
    assert np.median(counts["next point"]) <= np.median(counts["farthest"])
    assert np.median(counts["next point"] - counts["random"]) < 0
    assert np.median(counts["next point"] - counts["farthest"]) <= 0
    print({way: (np.median(found), found.mean()) for way, found in counts.items()})


@pytest.mark.parametrize("name", MODELS)
def test_accuracy_falls_as_predicted(name: str) -> None:
    """The prediction against an adjustment that has the point."""
    model, grid = model_of(name), grid_of(model_of(name), 6)
    rows, cols = grid.colrow.shape[:2]
    xyz = grid.xyz.reshape(-1, 3)
    first = [0, 2, cols * rows - 1, cols * (rows - 1), cols * 2 + 1, cols * 3 - 2, 4]
    sigma = np.full(len(first), SIGMA)
    found = expected_accuracy(model, grid, parameter_covariance(model, xyz[first], sigma), sigma_px=SIGMA, count=4)
    measured = list(first)
    for step, number in enumerate([None, *found.order.chosen.tolist()]):
        measured += [] if number is None else [number]
        image = model.ground_to_image(xyz[measured])
        adjusted = resect(model, xyz[measured], image, SIGMA)
        covariance = adjusted.covariance
        again = expected_accuracy(adjusted.model, grid, covariance, sigma_px=SIGMA, count=0)
        assert found.predicted[step] == pytest.approx(again.rms, rel=2e-3)
    best = found.rms_with.ravel()[found.order.chosen[0]]
    assert best == pytest.approx(found.predicted[1], rel=1e-4)
    assert best == found.rms_with.min()


@pytest.mark.parametrize("name", MODELS)
def test_the_expected_error_is_that_of_repeated_adjustments(name: str) -> None:
    places = slopes(name)[0]
    random = np.random.default_rng(4)
    chosen = random.permutation(len(places))[:12].tolist()
    noise = random.normal(0.0, SIGMA, (len(places), 2, 2000))
    model, grid = model_of(name), grid_of(model_of(name), 24)
    covariance = parameter_covariance(model, grid.xyz.reshape(-1, 3)[chosen], np.full(12, SIGMA))
    found = expected_accuracy(model, grid, covariance, count=0)
    assert found.rms == pytest.approx(true_rms(name, chosen, noise), rel=0.05)


def test_the_optimum_order_of_points_starts_at_the_corners() -> None:
    """With nothing measured: the order in which points are best measured (Müller and Sauleda 1988)."""
    model = model_of("affine")
    grid = grid_of(model, 9)
    covariance = parameter_covariance(model, np.zeros((0, 3)), np.zeros(0))
    found = expected_accuracy(model, grid, covariance, count=8, missing=missing_points(model, 0))
    first = grid.colrow.reshape(-1, 2)[found.order.chosen[:4]]
    # No triangle of the grid is larger than half of it, and larger than this one by a tenth.
    assert abs(np.linalg.det(first[1:3] - first[0])) / 2.0 > 0.49 * (2000.0 * 8 / 9) ** 2
    assert (np.abs(first - 1000.0).max(axis=1) > 850.0).all()
    assert (np.diff(found.predicted) < 0.0).all()
    assert found.predicted[3] < 5.0 < found.predicted[2]


def test_a_point_beside_those_measured_helps_least() -> None:
    model = model_of("poly2")
    grid = grid_of(model)
    places = grid.colrow.reshape(-1, 2)
    measured = np.flatnonzero(places[:, 0] < 1000.0)[::7]
    covariance = parameter_covariance(model, grid.xyz.reshape(-1, 3)[measured], np.ones(len(measured)))
    found = expected_accuracy(model, grid, covariance)
    assert (places[found.order.chosen[:3], 0] > 1500.0).all()
    assert np.nanargmax(found.sigma) % found.sigma.shape[1] == found.sigma.shape[1] - 1
    assert found.rms_with[:, :6].min() > 0.9 * found.rms > 2.0 * found.rms_with.min()


def test_the_update_is_that_of_the_normal_equations() -> None:
    random = np.random.default_rng(1)
    first, one, targets = random.normal(size=(9, 5)), random.normal(size=(2, 5)), random.normal(size=(7, 2, 5))
    noise = np.array([[0.5, 0.1], [0.1, 0.3]])
    before = np.linalg.inv(first.T @ first)
    after = np.linalg.inv(first.T @ first + one.T @ np.linalg.inv(noise) @ one)
    np.testing.assert_allclose(updated_covariance(before, one, noise), after, rtol=1e-10, atol=1e-12)
    weight = np.einsum("nip,niq->pq", targets, targets) / 7
    gain = variance_decreases(before, weight, np.stack([one, np.full((2, 5), np.nan)]), np.stack([noise, noise]))
    assert gain[0] == pytest.approx(np.trace(weight @ (before - after)))
    assert np.isnan(gain[1])
