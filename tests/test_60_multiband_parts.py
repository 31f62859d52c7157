"""Differences kept only where an image's own pixels can feel them: the same blend, to the bit."""

from __future__ import annotations

import numpy as np
import pytest

from geomosaic.resample.multiband import Part, View, corrected, differences, in_bands, parts_of, spread

SHAPE = 448, 512


@pytest.mark.parametrize("levels", [1, 3, 4])
def test_parts_are_enough(levels: int) -> None:
    """Nine images of noise with gains of their own; the shares of some have several pieces, one has none."""
    random = np.random.default_rng(levels)
    row, col = np.indices(SHAPE)
    label = (row // 150 * 3 + (col + 40 * np.sin(row / 30)) // 180).astype(np.int64).clip(0, 8)
    label[300:340, 60:90] = 2
    label[label == 7] = 6
    views = [
        View(random.integers(0, 200, (*SHAPE, 3), dtype=np.uint8), random.random(SHAPE) > 0.02 * (i % 3))
        for i in range(9)
    ]
    label[~np.take_along_axis(np.array([view.valid for view in views]), label[None], axis=0)[0]] = -1
    inside = slice(64, 400), slice(32, 480)
    made = []
    parts = parts_of(label, 9, spread(levels), levels)
    assert parts[7] is None
    assert min(part.size for part in parts if part is not None) < label.size / 2 or levels == 4
    for kept in (parts, [Part.whole(SHAPE)] * 9):
        apart = differences(views, label, 4.0, kept)
        out = np.zeros((336, 448, 3), dtype=np.float32)
        corrected(views, apart, in_bands(apart, label, levels), label, inside, out)
        made.append(out)
    assert np.array_equal(*made)
    assert (made[0][label[inside] < 0] == 0).all()
    assert made[0].std() > 30
