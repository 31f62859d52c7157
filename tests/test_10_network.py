"""Networks of blocks against dense least squares: steps, residuals, conditions, cofactors, redundancy numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from network_rig import Dense, observations, random_network

from geomosaic.estimation.network import Network, Observations
from geomosaic.types import BoolArray

SEEDS = range(4)


@pytest.fixture(params=SEEDS, ids=lambda seed: f"seed {seed}")
def network(request: pytest.FixtureRequest) -> Network:
    return random_network(request.param, dimensions=2 + request.param % 2)


def test_a_step_is_the_least_squares_solution_of_the_stacked_equations(network: Network) -> None:
    dense, step = Dense.of(network), network.step()
    length = np.linalg.norm(dense.design, axis=0)
    expected = np.linalg.lstsq(dense.design / length, dense.misclosure)[0]
    np.testing.assert_allclose(step * length, expected, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(network.residuals(step), dense.misclosure - dense.design @ step, atol=1e-12)


@pytest.mark.parametrize("damping", [1e-4, 1.0, 1e4])
def test_damping_is_added_to_the_scaled_diagonal_of_parameters_and_points(network: Network, damping: float) -> None:
    dense = Dense.of(network)
    length = np.linalg.norm(dense.design, axis=0)
    scaled = dense.design / length
    expected = np.linalg.solve(scaled.T @ scaled + damping * np.eye(len(length)), scaled.T @ dense.misclosure)
    np.testing.assert_allclose(network.step(damping) * length, expected, rtol=1e-9, atol=1e-12)


def test_the_condition_is_that_of_the_scaled_design_with_its_weakest_direction(network: Network) -> None:
    design = Dense.of(network).design
    _, singular, turned = np.linalg.svd(design / np.linalg.norm(design, axis=0))
    condition, direction = network.condition()
    assert condition == pytest.approx(singular[0] / singular[-1], rel=1e-3)
    assert abs(direction @ turned[-1]) > 0.9


def test_cofactors_are_those_of_the_dense_inverse(network: Network) -> None:
    inverse, count = Dense.of(network).cofactors, network.parameters
    of_parameters = network.parameter_cofactors()
    size = np.sqrt(np.diag(inverse))
    np.testing.assert_allclose(
        of_parameters / np.outer(size, size)[:count, :count],
        (inverse / np.outer(size, size))[:count, :count],
        atol=1e-10,
    )
    at = network.blocks
    for (a, b), found in network.cofactors_of([(0, 0), (0, 1), (3, 1), (2, 5)]).items():
        np.testing.assert_allclose(found, of_parameters[at[a] : at[a + 1], at[b] : at[b + 1]], rtol=1e-8, atol=1e-20)
    of_points, place = network.point_cofactors(), network.place
    for point, own in enumerate(place):
        free = own >= 0
        expected = np.zeros((len(own), len(own)))
        expected[np.ix_(free, free)] = inverse[np.ix_(own[free], own[free])]
        np.testing.assert_allclose(of_points[point], expected, atol=1e-10 * inverse[count:, count:].max())


def test_redundancy_numbers_are_the_diagonal_of_the_projection_and_sum_to_the_redundancy(network: Network) -> None:
    dense = Dense.of(network)
    length = np.linalg.norm(dense.design, axis=0)
    scaled = dense.design / length
    projection = np.eye(len(scaled)) - scaled @ np.linalg.pinv(scaled)
    numbers, first = network.redundancy_numbers(), 0
    for group, share in zip(network.groups, numbers, strict=True):
        count, size = group.misclosure.shape
        for n in range(count):
            own = slice(first + size * n, first + size * (n + 1))
            np.testing.assert_allclose(share[n], projection[own, own], atol=1e-10)
        first += count * size
    assert sum(float(np.trace(share, axis1=1, axis2=2).sum()) for share in numbers) == pytest.approx(network.redundancy)
    assert network.redundancy == first - dense.design.shape[1]


def test_points_that_their_observations_do_not_determine_are_listed() -> None:
    network = random_network(1)
    views, *others = network.groups
    keep = np.ones(len(views.point), dtype=bool)
    keep[np.flatnonzero(views.point == 7)[1:]] = False  # one ray for three coordinates
    keep[views.point == 8] = False  # none
    by_point = views.by_point.copy()
    by_point[views.point == 10] = by_point[views.point == 10][0]  # all rays parallel
    moving = network.moving.copy()
    moving[[7, 8, 10, 11]], moving[13] = True, False  # and one without rays, whose coordinates are held
    keep[views.point == 13] = False
    without = {7, 8, 10, 13}
    kept = [select(group, ~np.isin(group.point, list(without))) for group in others]
    views = select(replace(views, by_point=by_point), keep)
    assert Network((views, *kept), network.blocks, moving).undetermined_points.tolist() == [7, 8, 10]


def select(group: Observations, keep: BoolArray) -> Observations:
    return Observations(*(getattr(group, name)[keep] for name in group.__dataclass_fields__))


def test_a_parameter_that_nothing_observes_makes_the_condition_infinite_and_is_its_direction() -> None:
    network = random_network(2)
    *groups, priors = network.groups
    lost = 6
    groups = [replace(g, columns=np.where(g.columns == lost, -1, g.columns)) for g in groups]
    keep = priors.columns[:, 0] != lost
    broken = Network((*groups, select(priors, keep)), network.blocks, network.moving)
    condition, direction = broken.condition()
    assert condition > 1e10
    assert np.argmax(np.abs(direction)) == lost


def test_a_network_without_points_or_without_parameters_is_solved_as_well() -> None:
    rng = np.random.default_rng(3)
    lone = observations(rng, np.full(9, -1), np.tile(np.arange(4), (9, 1)), 2, 3)
    only_parameters = Network((lone,), np.array([0, 4]), np.zeros((0, 3), dtype=bool))
    rays = observations(rng, np.repeat([0, 1], 4), np.zeros((8, 0), dtype=np.int64), 2, 3)
    only_points = Network((rays,), np.array([0]), np.ones((2, 3), dtype=bool))
    for network in (only_parameters, only_points):
        dense = Dense.of(network)
        expected = np.linalg.lstsq(dense.design, dense.misclosure)[0]
        np.testing.assert_allclose(network.step(), expected, rtol=1e-9)
        total = sum(float(np.trace(share, axis1=1, axis2=2).sum()) for share in network.redundancy_numbers())
        assert total == pytest.approx(network.redundancy)
