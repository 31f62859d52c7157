"""Shifts between two pictures of one analytic ground."""

from __future__ import annotations

import numpy as np
import pytest

from geomosaic.matching.shifts import Shifts, shifts

ROWS, COLS = 220, 300


def picture(dx: float = 0.0, dy: float = 0.0) -> np.ndarray:
    """A sum of waves of 6 to 60 pixels in all directions, in closed form, moved by (dx, dy)."""
    rng = np.random.default_rng(7)
    c, r = np.meshgrid(np.arange(COLS) + 0.5 - dx, np.arange(ROWS) + 0.5 - dy)
    values = np.zeros((ROWS, COLS))
    for _ in range(60):
        length, turn, phase = rng.uniform(6, 60), rng.uniform(0, np.pi), rng.uniform(0, 2 * np.pi)
        along = c * np.cos(turn) + r * np.sin(turn)
        values += np.sqrt(length) * np.sin(2 * np.pi * along / length + phase)
    return 120 + 2 * values


EVERYWHERE = np.ones((ROWS, COLS), dtype=bool)


@pytest.mark.parametrize("moved", [(0.0, 0.0), (0.3, -0.4), (1.5, 2.5), (-4.2, 3.7), (6.9, -7.1)])
def test_known_shifts_come_back(moved: tuple[float, float]) -> None:
    found = shifts(picture(), picture(*moved), EVERYWHERE)
    assert len(found.places) == 12
    assert found.matched.all()
    worst = np.abs(found.shifts - moved).max()
    assert worst < 0.02, f"worst {worst:.4f} px"
    assert found.rms == pytest.approx(np.hypot(*moved), abs=0.02)
    assert (found.correlation > 0.99).all()


def test_gain_offset_and_noise_do_not_move_it() -> None:
    rng = np.random.default_rng(1)
    second = 0.6 * picture(0.37, -1.21) + 30 + rng.normal(0, 3, (ROWS, COLS))
    found = shifts(picture() + rng.normal(0, 3, (ROWS, COLS)), second, EVERYWHERE)
    assert found.matched.all()
    assert np.abs(np.median(found.shifts, axis=0) - (0.37, -1.21)).max() < 0.02
    assert np.abs(found.shifts - (0.37, -1.21)).max() < 0.1


def test_what_cannot_match_is_nan() -> None:
    flat = np.full((ROWS, COLS), 77.0)
    rng = np.random.default_rng(2)
    for first, second in (
        (flat, flat),
        (picture(), flat),
        (flat, picture()),
        (picture(), rng.normal(120, 20, (ROWS, COLS))),
        (picture(), picture(25.0, 0.0)),  # beyond the reach
    ):
        found = shifts(first, second, EVERYWHERE)
        assert len(found.places) == 12
        assert not found.matched.any()
        assert np.isnan(found.rms)
        assert np.isnan(found.robust_rms)


def test_tiles_with_unknown_pixels_are_left_out() -> None:
    valid = EVERYWHERE.copy()
    valid[100, 150] = False
    first, second = picture(), picture(0.5, 0.5)
    first[~valid] = second[~valid] = 1e6
    found = shifts(first, second, valid)
    assert 0 < len(found.places) < 12
    assert np.abs(found.shifts - 0.5).max() < 0.02
    assert not shifts(first, second, np.zeros_like(valid)).places.size


def test_places_are_the_middles_of_tiles() -> None:
    found = shifts(picture(), picture(), EVERYWHERE, tile=64, reach=8)
    assert found.places[0].tolist() == [42.0, 42.0]  # (col, row), a margin of 10 before it
    assert found.places[1].tolist() == [106.0, 42.0]


def test_robust_rms_is_the_rms_of_normal_errors_and_ignores_gross_ones() -> None:
    rng = np.random.default_rng(3)
    sample = rng.normal(0, 0.4, (20000, 2))
    normal = Shifts(sample, sample, np.ones(len(sample)))
    assert normal.rms == pytest.approx(0.4 * np.sqrt(2), rel=0.02)
    assert normal.robust_rms == pytest.approx(normal.rms, rel=0.02)
    spoilt = sample.copy()
    spoilt[:1000] = 8.0
    assert Shifts(sample, spoilt, np.ones(len(sample))).robust_rms == pytest.approx(normal.rms, rel=0.08)
