"""Seams by likeness: they go round what two images show differently, and stay on ground that both show."""

from __future__ import annotations

import numpy as np
import pytest

from geomosaic.seam.watershed import flood, nearest_two, unlike, widened, without_islands

ROWS, COLS = 80, 120


def two(reach: int = 40) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two images side by side that overlap by 2 · reach columns: first, second, marker."""
    c, r = np.meshgrid(np.arange(COLS) + 0.5, np.arange(ROWS) + 0.5)
    covers = np.stack([c.ravel() < COLS / 2 + reach, c.ravel() > COLS / 2 - reach])
    centres = np.array([[20.0, ROWS / 2], [100.0, ROWS / 2]])
    found = nearest_two(centres, np.column_stack([c.ravel(), r.ravel()]), covers)
    return tuple(part.reshape(ROWS, COLS) for part in found)  # type: ignore[return-value]


def crossings(label: np.ndarray, where: np.ndarray) -> int:
    """Cells of an area beside which, to the right or below, the label changes."""
    along = (label[:, 1:] != label[:, :-1]) & where[:, 1:] & where[:, :-1]
    down = (label[1:] != label[:-1]) & where[1:] & where[:-1]
    return int(along.sum() + down.sum())


def test_the_nearest_two_and_what_is_surely_the_firsts():
    first, second, marker = two()
    assert (first[:, :60] == 0).all()
    assert (first[:, 60:] == 1).all()
    assert (second[:, :20] == -1).all()
    assert marker[:, :20].all()
    assert not marker[:, 55:65].any()


def test_a_house_that_leans_two_ways_is_gone_round():
    first, second, marker = two()
    rng = np.random.default_rng(1)
    one = rng.uniform(100, 104, (ROWS, COLS, 3))
    other = one + rng.normal(0, 1, one.shape)
    house = np.zeros((ROWS, COLS), dtype=bool)
    house[30:55, 50:72] = True  # across the middle, free ground on the right
    other[house] += 60
    label = flood(first, second, marker, unlike(one, other, np.ones((ROWS, COLS), dtype=bool)))
    assert crossings(first, house) > 20
    assert crossings(label, house) == 0
    assert set(np.unique(label)) == {0, 1}
    assert (label[marker] == first[marker]).all()


def test_of_three_images_none_gets_ground_that_it_does_not_show():
    rng = np.random.default_rng(2)
    c, r = np.meshgrid(np.arange(COLS) + 0.5, np.arange(ROWS) + 0.5)
    places = np.column_stack([c.ravel(), r.ravel()])
    centres = np.array([[20.0, 40.0], [60.0, 40.0], [100.0, 40.0]])
    covers = np.stack([np.abs(places[:, 0] - x) < 35 for x, _ in centres])
    first, second, marker = (part.reshape(ROWS, COLS) for part in nearest_two(centres, places, covers))
    label = flood(first, second, marker, rng.uniform(0, 50, (ROWS, COLS)))
    seen = covers.reshape(3, ROWS, COLS)
    r, c = np.nonzero(label >= 0)
    assert seen[label[r, c], r, c].all()
    assert ((label >= 0) == seen.any(axis=0)).all()


def test_no_image_no_label():
    first = np.full((5, 6), -1)
    assert (flood(first, first, first > 0, np.zeros((5, 6))) == -1).all()
    one, other, sure = nearest_two(np.zeros((1, 2)), np.zeros((4, 2)), np.array([[True, False, True, True]]))
    assert one.tolist() == [0, -1, 0, 0]
    assert other.tolist() == [-1] * 4
    assert sure.tolist() == [True, False, True, True]


def test_small_islands_go_and_large_ones_stay():
    label = np.zeros((40, 40), dtype=int)
    label[:, 20:] = 1
    label[5:8, 5:8] = 1
    label[20:30, 5:15] = 1
    cleaned = without_islands(label, 30)
    assert (cleaned[5:8, 5:8] == 0).all()
    assert (cleaned[20:30, 5:15] == 1).all()
    assert (cleaned[:, 20:] == 1).all()


@pytest.mark.parametrize("cells", [1, 3])
def test_labels_are_carried_over_the_rim(cells):
    label = np.full((20, 20), -1)
    label[:, 5:10], label[:, 10:14] = 0, 1
    wide = widened(label, cells)
    assert (wide[:, 5 - cells : 10] == 0).all()
    assert (wide[:, 10 : 14 + cells] == 1).all()
    assert (wide[:, : 5 - cells] == -1).all()
    assert np.array_equal(widened(np.full((3, 3), -1), 2), np.full((3, 3), -1))
