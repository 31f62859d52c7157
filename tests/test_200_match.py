"""Tie points of real photos of which nothing is known, adjusted with the camera's calibration."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

import geomosaic as gm
from geomosaic.geo.local_frames import local_frame_crs

# Canon EOS Rebel XSi: 22.2 mm across 4272 pixels, 30 mm after EXIF.
CAMERA = gm.Camera(size=(4272, 2848), focal_length_px=30.0 / 22.2 * 4272)


@pytest.mark.slow
@pytest.mark.parametrize(("count", "least"), [(3, 800), (8, 2000)], ids=["three", "all"])
def test_kite_photos_of_unknown_orientation_fit_to_a_fraction_of_a_pixel(
    real_data: Callable[[str], Path], count: int, least: int
) -> None:
    photos = sorted((real_data("odm-copr") / "images").glob("*.jpg"))[:count]
    block = gm.Block(photos, "frame", camera=CAMERA, crs=local_frame_crs().to_wkt())
    matched = gm.match(block)
    assert matched.alone == ()
    assert len(matched.rays) > least
    adjusted = gm.adjust(block, ties=matched.ties, interior=["focal_length=50", "k1", "k2"])
    images = adjusted.facts["observations"][0]
    assert images["rejected"] < 0.08 * images["used"]
    assert images["rms"] < 0.5
