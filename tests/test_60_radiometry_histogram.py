"""Histogram matching: known curves are undone, ranks agree with an independent implementation."""

from __future__ import annotations

import numpy as np
import pytest

from geomosaic.geo.grid import Window
from geomosaic.radiometry.corrections import ToneCurve
from geomosaic.radiometry.histogram_matching import match_overlaps, match_whole, matching_curve
from geomosaic.radiometry.overlaps import Thumbnail

SIZE = 120


def ground(cols: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Three bands of ground whose distribution changes from place to place: lakes in the east, snow in the north."""
    rng = np.random.default_rng(5)
    waves = [rng.uniform(0.05, 0.4, 2) for _ in range(3)]
    bands = [90 + 40 * np.sin(a * cols + b * rows) + 0.25 * cols - 0.1 * rows for a, b in waves]
    return np.stack(bands, axis=-1)


def piece(col: int, row: int, bend=lambda v: v, dtype: str = "float32") -> Thumbnail:
    c, r = np.meshgrid(np.arange(col, col + SIZE), np.arange(row, row + SIZE))
    values = bend(ground(c, r))
    whole = np.issubdtype(np.dtype(dtype), np.integer)
    return Thumbnail(
        Window(col, row, SIZE, SIZE),
        (np.round(values) if whole else values).astype(dtype),
        np.ones((SIZE, SIZE), np.uint8),
    )


def gamma(v: np.ndarray) -> np.ndarray:
    return 255 * (np.clip(v, 0, 255) / 255) ** 0.7 + 4


def test_a_known_curve_is_undone_by_the_overlap_of_different_images():
    master, bent = piece(0, 0), piece(60, 20, gamma)
    curves, alone = match_overlaps([master, bent], master)
    assert alone == []
    truth = piece(60, 20).values
    shared = (slice(0, SIZE - 20), slice(0, SIZE - 60))
    miss = curves[1](bent.values) - truth
    assert np.abs(miss[shared]).mean() < 0.25
    assert np.quantile(np.abs(miss[shared]), 0.99) < 1.5
    assert np.array_equal(curves[0](master.values), master.values)
    # Over whole images the lakes of one change the colours of the other.
    whole = match_whole([master, bent], master)[1](bent.values) - truth
    assert np.abs(whole).mean() > 8 * np.abs(miss[shared]).mean()


def test_a_chain_reaches_the_master_and_strangers_stay_as_they_are():
    pieces = [piece(0, 0), piece(70, 0, gamma), piece(140, 0, lambda v: 0.8 * v + 30), piece(900, 900, gamma)]
    curves, alone = match_overlaps(pieces, pieces[0])
    assert alone == [3]
    assert np.array_equal(curves[3](pieces[3].values), pieces[3].values)
    miss = curves[2](pieces[2].values) - piece(140, 0).values
    assert np.abs(miss[:, : SIZE - 70]).mean() < 0.8


@pytest.mark.parametrize(("dtype", "most"), [("uint8", 1.01), ("uint16", 1.01), ("float32", 0.5)])
def test_ranks_agree_with_an_independent_implementation(dtype, most):
    exposure = pytest.importorskip("skimage.exposure", reason="scikit-image is not installed")
    one, other = piece(0, 0, gamma, dtype), piece(30, 10, dtype=dtype)
    mine = matching_curve(one.values.reshape(-1, 3), other.values.reshape(-1, 3))(one.values)
    theirs = exposure.match_histograms(one.values, other.values, channel_axis=-1).astype(np.float64)
    inner = (slice(None),) * 2
    # Beyond the outermost of 256 ranks the curve goes on straight.
    assert np.quantile(np.abs(mine - theirs)[inner], 0.99) <= most


def test_masks_are_left_out_and_curves_only_rise():
    master, bent = piece(0, 0), piece(40, 0, gamma, "uint8")
    spoilt = bent.values.copy()
    spoilt[:30] = 0
    valid = bent.valid.copy()
    valid[:30] = 0
    curve = match_overlaps([Thumbnail(bent.window, spoilt, valid)], master)[0][0]
    steps = np.diff(curve(np.repeat(np.arange(256.0)[:, None], 3, axis=1)), axis=0)
    assert (steps >= 0).all()
    miss = curve(bent.values[30:, :80]) - piece(40, 0).values[30:, :80]
    assert np.abs(miss).mean() < 0.6


def test_too_little_in_common_changes_nothing():
    master, far = piece(0, 0), piece(SIZE - 4, SIZE - 4, gamma)
    curves, alone = match_overlaps([far], master)
    assert alone == [0]
    assert np.array_equal(curves[0](far.values), far.values)


def test_the_line_of_a_line():
    x = np.linspace(10, 200, 64)
    curve = ToneCurve([(x, 1.25 * x - 7)] * 2)
    gain, offset = curve.line()
    np.testing.assert_allclose(gain, 1.25)
    np.testing.assert_allclose(offset, -7)
