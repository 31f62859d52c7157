"""Features that stay at one place of the images while the ground moves: data strips, clocks, scratches."""

from __future__ import annotations

import numpy as np
import pytest

from geomosaic.matching.features import Features
from geomosaic.matching.fixed_features import fixed_features, stationary
from geomosaic.matching.tracks import PairMatches
from geomosaic.tie_points.screening import ground_matches

SIZE = (1500, 1000)


def described(count: int, seed: int) -> np.ndarray:
    """Descriptors that are like no others: as a rule those of random features are 60 degrees apart."""
    values = np.random.default_rng(seed).gamma(0.3, size=(count, 128))
    return np.minimum(512.0 * np.sqrt(values / values.sum(axis=1, keepdims=True)), 255.0).astype(np.uint8)


def features(colrow: np.ndarray, descriptors: np.ndarray) -> Features:
    return Features(colrow, np.full(len(colrow), 3.0), np.zeros(len(colrow)), descriptors)


def images(count: int, overlay: np.ndarray, others: int = 600) -> list[Features]:
    """Images with the same features at `overlay`, and each with others of its own anywhere."""
    found, same = [], described(len(overlay), 99)
    for k in range(count):
        random = np.random.default_rng(k)
        mine = random.uniform(0.0, SIZE, (others, 2))
        place = overlay + random.normal(0.0, 0.2, overlay.shape)
        found.append(features(np.vstack([place, mine]), np.vstack([same, described(others, k)])))
    return found


def strip(count: int = 80) -> np.ndarray:
    """Places along the lower edge."""
    return np.random.default_rng(5).uniform([0.0, 950.0], SIZE, (count, 2))


@pytest.mark.parametrize("count", [4, 12])
def test_a_data_strip_is_found_and_the_ground_is_kept(count: int) -> None:
    found = fixed_features(images(count, strip()), np.tile(SIZE, (count, 1)), np.full(count, 2.0))
    for flags in found:
        assert flags[:80].mean() > 0.95
        assert flags[80:].mean() < 0.002


def test_three_images_do_not_tell_what_is_fixed() -> None:
    found = fixed_features(images(3, strip()), np.tile(SIZE, (3, 1)), np.full(3, 2.0))
    assert not any(flags.any() for flags in found)


def test_images_that_all_show_one_view_keep_their_features() -> None:
    everywhere = np.random.default_rng(5).uniform(0.0, SIZE, (600, 2))
    found = fixed_features(images(6, everywhere, 200), np.tile(SIZE, (6, 1)), np.full(6, 2.0))
    assert not any(flags.any() for flags in found)


def test_images_of_other_sizes_are_not_compared() -> None:
    sizes = np.array([SIZE] * 3 + [(1000, 1500)] * 3)
    found = fixed_features(images(6, strip()), sizes, np.full(6, 2.0))
    assert not any(flags.any() for flags in found)


def test_what_stays_in_a_pair_whose_ground_moves_is_left_out() -> None:
    one = np.random.default_rng(0).uniform(0.0, SIZE, (100, 2))
    other = one + np.array([40.0, -8.0])
    other[:10] = one[:10] + 0.5
    assert np.flatnonzero(stationary(one, other, 2.0)).tolist() == list(range(10))
    # Two copies of one photo: nothing moves, and all of it is ground.
    assert not stationary(one, one + 0.1, 2.0).any()


def test_a_pair_that_a_data_strip_held_together_is_matched_anew_without_it() -> None:
    found, ground = images(5, strip()), np.arange(100, 130)
    places = [np.column_stack([each.place[:80], each.place[:80]]) for each in found]
    pairs = [PairMatches(0, k, np.column_stack([places[0][:, 0], places[k][:, 0]]), np.zeros(80)) for k in (1, 2)]
    asked = []

    def rematch(i: int, j: int, free) -> PairMatches | None:
        asked.append((i, j, len(free[i])))
        if j == 2:
            return None
        # The strip is gone: numbers of features, and of places, are others now.
        left = [free[k].place[ground] for k in (i, j)]
        return PairMatches(i, j, np.column_stack(left), np.zeros(len(ground)))

    fixed = fixed_features(found, np.tile(SIZE, (5, 1)), np.full(5, 2.0))
    (kept,) = ground_matches(pairs, found, fixed, np.full(5, 2.0), rematch)
    assert [each[:2] for each in asked] == [(0, 1), (0, 2)]
    for side, k in enumerate((0, 1)):
        first = np.unique(found[k].place, return_index=True)[1]
        there = found[k].colrow[first[kept.places[:, side]]]
        free = found[k].colrow[~fixed[k]]
        assert there == pytest.approx(free[ground])
