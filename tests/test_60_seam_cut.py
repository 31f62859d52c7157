"""Seams that cost least: round houses, along roads, within what images show; and no cheaper ones exist."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from geomosaic.errors import InputError
from geomosaic.mosaicking.seams.cost import edge_proximity, features, image_difference, raised_objects
from geomosaic.mosaicking.seams.graph_cut import RegionGraph, minimise, region_graph
from geomosaic.mosaicking.seams.partition import without_spurs
from geomosaic.mosaicking.seams.voronoi import nearest_images
from geomosaic.options.mosaic import SeamWeights

ROWS, COLS = 80, 120
LENGTH = SeamWeights().length


def two(reach: int = 40) -> np.ndarray:
    """Candidates of two images side by side that overlap by 2 · reach columns."""
    c, r = np.meshgrid(np.arange(COLS) + 0.5, np.arange(ROWS) + 0.5)
    covers = np.stack([c.ravel() < COLS / 2 + reach, c.ravel() > COLS / 2 - reach])
    centres = np.array([[20.0, ROWS / 2], [100.0, ROWS / 2]])
    return nearest_images(centres, np.column_stack([c.ravel(), r.ravel()]), covers, 0.6).reshape(-1, ROWS, COLS)


def energy(graph: RegionGraph, labels: np.ndarray) -> float:
    """Costs of all borders between different images, and of all regions in theirs."""
    unary = np.where(graph.allowed == labels[:, None], graph.unary, 0.0).sum()
    return float(graph.weight[labels[graph.first] != labels[graph.second]].sum() + unary)


def labels(candidates: np.ndarray, cost: np.ndarray, own: np.ndarray | None = None) -> np.ndarray:
    parts = region_graph(candidates, np.zeros(candidates.shape) if own is None else own, cost)
    start = parts.initial_labels(candidates[0])
    chosen = minimise(parts, start)
    assert energy(parts, chosen) <= energy(parts, start)
    return without_spurs(np.where(parts.region >= 0, chosen[parts.region], -1))


def crossings(label: np.ndarray, where: np.ndarray) -> int:
    """Cells of an area beside which, to the right or below, the label changes."""
    along = (label[:, 1:] != label[:, :-1]) & where[:, 1:] & where[:, :-1]
    down = (label[1:] != label[:-1]) & where[1:] & where[:-1]
    return int(along.sum() + down.sum())


def test_a_house_across_decided_cells_goes_on_with_their_image() -> None:
    """Three houses across the edge of what is decided: of one image, of the other, of both."""
    decided = np.full((ROWS, COLS), -3)
    decided[:, :60] = 0
    decided[28:66, :60] = 1
    candidates = np.where(decided < 0, np.array([0, 1])[:, None, None], np.stack([decided, np.full_like(decided, -1)]))
    r, c = np.mgrid[:ROWS, :COLS]
    cost = sum(np.exp(-(((r - row) ** 2 + (c - 60.0) ** 2) / 50.0)) for row in (14, 41, 66))
    graph = region_graph(candidates, np.zeros(candidates.shape), cost, decided)
    sides = [graph.allowed[graph.region[row, 64]].tolist() for row in (14, 41, 66)]
    assert sides == [[0, -1], [1, -1], [1, 0]]
    assert graph.allowed[graph.region[14, COLS - 1]].tolist() == [1, 0]


def test_candidates_are_the_nearest_within_reach():
    candidates = two()
    assert (candidates[0, :, :60] == 0).all()
    assert (candidates[0, :, 60:] == 1).all()
    assert (candidates[1, :, :20] == -1).all()
    assert (candidates[1, :, 55:65] >= 0).all()
    assert (candidates[1, 40, 20:34] == -1).all()  # shown by both, but surely the first's: 0.6 of 80 cells in between
    none = nearest_images(np.zeros((1, 2)), np.zeros((4, 2)), np.array([[True, False, True, True]]), 0.6)
    assert none[0].tolist() == [0, -1, 0, 0]
    assert (none[1:] == -1).all()


def test_a_house_that_leans_two_ways_is_gone_round():
    candidates, rng = two(), np.random.default_rng(1)
    one = rng.uniform(100, 104, (ROWS, COLS, 3))
    other = one + rng.normal(0, 1, one.shape)
    house = np.zeros((ROWS, COLS), dtype=bool)
    house[30:55, 50:72] = True  # across the middle, free ground on the right
    other[house] += 60
    seen = np.ones((ROWS, COLS), dtype=bool)
    cost = LENGTH + image_difference(features(one, seen), features(other, seen), SeamWeights())
    label = labels(candidates, cost)
    assert crossings(candidates[0], house) > 20
    assert crossings(label, house) == 0
    assert set(np.unique(label)) == {0, 1}
    sure = candidates[1] < 0
    assert (label[sure] == candidates[0][sure]).all()


def test_an_alley_between_two_rows_of_houses_is_found():
    cost = np.full((ROWS, COLS), LENGTH)
    for top in range(2, ROWS - 12, 14):
        cost[top : top + 11, 20:58] = 3.0
        cost[top : top + 11, 61:100] = 3.0  # an alley of three cells, and streets of three across it
    label = labels(two(), cost)
    assert crossings(label, cost > 1) == 0
    right = np.array([np.flatnonzero(row == 1).min() for row in label[3:68]])
    assert ((right >= 57) & (right <= 62)).all()  # the way is straight, not along the streets


def test_a_road_is_followed():
    cost = np.full((ROWS, COLS), 0.3)
    col = (60 + 14 * np.sin(np.arange(ROWS) / ROWS * 2 * np.pi)).round().astype(int)
    for shift in (-1, 0, 1):
        cost[np.arange(ROWS), col + shift] = 0.3 * SeamWeights().follow
    label = labels(two(), cost)
    right = np.array([np.flatnonzero(row == 1).min() for row in label])
    assert (np.abs(right - col) <= 2).mean() > 0.95


def test_of_three_images_none_gets_ground_that_it_does_not_show():
    rng = np.random.default_rng(2)
    c, r = np.meshgrid(np.arange(COLS) + 0.5, np.arange(ROWS) + 0.5)
    places = np.column_stack([c.ravel(), r.ravel()])
    centres = np.array([[20.0, 40.0], [60.0, 40.0], [100.0, 40.0]])
    covers = np.stack([np.abs(places[:, 0] - x) < 35 for x, _ in centres])
    candidates = nearest_images(centres, places, covers, 0.6).reshape(-1, ROWS, COLS)
    label = labels(candidates, rng.uniform(0, 1, (ROWS, COLS)))
    seen = covers.reshape(3, ROWS, COLS)
    r, c = np.nonzero(label >= 0)
    assert seen[label[r, c], r, c].all()
    assert ((label >= 0) == seen.any(axis=0)).all()


def test_no_image_no_label():
    nothing = np.full((3, 5, 6), -1)
    parts = region_graph(nothing, np.zeros(nothing.shape), np.zeros((5, 6)))
    assert len(parts.allowed) == 0
    assert len(minimise(parts, parts.initial_labels(nothing[0]))) == 0


def test_two_images_are_divided_as_well_as_can_be():
    """Against all ways to divide ten regions in any order."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        pairs = np.array([pair for pair in itertools.combinations(range(10), 2) if rng.random() < 0.4])
        weight = rng.uniform(0, 1, len(pairs))
        allowed = np.tile([0, 1], (10, 1))
        allowed[0], allowed[9] = [0, -1], [1, -1]
        own = np.where(allowed >= 0, rng.uniform(0, 0.3, allowed.shape), 0)
        parts = RegionGraph(np.zeros((1, 1), dtype=int), allowed, own, pairs[:, 0], pairs[:, 1], weight)
        best = min(energy(parts, np.array([0, *middle, 1])) for middle in itertools.product((0, 1), repeat=8))
        found = minimise(parts, np.array([0, 0, 0, 0, 0, 1, 1, 1, 1, 1]))
        assert energy(parts, found) == pytest.approx(best, abs=1e-3)


