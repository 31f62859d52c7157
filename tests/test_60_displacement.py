"""Displacements between two pictures from places in both: what comes back, and when a simpler one is taken."""

from __future__ import annotations

import numpy as np
import pytest

from geomosaic.matching.displacement import displacement
from geomosaic.matching.registration import Picture, agreeing_with_homography, correlated_shift

SIZE = (900, 600)
SHIFT = np.array([3.2, -1.7])


def places(count: int = 400, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform((0.0, 0.0), SIZE, (count, 2))


def noise(count: int, seed: int = 1) -> np.ndarray:
    return np.random.default_rng(seed).normal(0.0, 0.05, (count, 2))


@pytest.mark.parametrize("asked", ["shift", "affine", "local"])
def test_a_shift_is_told_whatever_was_asked_for(asked):
    one = places()
    found = displacement(one, one + SHIFT + noise(400), SIZE, asked)
    assert found.kind == "shift"
    assert found.matrix[:, 2] == pytest.approx(SHIFT, abs=0.01)
    assert found.rms == pytest.approx(0.05, rel=0.1)
    assert set(found.held_out) >= {"none", asked}


def test_no_displacement_is_told_as_none():
    one = places()
    found = displacement(one, one + noise(400) * 0.1, SIZE, "local")
    assert found.kind == "none"
    assert np.array_equal(found.matrix, np.eye(2, 3))


def test_an_affine_displacement_comes_back():
    one, matrix = places(), np.array([[1.002, -0.003, 2.0], [0.001, 0.998, -4.0]])
    other = one @ matrix[:, :2].T + matrix[:, 2]
    found = displacement(one, other + noise(400), SIZE, "affine")
    assert found.kind == "affine"
    assert np.abs(found.matrix[:, :2] - matrix[:, :2]).max() < 1e-4
    assert displacement(one, other + noise(400), SIZE, "shift").rms > 0.5


def bent(xy: np.ndarray) -> np.ndarray:
    return xy + np.column_stack([3.0 * np.sin(xy[:, 0] / 120.0), 2.0 * np.cos(xy[:, 1] / 90.0)])


def test_a_local_field_predicts_where_no_place_was_measured():
    one = places()
    found = displacement(one, bent(one) + noise(400), SIZE, "local")
    assert found.kind == "local"
    assert found.field is not None
    new = np.random.default_rng(5).uniform((50.0, 50.0), np.subtract(SIZE, 50.0), (300, 2))
    ideal = new @ found.matrix[:, :2].T + found.matrix[:, 2]
    off = ideal + found.field.at(ideal) - bent(new)
    assert np.sqrt((off**2).mean()) < 0.06
    # What it says of itself is what it does.
    assert found.held_out["local"] == pytest.approx(np.hypot(0.05, np.sqrt((off**2).mean())), rel=0.3)


def test_places_that_contradict_their_neighbours_are_left_out():
    one = places()
    other = one + SHIFT + noise(400)
    other[:25] += np.random.default_rng(3).choice([-1, 1], (25, 2)) * 6.0
    found = displacement(one, other, SIZE, "shift")
    assert not found.kept[:25].any()
    assert found.kept[25:].mean() > 0.95
    assert found.matrix[:, 2] == pytest.approx(SHIFT, abs=0.01)


def test_matches_by_chance_agree_with_nothing():
    random = np.random.default_rng(2)
    one, other = random.uniform(0.0, 1000.0, (2, 300, 2))
    assert agreeing_with_homography(one, other, 3.0) is None
    assert agreeing_with_homography(one[:5], one[:5], 3.0) is None
    other[:60] = one[:60] @ np.array([[0.9, 0.1], [-0.1, 0.9]]) + (30.0, -20.0)
    found = agreeing_with_homography(one, other, 3.0)
    assert found is not None
    assert found[1][:60].all()
    assert found[1].sum() < 70


def test_correlation_finds_a_shift_where_contrast_and_light_differ():
    random = np.random.default_rng(4)
    ground = np.cumsum(np.cumsum(random.normal(size=(260, 260)), axis=0), axis=1)
    ground += 30.0 * random.normal(size=ground.shape)
    seen = np.ones((200, 200), dtype=bool)
    first = Picture(ground[30:230, 30:230].astype(np.float32), seen)
    light = 40.0 + 0.3 * ground[18:218, 37:237] + np.linspace(0.0, 900.0, 200)[:, None]
    found = correlated_shift(first, Picture(light.astype(np.float32), seen), 25)
    assert found is not None
    assert found.matrix[:2, 2].tolist() == [-7.0, 12.0]
    other = Picture(random.normal(size=(200, 200)).astype(np.float32), seen)
    assert correlated_shift(first, other, 25) is None


def test_pictures_without_any_detail_have_no_shift():
    seen = np.ones((200, 200), dtype=bool)
    flat = Picture(np.full((200, 200), 7.0, dtype=np.float32), seen)
    detailed = Picture(np.random.default_rng(0).normal(size=(200, 200)).astype(np.float32), seen)
    for pair in ((flat, flat), (flat, detailed), (detailed, flat)):
        assert correlated_shift(*pair, 25) is None
