"""Gains and offsets: known ones come back, whatever the overlaps look like."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from geomosaic.radiometry.gain_offset import Balance, solve_gain_offset
from geomosaic.radiometry.overlaps import Overlap

IMAGES = 6
CHAIN = [(0, 1), (1, 2), (2, 3), (3, 4), (4, 5), (0, 3), (1, 4)]


def truth(seed: int, images: int = IMAGES, bands: int = 3) -> tuple[np.ndarray, np.ndarray]:
    """What each camera does to the ground: value = gain · ground + offset."""
    rng = np.random.default_rng(seed)
    return rng.uniform(0.7, 1.4, (images, bands)), rng.uniform(-20, 20, (images, bands))


def overlaps(
    gain: np.ndarray, offset: np.ndarray, pairs: list[tuple[int, int]], samples: int = 400, noise: float = 0.0
) -> list[Overlap]:
    rng = np.random.default_rng(3)
    found = []
    for i, j in pairs:
        ground = rng.uniform(20, 180, (samples, gain.shape[1]))
        a, b = (gain[k] * ground + offset[k] + noise * rng.normal(size=ground.shape) for k in (i, j))
        found.append(Overlap(i, j, a, b))
    return found


def expected(gain: np.ndarray, offset: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The correction that undoes the cameras, of geometric mean gain 1 and mean offset 0 over one group."""
    scale = np.exp(np.mean(np.log(gain), axis=0))
    shift = np.mean(scale * offset / gain, axis=0)
    return scale / gain, shift - scale * offset / gain


def off(solved: Balance, gain: np.ndarray, offset: np.ndarray) -> tuple[float, float]:
    g, o = expected(gain, offset)
    return float(np.abs(solved.gain - g).max()), float(np.abs(solved.offset - o).max())


def test_noise_free_values_give_the_cameras_back() -> None:
    gain, offset = truth(1)
    solved = solve_gain_offset(IMAGES, 3, overlaps(gain, offset, CHAIN))
    dg, do = off(solved, gain, offset)
    # The prior holds against an overlap as 1 against LEAST_SIGMA: 1e-5 of the corrections.
    assert dg < 2e-5, f"gain off by {dg:.2e}"
    assert do < 2e-3, f"offset off by {do:.2e} grey values"
    assert (solved.before > 10).all()
    assert (solved.after < 2e-3).all()
    assert solved.overlaps == len(CHAIN)


def test_the_gauge_is_geometric_mean_gain_one_and_mean_offset_zero() -> None:
    gain, offset = truth(2)
    solved = solve_gain_offset(IMAGES, 3, overlaps(gain, offset, CHAIN, noise=2.0))
    assert np.allclose(np.log(solved.gain).mean(axis=0), 0.0, atol=1e-10)
    assert np.allclose(solved.offset.mean(axis=0), 0.0, atol=1e-9)


def test_the_order_of_a_pair_does_not_matter() -> None:
    gain, offset = truth(4)
    pairs = overlaps(gain, offset, CHAIN, noise=1.0)
    turned = [Overlap(p.second, p.first, p.b, p.a) for p in pairs]
    one, other = solve_gain_offset(IMAGES, 3, pairs), solve_gain_offset(IMAGES, 3, turned)
    assert np.allclose(one.gain, other.gain, atol=1e-10)
    assert np.allclose(one.offset, other.offset, atol=1e-8)


def test_noise_and_gross_errors_stay_within_tolerance() -> None:
    """Two grey values of noise, and one sample in twenty shows something else: a car, a leaning house."""
    gain, offset = truth(5)
    clean = overlaps(gain, offset, CHAIN, noise=2.0)
    rng = np.random.default_rng(6)
    dirty = []
    for pair in clean:
        b = pair.b.copy()
        bad = rng.random(len(b)) < 0.05
        b[bad] = rng.uniform(0, 255, (int(bad.sum()), b.shape[1]))
        dirty.append(Overlap(pair.first, pair.second, pair.a, b))
    dg, do = off(solve_gain_offset(IMAGES, 3, clean), gain, offset)
    assert dg < 0.01
    assert do < 1.0
    dg, do = off(solve_gain_offset(IMAGES, 3, dirty), gain, offset)
    assert dg < 0.02, f"gain off by {dg:.4f}"
    assert do < 2.0, f"offset off by {do:.2f}"


def test_each_connected_group_has_its_own_gauge() -> None:
    gain, offset = truth(7)
    pairs = overlaps(gain, offset, [(0, 1), (1, 2), (3, 4)])
    solved = solve_gain_offset(IMAGES, 3, pairs)
    for group in ([0, 1, 2], [3, 4]):
        g, o = expected(gain[group], offset[group])
        assert np.allclose(solved.gain[group], g, atol=2e-5)
        assert np.allclose(solved.offset[group], o, atol=2e-3)
        assert np.allclose(np.log(solved.gain[group]).mean(axis=0), 0.0, atol=1e-10)
        assert np.allclose(solved.offset[group].mean(axis=0), 0.0, atol=1e-8)
    assert (solved.gain[5] == 1).all()  # alone, so left as it is
    assert (solved.offset[5] == 0).all()


def test_without_overlaps_nothing_changes() -> None:
    empty = Overlap(0, 1, np.zeros((0, 2)), np.zeros((0, 2)))
    for pairs in ([], [empty]):
        solved = solve_gain_offset(3, 2, pairs)
        assert (solved.gain == 1).all()
        assert (solved.offset == 0).all()
        assert np.isnan(solved.before).all()
        assert solved.overlaps == 0


def test_one_image_alone() -> None:
    solved = solve_gain_offset(1, 3, [])
    assert solved.gain.shape == (1, 3)
    assert (solved.gain == 1).all()


def test_overlaps_of_one_tone_are_still_matched() -> None:
    """Water everywhere: gain and offset cannot be told apart, but the tones can be made equal."""
    a, b = np.full((50, 1), 80.0), np.full((50, 1), 100.0)
    solved = solve_gain_offset(2, 1, [Overlap(0, 1, a, b)])
    assert np.isfinite(solved.gain).all()
    assert solved.after[0] == pytest.approx(0.0, abs=1e-3)
    assert (solved.gain == 1).all()  # nothing is known of it


def test_bands_do_not_mix() -> None:
    gain, offset = truth(8)
    pairs = overlaps(gain, offset, CHAIN, noise=1.0)
    both = solve_gain_offset(IMAGES, 3, pairs)
    alone = solve_gain_offset(IMAGES, 1, [Overlap(p.first, p.second, p.a[:, 1:2], p.b[:, 1:2]) for p in pairs])
    assert np.allclose(both.gain[:, 1], alone.gain[:, 0], atol=1e-12)


def test_a_small_block_does_not_load_scipy() -> None:
    """It takes 0.3 s, longer than the solution."""
    code = """
import sys
import numpy as np
from geomosaic.radiometry.overlaps import Overlap
from geomosaic.radiometry.gain_offset import solve_gain_offset
values = np.arange(100.0)[:, None]
assert solve_gain_offset(3, 1, [Overlap(0, 1, values, 0.8 * values)]).gain[1, 0] > 1.1
assert "scipy" not in sys.modules
"""
    subprocess.run([sys.executable, "-c", code], check=True)
