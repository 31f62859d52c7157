"""No colour creep over a strip of fifty photos, and nothing lost where nothing could creep."""

from __future__ import annotations

import numpy as np
import pytest

from geomosaic.radiometry import overlaps
from geomosaic.radiometry.gain_offset import solve_gain_offset
from geomosaic.radiometry.overlaps import Overlap

PHOTOS = 50


def strip(bias: float, noise: float, exposure: np.ndarray, seed: int, partners: int = 2) -> list[Overlap]:
    """Each photo overlaps the next two; light falls off along the flight, so that each overlap is off by `bias`."""
    rng = np.random.default_rng(seed)
    pairs = []
    for i in range(PHOTOS):
        for j in range(i + 1, min(i + 1 + partners, PHOTOS)):
            ground = rng.normal(110, 25, (300, 1))
            off = 1 + bias * (j - i)
            a = exposure[i] * (ground + rng.normal(0, noise, ground.shape))
            b = exposure[j] * (off * ground + rng.normal(0, noise, ground.shape))
            pairs.append(Overlap(i, j, a, b))
    return pairs


def level(exposure: np.ndarray, solved) -> np.ndarray:
    """Brightness of ground of 110 after correction, over its mean."""
    shown = solved.gain[:, 0] * exposure * 110 + solved.offset[:, 0]
    return np.asarray(shown / shown.mean())


def creep(shown: np.ndarray) -> float:
    """Largest departure of the mean of ten photos from the mean of all."""
    means = np.convolve(shown, np.ones(10) / 10, mode="valid")
    return float(np.abs(means - 1).max())


def exposures(seed: int) -> np.ndarray:
    drawn = np.random.default_rng(seed).normal(0, 0.1, PHOTOS)
    return np.exp(drawn - drawn.mean())


@pytest.mark.parametrize("seed", range(3))
def test_a_bias_of_each_overlap_does_not_add_up(seed: int) -> None:
    exposure, bias = exposures(seed), 0.01
    pairs = strip(bias, 5.0, exposure, seed)
    free, held = (creep(level(exposure, solve_gain_offset(PHOTOS, 1, pairs, hold=hold))) for hold in (False, True))
    # What the hold allows, and what the means of ten exposures vary by themselves.
    bound = bias * overlaps.SIGMA_RATIO * 0.1 / overlaps.MIN_SIGMA + creep(exposure / exposure.mean())
    assert free > 0.15, "the strip would not creep, and shows nothing"
    assert held < bound, f"creep {held:.3f}, without the hold {free:.3f}"
    assert held < 0.6 * free, f"creep {held:.3f}, without the hold {free:.3f}"


def test_noise_alone_does_not_walk_away() -> None:
    """Poor overlaps, ground that changes between photos: a random walk without the hold."""
    free, held = [], []
    for seed in range(8):
        exposure = exposures(seed)
        pairs = strip(0.0, 40.0, exposure, seed, partners=1)
        free.append(creep(level(exposure, solve_gain_offset(PHOTOS, 1, pairs, hold=False))))
        held.append(creep(level(exposure, solve_gain_offset(PHOTOS, 1, pairs, hold=True))))
    assert np.median(held) < 0.6 * np.median(free), f"{np.round(held, 3)} held, {np.round(free, 3)} free"
    assert max(held) < 0.1


def test_jumps_from_photo_to_photo_are_still_taken_out() -> None:
    """Exposures that vary by a tenth: neighbours agree after as well as without the hold."""
    exposure = exposures(9)
    pairs = strip(0.0, 2.0, exposure, 9)
    steps = {}
    for hold in (False, True):
        shown = level(exposure, solve_gain_offset(PHOTOS, 1, pairs, hold=hold))
        steps[hold] = float(np.sqrt(np.mean(np.diff(shown) ** 2)))
    assert np.sqrt(np.mean(np.diff(np.log(exposure)) ** 2)) > 0.1
    assert steps[True] < 0.005, steps


def test_a_camera_of_fixed_exposure_hardly_creeps_at_all() -> None:
    pairs = strip(0.01, 5.0, np.ones(PHOTOS), 5)
    free, held = (
        creep(level(np.ones(PHOTOS), solve_gain_offset(PHOTOS, 1, pairs, hold=hold))) for hold in (False, True)
    )
    assert free > 0.15
    assert held < 0.05, f"creep {held:.3f}, without the hold {free:.3f}"


def test_small_groups_are_left_alone() -> None:
    first, second = np.array([0, 1, 2, 4]), np.array([1, 2, 3, 5])
    assert overlaps.neighbourhoods(6, first, second) == []
    assert overlaps.connected_groups(6, first, second).tolist() == [0, 0, 0, 0, 1, 1]


def test_a_long_chain_is_one_group() -> None:
    order = np.random.default_rng(1).permutation(500)
    assert overlaps.connected_groups(500, order[:-1], order[1:]).max() == 0
