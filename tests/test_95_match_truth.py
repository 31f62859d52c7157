"""Tie points of photos whose every pixel is known: tilts, three scales, crossing strips, exposures, water."""

from __future__ import annotations

from pathlib import Path

import pytest
from scenery_rig import block_of, camera_of, truth_of, write_photos

import geomosaic as gm
from geomosaic.testing.synthetic.scenery import Scenery, mixed_block


@pytest.mark.parametrize(
    ("size", "layers", "tilt"),
    [
        ((400, 300), ((1, 2), (1, 1), (1, 1)), 15.0),
        pytest.param((2000, 1500), ((6, 6), (4, 4), (2, 4)), 30.0, marks=pytest.mark.slow),
    ],
)
def test_tie_points_lie_where_the_truth_puts_them(size, layers, tilt, tmp_path: Path):
    from scenery_rig import GROUND

    camera, scenery = camera_of(size), Scenery(finest=0.45, water=1 / 3)
    photos = mixed_block(GROUND, camera, layers, gsd=0.3, tilt=tilt)
    write_photos(tmp_path, photos, camera, scenery)
    matched = gm.match(block_of(tmp_path, photos, camera))
    truth = truth_of(matched.ties, photos, camera, scenery)
    assert matched.alone == ()
    assert len(truth.errors) > 100 * len(photos)
    assert truth.share_beyond(1.5) <= 1e-4
    assert truth.errors.max() < 5.0
    assert truth.rms < 0.2
    assert truth.on_water <= 1e-4 * len(matched.ties)
