"""Labels put in order: islands go, the rim is filled."""

from __future__ import annotations

import numpy as np
import pytest

from geomosaic.mosaicking.seams.partition import extrapolated, without_islands, without_spurs


def test_small_islands_go_and_large_ones_stay():
    label = np.zeros((40, 40), dtype=int)
    label[:, 20:] = 1
    label[5:8, 5:8] = 1
    label[20:30, 5:15] = 1
    cleaned = without_islands(label, 30)
    assert (cleaned[5:8, 5:8] == 0).all()
    assert (cleaned[20:30, 5:15] == 1).all()
    assert (cleaned[:, 20:] == 1).all()


@pytest.mark.parametrize("cells", [1, 3])
def test_labels_are_carried_over_the_rim(cells):
    label = np.full((20, 20), -1)
    label[:, 5:10], label[:, 10:14] = 0, 1
    wide = extrapolated(label, cells)
    assert (wide[:, 5 - cells : 10] == 0).all()
    assert (wide[:, 10 : 14 + cells] == 1).all()
    assert (wide[:, : 5 - cells] == -1).all()
    assert np.array_equal(extrapolated(np.full((3, 3), -1), 2), np.full((3, 3), -1))


def test_spurs_go_and_corners_stay():
    label = np.zeros((40, 40), dtype=int)
    label[:, 20:] = 1
    label[10, 12:20] = 1
    label[25:27, 12:20] = 1  # two cells wide
    cleaned = without_spurs(label, 10)
    assert (cleaned[10, :19] == 0).all()
    assert (cleaned[25:27, 14:20] == 1).all()
    assert (cleaned[:, 20:] == 1).all()
