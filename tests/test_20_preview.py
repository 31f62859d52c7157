"""Checksums and small pictures of files."""

from __future__ import annotations

import numpy as np
import pytest
from raster_rig import holes, picture, write_raster

from geomosaic.digests import sha256
from geomosaic.errors import InputError
from geomosaic.raster.pictures import line_picture, png_bytes, preview


def test_a_digest_is_that_of_the_standard_and_a_missing_file_is_named(tmp_path):
    (tmp_path / "f").write_bytes(b"abc")
    assert sha256(tmp_path / "f") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    with pytest.raises(InputError, match="cannot be read"):
        sha256(tmp_path / "none")


def test_a_preview_shows_the_raster_made_small(tmp_path):
    from io import BytesIO

    from PIL import Image

    values, valid = picture(dtype="uint16"), holes()
    values[valid == 0] = 60_000
    path = write_raster(tmp_path / "o.tif", values, valid)
    rgb, seen = preview(path, 300)
    assert rgb.shape == (233, 300, 3)
    assert rgb.dtype == np.uint8
    assert 0.9 < seen.mean() < 0.97
    assert rgb[seen != 0].std() > 40  # the stretch knows nothing of the holes
    with Image.open(BytesIO(png_bytes(rgb, seen))) as image:
        assert image.mode == "RGBA"
        np.testing.assert_array_equal(np.asarray(image)[:, :, 3] != 0, seen != 0)
    grey, _ = preview(write_raster(tmp_path / "g.tif", picture(bands=1)), 5000)
    assert grey.shape == (700, 900, 3)
    assert (grey[:, :, 0] == grey[:, :, 2]).all()


def test_the_outline_of_a_drawing_is_seen_on_all_four_sides() -> None:
    ring = np.array([[0.0, 0.0], [300.0, 0.0], [300.0, 200.0], [0.0, 200.0], [0.0, 0.0]])
    rgb, _ = line_picture([ring], (300, 200), 60)
    grey = (rgb == (70, 90, 100)).all(axis=2)
    assert rgb.shape == (40, 60, 3)
    assert all(side.all() for side in (grey[0], grey[-1], grey[:, 0], grey[:, -1]))
    assert not grey[1:-1, 1:-1].any()
