"""Holding a product against a reference: the numbers it gives, whatever is read at once."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from affine import Affine

from geomosaic.accuracy import product_check as check
from geomosaic.accuracy.product_check import against_reference
from geomosaic.errors import InputError
from geomosaic.options.render import RunningOptions


def picture(path: Path, left: float, top: float, size: int, brighter: float = 0.0, **profile: Any) -> Path:
    """A ground of waves, sampled at pixel centres of 2 m."""
    x, y = np.meshgrid(left + 2 * np.arange(size) + 1, top - 2 * np.arange(size) - 1)
    waves = [np.sin(x / a + b) * np.cos(y / c) for a, b, c in ((11.0, 0.3, 17.0), (23.0, 1.7, 13.0), (37.0, 0.9, 41.0))]
    values = np.stack([120 + brighter + 30 * sum(waves), 90 + brighter + 25 * waves[0] + 20 * waves[2]])
    kind = {"driver": "GTiff", "dtype": "float32", "crs": "EPSG:32633", "transform": Affine(2, 0, left, 0, -2, top)}
    with rasterio.open(path, "w", count=2, width=size, height=size, **(kind | profile)) as file:
        file.write(values.astype(np.float32))
    return path


@pytest.mark.parametrize("strip", [1, 3_000_000, 1 << 40])
def test_shift_and_colour_are_found_whatever_is_read_at_once(tmp_path, monkeypatch, strip):
    monkeypatch.setattr(check, "_STRIP", strip)
    truth = picture(tmp_path / "truth.tif", 400_000, 5_500_000, 500)
    product = picture(tmp_path / "product.tif", 399_980, 5_500_020, 600, brighter=4.0)
    with rasterio.open(product, "r+") as file:  # said to lie 0.8 m too far east and 0.4 m too far north
        file.transform = Affine.translation(0.8, 0.4) @ file.transform
    found = against_reference(product, truth)
    assert found["tiles"] == found["matched"] == 49
    assert found["pixels"] == 500 * 500
    assert found["shift_m"] == pytest.approx([0.8, -0.4], abs=0.02)
    assert found["registration_rms_px"] == pytest.approx(np.hypot(0.4, 0.2), abs=0.01)
    assert found["colour_bias"] == pytest.approx([4.0, 4.0], abs=0.5)


def test_strips_make_no_difference(tmp_path, monkeypatch):
    truth = picture(tmp_path / "truth.tif", 400_000, 5_500_000, 333)
    product = picture(tmp_path / "product.tif", 400_031, 5_499_957, 300, crs="EPSG:25833")
    whole = against_reference(product, truth, tile=32)
    for strip in (1, 500_000):
        monkeypatch.setattr(check, "_STRIP", strip)
        part = against_reference(product, truth, tile=32, running=RunningOptions(threads=2))
        assert part.keys() == whole.keys()
        for name, value in whole.items():
            assert part[name] == pytest.approx(value, rel=1e-12, abs=1e-12), name
        assert part["pixels"] == whole["pixels"]
        assert part["tiles"] == whole["tiles"] > 20


def test_a_reference_that_is_smaller_than_a_tile_and_one_elsewhere(tmp_path):
    truth = picture(tmp_path / "truth.tif", 400_000, 5_500_000, 40)
    product = picture(tmp_path / "product.tif", 399_980, 5_500_020, 100)
    found = against_reference(product, truth)
    assert (found["tiles"], found["pixels"]) == (0, 1600)
    away = picture(tmp_path / "away.tif", 500_000, 5_500_000, 40)
    with pytest.raises(InputError, match="share no pixel"):
        against_reference(product, away)