def test_a_better_view_is_worth_a_little():
    candidates = two()
    own = np.zeros(candidates.shape)
    own[candidates == 1] = 0.01  # image 1 looks from the side
    label = labels(candidates, np.full((ROWS, COLS), LENGTH), own)
    assert (label == 0).sum() > 1.2 * (candidates[0] == 0).sum()


def test_roofs_stand_out_and_hills_do_not():
    c, r = np.meshgrid(np.arange(100.0), np.arange(100.0))
    hill = 0.5 * c + 10 * np.sin(r / 40)
    flat = raised_objects(hill, 1.0)
    assert flat[10:90, 10:90].max() < 0.05  # roofs: 1
    roof = np.zeros(hill.shape, dtype=bool)
    roof[30:50, 30:60] = True
    found = raised_objects(hill + 6 * roof, 1.0)
    assert (found[roof] == 1).all()
    assert (found[:25] < 0.01).all()
    assert (raised_objects(np.full((4, 4), np.nan), 1.0) == 0).all()


def test_the_edge_of_an_image_is_near_in_its_rim_only():
    shown = np.zeros((100, 100), dtype=bool)
    shown[10:90, 10:90] = True
    near = edge_proximity(shown)
    assert near[50, 50] == 0
    assert near[10, 50] > 0.8
    assert near[13, 50] < near[11, 50]
    assert near[5, 5] == 1


def test_what_differs_in_gain_of_contrast_only_counts_the_same_in_all_units():
    rng = np.random.default_rng(4)
    one = rng.uniform(0, 100, (30, 30, 2))
    other, seen = one + rng.normal(0, 5, one.shape), np.ones((30, 30), dtype=bool)
    w = SeamWeights()
    bytes_ = image_difference(features(one, seen), features(other, seen), w)
    reflectance = image_difference(features(one / 1e4, seen), features(other / 1e4, seen), w)
    assert np.allclose(bytes_, reflectance, atol=1e-4)
    assert (image_difference(features(one, seen), features(one, seen), w) == 0).all()
    assert (image_difference(features(one, seen), features(other, ~seen), w) == 0).all()


@pytest.mark.parametrize("bad", [{"colour": -1.0}, {"length": 0.0}, {"follow": 2.0}, {"edge": float("nan")}])
def test_weights_that_make_no_sense(bad):
    with pytest.raises(InputError):
        SeamWeights(**bad)
