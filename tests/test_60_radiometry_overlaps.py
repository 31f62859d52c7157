"""What pairs of images have in common: the right cells, few of them, and no image kept for longer than needed."""

from __future__ import annotations

import numpy as np
import pytest

from geomosaic.geo.grid import Window
from geomosaic.radiometry.gain_offset import solve_gain_offset
from geomosaic.radiometry.overlaps import MAX_CELLS, MIN_CELLS, Overlaps, Thumbnail, golden_ratio_sample, overlap_of


def place(window: Window, bands: int = 2, valid: np.ndarray | None = None) -> Thumbnail:
    """Values that say where they are: col and row of the coarse grid."""
    cols, rows = np.meshgrid(np.arange(window.col, window.stop_col), np.arange(window.row, window.stop_row))
    values = np.stack([cols, rows], axis=2)[:, :, :bands].astype(np.float32)
    return Thumbnail(window, values, np.ones(values.shape[:2], dtype=np.uint8) if valid is None else valid)


def gathered(
    pieces: list[Thumbnail], clipped: tuple[float, float] | None = None, order: list[int] | None = None
) -> Overlaps:
    overlaps = Overlaps([piece.window for piece in pieces], clipped)
    for index in order or range(len(pieces)):
        overlaps.add(index, pieces[index])
    return overlaps


def test_a_pair_holds_the_same_ground() -> None:
    pair = overlap_of(0, 1, place(Window(3, 5, 20, 12)), place(Window(10, 0, 30, 9)))
    assert pair is not None
    assert np.array_equal(pair.a, pair.b)
    assert len(pair.a) == 13 * 4
    assert pair.a.min(axis=0).tolist() == [10, 5]
    assert pair.a.max(axis=0).tolist() == [22, 8]


def test_cells_that_one_does_not_show_are_left_out() -> None:
    valid = np.ones((20, 20), dtype=np.uint8)
    valid[:, :15] = 0
    window = Window(0, 0, 20, 20)
    pair = overlap_of(0, 1, place(window), place(window, valid=valid))
    assert pair is not None
    assert len(pair.a) == 5 * 20
    valid[MIN_CELLS - 1 :] = 0
    valid[: MIN_CELLS - 1, 1:] = 0
    assert overlap_of(0, 1, place(window), place(window, valid=valid)) is None


def test_a_share_of_the_cells_of_a_large_overlap_covers_it() -> None:
    """Whatever the width: a stride that equals it would see a single column."""
    for width in range(30, 97):
        window = Window(0, 0, width, 96)
        pair = overlap_of(0, 1, place(window), place(window))
        assert pair is not None
        assert 0.98 * MAX_CELLS < len(pair.a) <= MAX_CELLS
        assert pair.a.dtype == np.float32
        across, down = (np.histogram(pair.a[:, k], 6, (-0.5, n - 0.5))[0] for k, n in ((0, width), (1, 96)))
        for part in (across, down):
            assert part.min() > 0.6 * MAX_CELLS / 6, (width, part)
    assert golden_ratio_sample(40).tolist() == list(range(40))


@pytest.mark.parametrize("order", [list(range(12)), list(range(12))[::-1], [5, 0, 11, 3, 8, 1, 10, 2, 9, 4, 7, 6]])
def test_the_order_of_coming_does_not_matter(order: list[int]) -> None:
    pieces = [place(Window(10 * i, 0, 25, 30)) for i in range(12)]
    found = gathered(pieces, order=order).found
    assert [(p.first, p.second) for p in found] == [(i, j) for i in range(12) for j in (i + 1, i + 2) if j < 12]
    assert all(np.array_equal(p.a, p.b) for p in found)


def test_thumbnails_are_forgotten_when_all_partners_came() -> None:
    pieces = [place(Window(10 * i, 0, 25, 30)) for i in range(50)]
    overlaps, most = Overlaps([piece.window for piece in pieces]), 0
    for index, piece in enumerate(pieces):
        overlaps.add(index, piece)
        most = max(most, overlaps.kept)
    assert most == 2  # the next two may still need them
    assert overlaps.kept == 0
    assert len(overlaps.found) == 49 + 48


def test_a_photo_outside_the_output_meets_nobody() -> None:
    pieces = [place(Window(0, 0, 20, 20)), place(Window(20, 5, 0, 10)), place(Window(5, 5, 20, 20))]
    overlaps = gathered(pieces)
    assert [(p.first, p.second) for p in overlaps.found] == [(0, 2)]
    assert overlaps.kept == 0


def test_clipped_values_do_not_bias_gains() -> None:
    """The brighter photo has lost its brightest tenth: kept, those cells made its gain 4 % too large."""
    rng = np.random.default_rng(2)
    ground = rng.normal(100, 30, (100, 200, 1))
    gain = (1.3, 0.8)
    window = Window(0, 0, 200, 100)
    pieces = []
    for g in gain:
        values = np.clip(g * (ground + rng.normal(0, 4, ground.shape)), 0, 1.3 * 138).astype(np.float32)
        pieces.append(Thumbnail(window, values, np.ones(values.shape[:2], dtype=np.uint8)))
    solved = [solve_gain_offset(2, 1, gathered(pieces, clipped).found) for clipped in (None, (0.0, 1.3 * 138))]
    kept, left_out = (s.gain[1, 0] / s.gain[0, 0] / (gain[0] / gain[1]) - 1 for s in solved)
    assert abs(kept) > 0.03  # the test can fail
    assert abs(left_out) < 0.015, left_out
