"""Spot heights: prominence against its definition, and summits of a ground that is a formula."""

from __future__ import annotations

import numpy as np
import pytest
from affine import Affine
from scipy.ndimage import label

from geomosaic.errors import InputError
from geomosaic.relief.contour_smoothing import Heights
from geomosaic.relief.spot_heights import find_spots, prominences


def defined(values: np.ndarray, row: int, col: int) -> float:
    """Height above the highest level from which a walk to higher ground exists: by labels of each level, one by one."""
    top = values[row, col]
    for level in np.unique(values[values < top])[::-1]:
        areas, _ = label(np.nan_to_num(values, nan=-1e9) >= level, np.ones((3, 3)))
        if np.nanmax(values[areas == areas[row, col]]) > top:
            return float(top - level)
    return float(top - np.nanmin(values))


def test_prominence_is_what_its_definition_says() -> None:
    """On random heights without ties, with unknown nodes: every summit, by an independent search."""
    rng = np.random.default_rng(3)
    values = rng.permutation(24 * 30).astype(float).reshape(24, 30)
    values = values + np.roll(values, 1, 0) * 0.7 + np.roll(values, 1, 1) * 0.71
    values[5:8, 11:14] = np.nan
    found = prominences(values)
    tops = np.argwhere(found > 0)
    assert len(tops) > 20
    for row, col in tops:
        assert found[row, col] == pytest.approx(defined(values, row, col))
    near = np.stack([values[1 + i : 23 + i, 1 + j : 29 + j] for i in (-1, 0, 1) for j in (-1, 0, 1)])
    highest = values[1:-1, 1:-1] == near.max(axis=0)  # NaN among the neighbours is no summit
    assert (highest == (found[1:-1, 1:-1] > 0)).all()
    assert not found[[0, -1]].any()
    assert not found[:, [0, -1]].any()


def test_summits_and_hollows_of_a_formula() -> None:
    """Three hills and a pit on a slope: place, height and kind; a low hill and a close one are left out as asked."""
    t = Affine(10.0, 0.0, 5_000.0, 0.0, -10.0, 9_000.0)
    x = 5_000.0 + 10.0 * (np.arange(200) + 0.5)
    y = 9_000.0 - 10.0 * (np.arange(150) + 0.5)
    hills = [
        (5405.0, 8495.0, 60.0),
        (6405.0, 8295.0, 40.0),
        (6555.0, 8295.0, 30.0),
        (6005.0, 7895.0, -50.0),
        (5605.0, 7795.0, 4.0),
    ]
    z = 300.0 + 0.002 * (x[None] - 6000.0) + np.zeros((150, 1))
    for u, v, height in hills:
        z = z + height * np.exp(-((x[None] - u) ** 2 + (y[:, None] - v) ** 2) / (2 * 45.0**2))
    heights = Heights(z, t)
    found = find_spots(heights, 10.0, 100.0)
    assert (found[0].x, found[0].y, found[0].hollow) == (5405.0, 8495.0, False)
    assert {(s.x, s.y) for s in found} == {(u, v) for u, v, height in hills if abs(height) > 10}
    assert [s.hollow for s in found if s.x == 6005.0] == [True]
    for spot in found:
        assert spot.height == z[round((9_000.0 - spot.y) / 10 - 0.5), round((spot.x - 5_000.0) / 10 - 0.5)]
    assert [s.prominence for s in found] == sorted((s.prominence for s in found), reverse=True)
    assert len(find_spots(heights, 2.0, 100.0)) == 5
    close = find_spots(heights, 10.0, 200.0)
    assert (6555.0, 8295.0) not in {(s.x, s.y) for s in close}
    assert len(close) == 3


def test_nothing_stands_out() -> None:
    t = Affine(1.0, 0.0, 0.0, 0.0, -1.0, 0.0)
    assert find_spots(Heights(np.full((9, 9), 7.0), t), 1.0, 1.0) == []
    assert find_spots(Heights(np.full((9, 9), np.nan), t), 1.0, 1.0) == []
    assert find_spots(Heights(np.add.outer(np.arange(9.0), np.arange(9.0)), t), 1.0, 1.0) == []
    with pytest.raises(InputError, match="no prominence"):
        find_spots(Heights(np.full((9, 9), 7.0), t), 0.0, 1.0)
    plateau = np.zeros((9, 9))
    plateau[3:6, 2:7] = 5.0
    assert [(s.height, s.prominence) for s in find_spots(Heights(plateau, t), 1.0, 1.0)] == [(5.0, 5.0)]
