"""Gains and offsets where overlaps are noisy, spoilt, or many."""

from __future__ import annotations

import time

import numpy as np
import pytest

from geomosaic.errors import SolveError
from geomosaic.radiometry import gain_offset
from geomosaic.radiometry.gain_offset import solve_gain_offset, standardised_major_axis
from geomosaic.radiometry.overlaps import Overlap


def strip(count: int, gain: np.ndarray, noise: float, samples: int, seed: int) -> list[Overlap]:
    """A strip of photos of ground of mean 100 and deviation 30, noise of its own in each view of it."""
    rng = np.random.default_rng(seed)
    pairs = []
    for i in range(count - 1):
        ground = rng.normal(100, 30, (samples, 1))
        a, b = (gain[k] * (ground + rng.normal(0, noise, ground.shape)) for k in (i, i + 1))
        pairs.append(Overlap(i, i + 1, a, b))
    return pairs


def test_noise_in_both_views_does_not_bias_gains() -> None:
    """Least squares gave 0.93 to 1.14 here, for a true 1."""
    gains = np.array(
        [solve_gain_offset(10, 1, strip(10, np.ones(10), 10.0, 2000, seed)).gain[:, 0] for seed in range(20)]
    )
    bias = np.abs(np.log(gains).mean(axis=0)).max()
    assert bias < 0.01, f"{100 * bias:.2f} %"
    # And one strip strays as sampling says, (1 - rho^2) / n for each link of the chain, not as a bow from end to end.
    link = np.sqrt((1 - 0.9**2) / 2000)
    assert np.diff(np.log(gains), axis=1).std() == pytest.approx(link, rel=0.15)


def test_known_gains_come_back_through_noise() -> None:
    gain = np.exp(np.random.default_rng(1).normal(0, 0.15, 10))
    solved = solve_gain_offset(10, 1, strip(10, gain, 10.0, 20_000, seed=2))
    expected = np.exp(np.log(gain).mean()) / gain
    assert np.abs(solved.gain[:, 0] / expected - 1).max() < 0.01


def test_a_tenth_of_wrong_samples_does_no_harm() -> None:
    """What one view shows and the other does not: bright cars."""
    rng = np.random.default_rng(3)
    gain, pairs = np.array([1.3, 0.8, 1.1, 0.9]), []
    for pair in strip(4, gain, 4.0, 5000, seed=4):
        b = pair.b.copy()
        bad = rng.random(len(b)) < 0.1
        b[bad] = rng.uniform(150, 255, (int(bad.sum()), 1))
        pairs.append(Overlap(pair.first, pair.second, pair.a, b))
    solved = solve_gain_offset(4, 1, pairs)
    expected = np.exp(np.log(gain).mean()) / gain
    off = np.abs(solved.gain[:, 0] / expected - 1).max()
    assert off < 0.01, f"{100 * off:.2f} %"
    assert np.abs(solved.offset).max() < 1.0


def test_vignetting_of_both_views_cancels() -> None:
    """Light falls off to the side in one view and to the other side in the next, by a fifth at the rim."""
    rng = np.random.default_rng(5)
    pairs = []
    for i in range(9):
        x = np.tile(np.linspace(0, 1, 40), 800)[:, None]  # so many that sampling does not count
        ground = rng.normal(100, 30, x.shape)
        pairs.append(Overlap(i, i + 1, ground * (1 - 0.2 * x**2), ground * (1 - 0.2 * (1 - x) ** 2)))
    solved = solve_gain_offset(10, 1, pairs)
    assert np.abs(solved.gain - 1).max() < 0.01


def test_views_that_do_not_agree_count_little() -> None:
    """Photo 1 lies between two: one overlap is the ground, the other is noise against noise of twice the spread."""
    rng = np.random.default_rng(6)
    ground = rng.normal(100, 30, (500, 1))
    good = Overlap(0, 1, ground, ground * 0.9)
    unlike = Overlap(0, 1, rng.normal(100, 10, (500, 1)), rng.normal(100, 20, (500, 1)))
    solved = solve_gain_offset(2, 1, [good, unlike])
    assert solved.gain[0, 0] / solved.gain[1, 0] == pytest.approx(0.9, rel=0.005)


