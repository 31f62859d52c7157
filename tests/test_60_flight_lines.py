"""Flight lines from where photos were taken."""

from __future__ import annotations

import numpy as np

from geomosaic.orientation.block.flight_lines import flight_lines


def strips(count: int, photos: int, base: float = 60.0, spacing: float = 100.0) -> np.ndarray:
    """Places of strips flown to and fro, turned by 33 degrees, with wind."""
    rows = [(s * spacing, (p if s % 2 == 0 else photos - 1 - p) * base) for s in range(count) for p in range(photos)]
    c, s = np.cos(np.radians(33.0)), np.sin(np.radians(33.0))
    return np.array(rows) @ np.array([[c, s], [-s, c]]) + np.random.default_rng(2).normal(0.0, 3.0, (len(rows), 2))


def test_strips_flown_to_and_fro_are_found_whether_their_spacing_is_larger_than_the_base_or_not() -> None:
    for spacing in (40.0, 60.0, 200.0):
        found = flight_lines(strips(5, 7, spacing=spacing))
        assert found.tolist() == np.repeat(np.arange(5), 7).tolist()


def test_a_photo_without_a_place_is_on_no_line_and_breaks_none() -> None:
    places = strips(2, 6)
    places[3] = np.nan
    assert flight_lines(places).tolist() == [0, 0, 0, -1, 0, 0, *[1] * 6]
    assert flight_lines(places[:1]).tolist() == [0]
    assert flight_lines(np.full((2, 2), np.nan)).tolist() == [-1, -1]


def test_a_line_flown_again_from_its_start_is_another_line() -> None:
    line = strips(1, 8)
    assert flight_lines(np.vstack([line, line + 5.0])).tolist() == [0] * 8 + [1] * 8
