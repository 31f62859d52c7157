"""Heights at pixels' centres: none half-way up a wall; the kernel against NumPy."""

from __future__ import annotations

import numpy as np
import numpy_occlusion as oracle
import pytest

from geomosaic.resample.occlusion import Way, upright
from geomosaic.types import Float32Array


def placed(heights: Float32Array, way: Way, wall: float, shape: tuple[int, int]) -> Float32Array:
    """Heights at pixels, once the kernel and NumPy agree on them."""
    found, expected = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.float32)
    upright(heights, way, wall, found)
    oracle.upright(heights, way, wall, expected)
    np.testing.assert_array_equal(found, expected)
    return found


@pytest.mark.parametrize("way", [(1.0, 0.0, 1.0, 0.0), (0.25, 0.1, 0.25, -0.4), (0.3, 2.0, -0.3, 30.0)])
def test_the_kernel_gives_what_numpy_does(way: Way) -> None:
    rng = np.random.default_rng(3)
    heights = rng.normal(0.0, 0.5, (40, 50)).astype(np.float32)
    for _ in range(12):
        r, c = rng.integers(0, 40, 2).tolist()
        heights[r : r + 6, c : c + 5] += np.float32(rng.uniform(3, 30))
    heights[rng.integers(0, 40, 6), rng.integers(0, 50, 6)] = np.nan
    one = placed(heights, way, 1.5, (120, 130))
    assert np.isnan(one).any()
    assert np.isfinite(one).mean() > 0.1


def test_nodes_keep_their_heights_and_unknown_ones_of_no_weight_do_not_matter() -> None:
    heights = np.random.default_rng(4).uniform(0, 30, (20, 30)).astype(np.float32)
    heights[5, 7] = np.nan
    for way in ((1.0, 0.0, 1.0, 0.0), (1.0, 1e-9, 1.0, -1e-9)):
        np.testing.assert_array_equal(placed(heights, way, 1.5, (20, 30)), heights)


def test_a_wall_stands_upright_half_way_and_a_slope_stays() -> None:
    """A roof that rises by 1 in 10, its wall between two nodes; ground that rises likewise: no height between both."""
    x = np.arange(40, dtype=np.float32)
    heights = np.broadcast_to(np.where(x < 20, 0.1 * x, 12.0 + 0.1 * x), (30, 40)).astype(np.float32)
    step = 0.125
    found = placed(heights, (step, 0.0625, step, 0.0), 1.5, (80, 300))
    place = step * np.arange(300) + 0.0625
    expected = 0.1 * place + np.where(place < 19.5, 0.0, 12.0)
    beside = np.abs(place - 19.5) < 0.5
    np.testing.assert_allclose(found[:, ~beside], np.broadcast_to(expected, found.shape)[:, ~beside], atol=1e-5)
    np.testing.assert_allclose(found[:, beside], np.broadcast_to(expected, found.shape)[:, beside], atol=0.05)
    gentle = np.broadcast_to(1.2 * x, (30, 40)).astype(np.float32)
    found = placed(gentle, (step, 0.0, step, 0.0), 1.5, (80, 300))
    np.testing.assert_allclose(found, np.broadcast_to(1.2 * step * np.arange(300), found.shape), rtol=1e-6)
