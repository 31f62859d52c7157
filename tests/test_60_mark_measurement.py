"""Centres of marks that were pointed at roughly, against drawn marks of known place."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtr

from geomosaic.matching.marks import measure_mark


def picture(kind: str, centre: tuple[float, float], seed: int) -> np.ndarray:
    """Blurred mark of 11 pixels, 80 grey values lighter than an uneven, noisy ground."""
    rows, cols = np.mgrid[0:80, 0:80]
    x, y = cols + 0.5 - centre[0], rows + 0.5 - centre[1]

    def within(distance: np.ndarray, half: float) -> np.ndarray:
        return ndtr((half - abs(distance)) / 0.7)

    inside = {
        "disc": lambda: within(np.hypot(x, y), 5.5),
        "ring": lambda: within(np.hypot(x, y) - 4.5, 1.0),
        "cross": lambda: np.maximum(within(x, 1.0) * within(y, 6.0), within(y, 1.0) * within(x, 6.0)),
        "square": lambda: within(x, 4.6) * within(y, 4.6),
    }[kind]()
    noise = np.random.default_rng(seed).normal(0.0, 1.5, x.shape)
    return 60.0 + 80.0 * inside + 0.15 * (cols - 40) + noise


@pytest.mark.parametrize("kind", ["disc", "ring", "cross", "square"])
def test_centres_are_found_to_about_a_hundredth_of_a_pixel(kind: str) -> None:
    random = np.random.default_rng(3)
    errors, sigmas = [], []
    for seed in range(20):
        centre = tuple(40.0 + random.uniform(-0.5, 0.5, 2))
        pointed = tuple(np.array(centre) + random.uniform(-6.0, 6.0, 2))
        found = measure_mark(picture(kind, centre, seed), pointed)
        assert found.found
        errors.append(np.array([found.col, found.row]) - centre)
        sigmas.append(found.sigma)
    rms = float(np.sqrt(np.mean(np.square(errors))))
    assert rms < 0.015
    assert 0.6 < rms / np.mean(sigmas) < 2.0


def test_where_there_is_no_mark_nothing_is_found() -> None:
    random = np.random.default_rng(1)
    assert not measure_mark(random.normal(100.0, 5.0, (80, 80)), (40.0, 40.0)).found
    assert not measure_mark(np.full((80, 80), 7.0), (40.0, 40.0)).found
    assert not measure_mark(picture("disc", (40.0, 40.0), 1), (4.0, 40.0)).found
