"""Growth of what is done for all images of a mosaic at once: with the images, not with their pairs."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest
from footprint_rig import footprints

from geomosaic.geo.grid import Window
from geomosaic.geo.window_index import WindowIndex
from geomosaic.mosaicking.outputs import MosaicUnit
from geomosaic.mosaicking.seams import voronoi
from geomosaic.radiometry import gain_offset
from geomosaic.radiometry.gain_offset import MajorAxis, solve_relations
from geomosaic.radiometry.overlaps import partners_of


def windows(images: int) -> tuple[np.ndarray, np.ndarray]:
    """First cells (N, 2) of footprints and those after their last, 10 m cells."""
    bounds = np.array([each.bounds for each in footprints(images)]) / 10.0
    return np.floor(bounds[:, :2]).astype(np.int64), np.ceil(bounds[:, 2:]).astype(np.int64)


def test_pairs_are_those_of_all_pairs_that_share_cells() -> None:
    low, high = windows(100)
    near = partners_of(low, high)
    found = {(i, int(j)) for i, own in enumerate(near) for j in own}
    wanted = set()
    for i, j in combinations(range(100), 2):
        if (np.minimum(high[i], high[j]) > np.maximum(low[i], low[j])).all():
            wanted.add((i, j))
    assert found == wanted | {(j, i) for i, j in wanted}
    assert all((np.diff(own) > 0).all() for own in near)


def test_windows_that_meet_another_are_those_of_a_look_at_all() -> None:
    low, high = windows(100)
    every = [Window(*map(int, (*one, *(other - one)))) for one, other in zip(low, high, strict=True)]
    index = WindowIndex([*every, Window(10_000, 10_000, 0, 5)])
    for part in (every[0], every[55], Window(10_000, 10_000, 300, 200), Window(0, 0, 5, 5)):
        assert index.meeting(part) == [i for i, own in enumerate(every) if not own.intersection(part).empty]


def test_windows_that_touch_or_are_empty_share_nothing() -> None:
    low, high = np.array([[0, 0], [4, 0], [2, 2]]), np.array([[4, 4], [8, 4], [2, 4]])
    assert [own.tolist() for own in partners_of(low, high)] == [[], [], []]
    assert partners_of(low[:0], high[:0]) == []


def test_shares_look_at_as_many_neighbours_of_an_image_in_a_block_of_four_times_its_size(monkeypatch) -> None:
    looked, plain = [], voronoi._nearer

    def counted(*arguments, **more):
        looked.append(1)
        return plain(*arguments, **more)

    monkeypatch.setattr(voronoi, "_nearer", counted)
    each = []
    for images in (100, 400):
        looked.clear()
        outlines = footprints(images)
        voronoi.voronoi_regions([one.polygon for one in outlines], [one.centre for one in outlines])
        each.append(len(looked) / images)
    # Fewer images lie at the edge of a larger block.
    assert each[0] < each[1] < 1.25 * each[0]


def relations(images: int) -> tuple[np.ndarray, np.ndarray, list[MajorAxis], np.ndarray]:
    """Pairs of a block, their relations, and the logarithms of the gains that they were made of."""
    near = partners_of(*windows(images))
    first = np.repeat(np.arange(images), [len(own) for own in near])
    second = np.concatenate(near)
    first, second = first[first < second], second[first < second]
    gain = np.random.default_rng(2).normal(0.0, 0.1, (images, 2))
    level, other, count = np.full(2, 100.0), np.full(2, 0.95), np.full(2, 400.0)
    pairs = [
        MajorAxis(level, level * ratio, level / 5.0, level / 5.0 * ratio, other, count)
        for ratio in np.exp(gain[first] - gain[second])
    ]
    return first, second, pairs, gain


@pytest.mark.parametrize("sparse", [True, False])
def test_gains_come_back_from_the_relations_of_pairs(monkeypatch, sparse: bool) -> None:
    first, second, pairs, gain = relations(400)
    monkeypatch.setattr(gain_offset, "MAX_DENSE", 1 if sparse else 1000)
    found, offset = solve_relations(400, first, second, pairs)
    # Weak observations hold the mean of neighbourhoods to 1.
    assert np.std(np.log(found) - gain) < 0.02
    monkeypatch.setattr(gain_offset, "MAX_DENSE", 1000)
    for one, other in zip((found, offset), solve_relations(400, first, second, pairs), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


def test_normal_equations_of_colours_have_as_many_entries_for_an_image_in_a_block_of_four_times_its_size() -> None:
    each = []
    for images in (100, 400):
        first, second, _, _ = relations(images)
        graph = gain_offset._OverlapGraph.of(images, first, second, hold=True)
        each.append(len(graph._summed[0]) / images)
    assert each[1] < 1.3 * each[0]


def test_a_unit_counts_the_pixels_of_the_images_that_it_shows_and_of_no_others() -> None:
    unit = MosaicUnit.empty(Window(0, 0, 40, 30), 3, "uint8", 100_000)
    unit.label[5:10, :20] = 70_000
    unit.count(unit.label)
    assert unit.counts == {0: 1100, 70_000: 100}
