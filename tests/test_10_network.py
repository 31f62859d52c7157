"""Networks of blocks against dense least squares: steps, residuals, conditions, cofactors, redundancy numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from network_rig import Dense, free_network, observations, random_network, strip

from geomosaic.errors import GeomosaicWarning
from geomosaic.estimation import elimination, envelope
from geomosaic.estimation import network as network_of_blocks
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
    np.testing.assert_allclose(network.parameter_variances(), np.diag(inverse)[:count], rtol=1e-9)
    at = network.blocks
    for (a, b), found in network.cofactors_of([(0, 0), (0, 1), (3, 1), (2, 4)]).items():
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
    own = np.linalg.qr(dense.design / length)[0]
    projection = np.eye(len(own)) - own @ own.T
    numbers, first = network.redundancy_numbers(), 0
    for group, share in zip(network.groups, numbers, strict=True):
        count, size = group.misclosure.shape
        for n in range(count):
            own = slice(first + size * n, first + size * (n + 1))
            np.testing.assert_allclose(share[n], projection[own, own], atol=1e-10)
        first += count * size
    assert sum(float(np.trace(share, axis1=1, axis2=2).sum()) for share in numbers) == pytest.approx(network.redundancy)
    assert network.redundancy == first - dense.design.shape[1]
    first = 0
    for index, group in enumerate(network.groups):
        own = slice(first, first + group.misclosure.size)
        count, size = group.misclosure.shape
        every, some = np.arange(count), np.arange(count)[::-3]
        np.testing.assert_allclose(network.redundancy_columns(index, every), projection[own, own], atol=1e-10)
        chosen = (some[:, None] * size + np.arange(size)).ravel()
        np.testing.assert_allclose(network.redundancy_columns(index, some), projection[own, own][:, chosen], atol=1e-10)
        first = own.stop


def test_points_that_their_observations_do_not_determine_are_listed() -> None:
    network = random_network(1, points=30)
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


def test_a_rank_defect_between_two_images_is_an_infinite_condition_and_its_direction() -> None:
    rng = np.random.default_rng(5)
    lone = observations(rng, np.full(9, -1), np.tile(np.arange(4), (9, 1)), 2, 3)
    by = lone.by_parameters.copy()
    by[:, :, 2] = by[:, :, 0]
    network = Network((replace(lone, by_parameters=by),), np.array([0, 2, 4]), np.zeros((0, 3), dtype=bool))
    condition, direction = network.condition()
    assert condition > 1e6
    assert abs(direction @ [1.0, 0.0, -1.0, 0.0]) == pytest.approx(np.sqrt(2.0), rel=1e-3)
    assert np.isnan(replace(network, groups=()).step()).all()


def test_a_network_without_points_or_without_parameters_is_solved_as_well() -> None:
    rng = np.random.default_rng(3)
    lone = observations(rng, np.full(9, -1), np.tile(np.arange(4), (9, 1)), 2, 3)
    only_parameters = Network((lone,), np.array([0, 4]), np.zeros((0, 3), dtype=bool))
    rays = observations(rng, np.repeat([0, 1], 4), np.zeros((8, 0), dtype=np.int64), 2, 3)
    only_points = Network((rays,), np.array([0]), np.ones((2, 3), dtype=bool))
    seen = observations(rng, np.repeat([0, 1], 4), np.full((8, 3), -1), 2, 3)
    lost = observations(rng, np.full(2, -1), np.full((2, 1), -1), 1, 3)
    all_held = Network((seen, lost), np.array([0, 0, 0]), np.ones((2, 3), dtype=bool))
    for network in (only_parameters, only_points, all_held):
        dense = Dense.of(network)
        expected = np.linalg.lstsq(dense.design, dense.misclosure)[0]
        np.testing.assert_allclose(network.step(), expected, rtol=1e-9)
        total = sum(float(np.trace(share, axis1=1, axis2=2).sum()) for share in network.redundancy_numbers())
        assert total == pytest.approx(network.redundancy)
        whole = network.redundancy_columns(0, np.arange(len(network.groups[0].point)))
        blocks = [whole[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] for k in range(len(whole) // 2)]
        np.testing.assert_allclose(blocks, network.redundancy_numbers()[0], atol=1e-12)
        assert np.isfinite(network.point_influence(0)).all() == (network is not only_parameters)


@pytest.mark.parametrize("seed", SEEDS)
def test_a_free_network_moves_the_chosen_points_least_with_the_cofactors_of_that_datum(seed: int) -> None:
    network = free_network(seed)
    assert network.datum is not None
    dense, count, free = Dense.of(network), network.parameters, network.datum.directions
    # The bordered equations of the inner constraints, as textbooks write them.
    border = free * network.datum.chosen[:, None]
    length = np.linalg.norm(dense.design, axis=0)
    design, constraint = dense.design / length, border / np.linalg.norm(border, axis=0) / length[:, None]
    none = np.zeros((free.shape[1], free.shape[1]))
    bordered = np.linalg.inv(np.block([[design.T @ design, constraint], [constraint.T, none]]))
    inverse = bordered[: len(length), : len(length)] / np.outer(length, length)
    np.testing.assert_allclose(network.step(), inverse @ (dense.design.T @ dense.misclosure), rtol=1e-6, atol=1e-9)
    scale = np.sqrt(np.outer(np.diag(inverse), np.diag(inverse)))
    every = np.eye(network.unknowns)
    np.testing.assert_allclose(network.solve(every) / scale, inverse / scale, atol=1e-8)
    parameters = inverse[:count, :count] / scale[:count, :count]
    np.testing.assert_allclose(network.parameter_cofactors() / scale[:count, :count], parameters, atol=1e-8)
    np.testing.assert_allclose(network.parameter_variances(), np.diag(inverse)[:count], rtol=1e-6)
    for own, found in zip(network.place, network.point_cofactors(), strict=True):
        at = np.ix_(own, own)
        np.testing.assert_allclose(found / scale[at], inverse[at] / scale[at], atol=1e-8)
    total = sum(float(np.trace(share, axis1=1, axis2=2).sum()) for share in network.redundancy_numbers())
    assert total == pytest.approx(network.redundancy)
    assert network.redundancy == len(dense.design) - len(length) + free.shape[1]


def test_any_number_of_threads_gives_the_same_bytes(monkeypatch: pytest.MonkeyPatch) -> None:
    # Threads wherever there is a limit below which there are none.
    for room in (elimination, envelope):
        monkeypatch.setattr(room, "WORTH_THREADS", 0)
    results = []
    for count in (1, 2, 3):
        monkeypatch.setattr("os.cpu_count", lambda count=count: count)
        network = random_network(5, images=30, points=100)
        found = [network.step(), network.step(1e-3), network.parameter_cofactors(), network.point_cofactors()]
        results.append([each.tobytes() for each in (*found, *network.redundancy_numbers())])
    assert results[0] == results[1] == results[2]


def test_cofactors_of_a_long_strip_are_those_of_the_dense_inverse() -> None:
    """Several rows of tiles, whose envelope is narrow but for a camera that all images share."""
    network = strip(60)
    assert network.normals.pattern.envelope.offset[-1] < 0.7 * 8 * 9 / 2
    inverse = Dense.of(network).cofactors
    size = np.sqrt(np.diag(inverse)[: network.parameters])
    relative = network.parameter_cofactors() - inverse[: network.parameters, : network.parameters]
    assert np.abs(relative / np.outer(size, size)).max() < 1e-10
    for own, found in zip(network.place, network.point_cofactors(), strict=True):
        np.testing.assert_allclose(found, inverse[np.ix_(own, own)], rtol=1e-9, atol=1e-10 * inverse[own, own].max())


def test_a_pattern_is_taken_over_from_a_network_of_the_same_points_and_parameters_only() -> None:
    first, other = strip(20), random_network(0)
    known = first.normals.pattern
    views, priors = first.groups
    moved = replace(views, by_point=views.by_point * 1.5, point=views.point.copy())
    again = replace(first, groups=(moved, priors), known=known)
    assert again.normals.pattern is known
    np.testing.assert_array_equal(again.step(), replace(again, known=None).step())
    swapped = replace(first, groups=(replace(views, columns=views.columns[::-1]), priors))
    for network in (swapped, other):
        assert replace(network, known=known).normals.pattern is not known
        np.testing.assert_array_equal(replace(network, known=known).step(), network.step())


@pytest.mark.parametrize("damping", [0.0, 1e-2])
@pytest.mark.parametrize("largest", [3, 12])
def test_conjugate_gradients_give_the_same_step_and_columns_of_cofactors(
    monkeypatch: pytest.MonkeyPatch, damping: float, largest: int
) -> None:
    exact = strip(40)
    expected, cofactors = exact.step(damping), exact.cofactors_of([(3, 9), (40, 40)])
    monkeypatch.setattr(elimination, "LARGEST", largest)
    monkeypatch.setattr(network_of_blocks, "STEP_LEFT", 1e-10)
    large = replace(exact)
    assert large.approximate
    assert len(large.normals.of_parameters) <= max(largest, 6)  # 6 tiles on the diagonal, 163 parameters
    length = np.sqrt(np.concatenate([each.ravel() for each in exact.normals.squares]))
    np.testing.assert_allclose(large.step(damping) * length, expected * length, rtol=1e-7, atol=1e-9)
    for pair, found in large.cofactors_of(cofactors).items():
        np.testing.assert_allclose(found, cofactors[pair], rtol=1e-6, atol=1e-8 * np.abs(cofactors[pair]).max())


def test_redundancy_numbers_without_a_factor_are_near_and_sum_to_the_redundancy_and_accuracies_are_not_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    exact = strip(40)
    monkeypatch.setattr(elimination, "LARGEST", 3)
    large = replace(exact)
    near, numbers = large.redundancy_numbers(), exact.redundancy_numbers()
    traces = [np.trace(share, axis1=1, axis2=2) for share in near]
    assert sum(float(trace.sum()) for trace in traces) == pytest.approx(exact.redundancy, rel=1e-3)
    assert np.abs(near[0] - numbers[0]).mean() < 0.05
    assert min(trace.min() for trace in traces) >= 0.0
    assert np.isnan(large.parameter_variances()).all()
    assert np.isnan(large.point_cofactors()).all()


def test_conjugate_gradients_that_end_too_early_say_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(elimination, "LARGEST", 3)
    monkeypatch.setattr(elimination, "ROUNDS", 2)
    with pytest.warns(GeomosaicWarning, match="ended after 2 rounds"):
        strip(40).step()
