"""How an image sees a place: a pinhole whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from geomosaic.sensor.map_to_image import views

CAMERA, FOCAL = np.array([100.0, 200.0, 1000.0]), 5000.0


class Pinhole:
    """A vertical pinhole camera, focal length in pixels."""

    def __init__(self, uses_heights: bool = True) -> None:
        self.uses_heights = uses_heights

    def __call__(self, xy: np.ndarray, z: np.ndarray) -> np.ndarray:
        depth = CAMERA[2] - (z if self.uses_heights else 0.0 * z)
        away = np.column_stack([xy[:, 0] - CAMERA[0], CAMERA[1] - xy[:, 1]])
        return np.where(depth > 0, 1.0, np.nan)[:, None] * FOCAL * away / depth[:, None]


def test_angle_direction_and_resolution_of_a_vertical_camera():
    xy = np.array([[100.0, 200.0], [600.0, 200.0], [100.0, -300.0], [400.0, 600.0]])
    z = np.array([0.0, 500.0, 0.0, 100.0])
    seen = views(Pinhole(), xy, z, np.ones(2), 0.5)
    away, depth = CAMERA[:2] - xy, CAMERA[2] - z
    assert seen.angle == pytest.approx(np.degrees(np.arctan2(np.hypot(*away.T), depth)), abs=1e-4)
    assert seen.azimuth[1:] == pytest.approx(np.degrees(np.arctan2(away[1:, 0], away[1:, 1])) % 360, abs=1e-4)
    assert seen.sampling == pytest.approx(depth / FOCAL, rel=1e-6)


def test_units_of_the_map_do_not_matter():
    class Feet(Pinhole):
        def __call__(self, xy, z):
            return super().__call__(xy * 0.3048, z)

    xy, z = np.array([[600.0, 500.0]]), np.array([20.0])
    metres = views(Pinhole(), xy, z, np.ones(2), 0.5)
    feet = views(Feet(), xy / 0.3048, z, np.full(2, 0.3048), 0.5)
    assert feet.angle == pytest.approx(metres.angle)
    assert feet.sampling == pytest.approx(metres.sampling)


def test_without_heights_one_looks_down_and_what_is_not_seen_has_no_view():
    flat = views(Pinhole(uses_heights=False), np.array([[600.0, 500.0]]), np.zeros(1), np.ones(2), 0.5)
    assert flat.angle == pytest.approx([0])
    assert flat.sampling == pytest.approx([0.2])
    behind = views(Pinhole(), np.array([[0.0, 0.0]]), np.array([2000.0]), np.ones(2), 0.5)
    assert np.isnan([behind.angle, behind.azimuth, behind.sampling]).all()