def test_one_tone_in_one_view_says_nothing_of_gains() -> None:
    rng = np.random.default_rng(7)
    textured = rng.normal(100, 20, (300, 2))
    water = np.full((300, 2), 60.0)
    solved = solve_gain_offset(3, 2, [Overlap(0, 1, textured, water), Overlap(1, 2, water, water + 5)])
    assert (solved.gain == 1).all()
    assert np.isfinite(solved.offset).all()
    assert solved.offset[1] - solved.offset[2] == pytest.approx(5.0, abs=0.01)


def test_a_relation_knows_its_own_uncertainty() -> None:
    rng = np.random.default_rng(8)
    found, said = [], []
    for _ in range(300):
        ground = rng.normal(0, 30, (400, 1))
        relation = standardised_major_axis(
            ground + rng.normal(0, 10, ground.shape), ground + rng.normal(0, 10, ground.shape)
        )
        found.append(relation.log_ratio[0])
        said.append((1 - relation.correlation[0] ** 2) / (relation.count[0] - 2))
    assert np.std(found) == pytest.approx(np.sqrt(np.mean(said)), rel=0.15)
    assert abs(np.mean(found)) < 4 * np.std(found) / np.sqrt(300)


def test_exchanged_views_give_the_opposite() -> None:
    rng = np.random.default_rng(9)
    a = rng.normal(100, 30, (500, 3))
    b = 0.7 * a + 12 + rng.normal(0, 5, a.shape)
    assert np.allclose(standardised_major_axis(a, b).log_ratio, -standardised_major_axis(b, a).log_ratio, atol=1e-12)


def test_values_that_are_not_finite_are_refused() -> None:
    bad = Overlap(0, 1, np.full((50, 1), np.nan), np.ones((50, 1)))
    with np.errstate(invalid="ignore"), pytest.raises(SolveError, match="no solution"):
        solve_gain_offset(2, 1, [bad])


def block(rows: int, cols: int, samples: int = 500) -> tuple[np.ndarray, np.ndarray, list[Overlap]]:
    """A block of photos, each overlapping with the next, the one after, and its neighbours across."""
    rng = np.random.default_rng(10)
    number = rows * cols
    gain, offset = np.exp(rng.normal(0, 0.15, (number, 3))), rng.uniform(-10, 10, (number, 3))
    pairs = []
    for i in range(number):
        for step_row, step_col in ((0, 1), (0, 2), (1, -1), (1, 0), (1, 1)):
            row, col = i // cols + step_row, i % cols + step_col
            if row < rows and 0 <= col < cols:
                ground = rng.normal(100, 30, (samples, 3))
                a, b = (gain[k] * (ground + rng.normal(0, 5, ground.shape)) + offset[k] for k in (i, row * cols + col))
                pairs.append(Overlap(i, row * cols + col, a.astype(np.float32), b.astype(np.float32)))
    return gain, offset, pairs


@pytest.mark.parametrize("size", [(5, 8), pytest.param((10, 20), marks=pytest.mark.slow)], ids=str)
def test_many_photos_are_solved_fast_and_well(monkeypatch: pytest.MonkeyPatch, size: tuple[int, int]) -> None:
    gain, offset, pairs = block(*size)
    started = time.process_time()
    solved = solve_gain_offset(len(gain), 3, pairs)
    assert time.process_time() - started < 5.0
    scale = np.exp(np.log(gain).mean(axis=0))
    off = np.log(solved.gain * gain / scale)
    assert np.sqrt((off**2).mean()) < 0.01
    assert np.abs(off).max() < 0.03
    left = solved.gain * offset + solved.offset  # of the cameras' offsets, once corrected
    assert np.std(left - left.mean(axis=0)) < 2.0
    monkeypatch.setattr(gain_offset, "MAX_DENSE", 10)
    sparse = solve_gain_offset(len(gain), 3, pairs)
    assert np.allclose(solved.gain, sparse.gain, atol=1e-12)
    assert np.allclose(solved.offset, sparse.offset, atol=1e-9)
