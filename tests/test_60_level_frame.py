"""Frame of a block that lies nowhere, of blocks that were turned and scaled at random."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geomosaic.orientation.block.level_frame import UNITS, level_frame


def flight(strips: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Points of rolling ground that falls to the south, and camera positions of level strips along x."""
    random = np.random.default_rng(seed)
    xy = random.uniform([-600.0, -200.0 * strips], [600.0, 200.0 * strips], (800, 2))
    slope = 0.15 if strips > 1 else 0.0
    points = np.column_stack([xy, 20.0 * np.sin(xy[:, 0] / 80.0) * np.cos(xy[:, 1] / 60.0) + slope * xy[:, 1]])
    x, y = np.meshgrid(np.linspace(-500.0, 500.0, 6), 150.0 * (np.arange(strips) - (strips - 1) / 2.0))
    centres = np.column_stack([x.ravel(), y.ravel(), 500.0 + random.normal(0.0, 3.0, x.size)])
    return points, centres


@pytest.mark.parametrize("strips", [3, 1])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_turned_block_is_level_again_with_the_flight_to_the_east(strips: int, seed: int):
    points, centres = flight(strips, seed)
    turn, factor, shift = Rotation.random(random_state=seed).as_matrix(), 0.037, np.array([3.0, -8.0, 1.0])
    points[::9] = np.nan
    there = [factor * xyz @ turn.T + shift for xyz in (points, centres)]
    frame, of_cameras = level_frame(*there)
    assert of_cameras == (strips > 1)
    back = frame.rotation @ turn
    assert np.linalg.det(frame.rotation) == pytest.approx(1.0)
    assert back[2] @ [0.0, 0.0, 1.0] > np.cos(np.radians(1.0))
    assert back[0] @ [1.0, 0.0, 0.0] > np.cos(np.radians(2.0))
    heights = frame.places(there[1])[:, 2] - np.nanmedian(frame.places(there[0]), axis=0)[2]
    assert np.median(heights) == pytest.approx(UNITS, rel=0.01)


def test_places_of_false_matches_do_not_tilt_it():
    points, centres = flight(1)
    random = np.random.default_rng(3)
    points[:80] += random.normal([0.0, 0.0, 5000.0], 4000.0, (80, 3))
    frame, _ = level_frame(points, centres)
    assert frame.rotation[2] @ [0.0, 0.0, 1.0] > np.cos(np.radians(1.0))


def test_the_plane_of_many_points_is_found_without_a_matrix_of_all_pairs():
    points, centres = flight(1)
    points = np.tile(points, (60, 1)) + np.random.default_rng(4).normal(0.0, 0.1, (48_000, 3))
    tracemalloc.start()
    frame, _ = level_frame(points, centres[:2])
    held = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert frame.rotation[2] @ [0.0, 0.0, 1.0] > np.cos(np.radians(1.0))
    assert held < 100 * points.nbytes


def test_a_known_size_is_kept():
    points, centres = flight(3)
    frame, _ = level_frame(points, centres, scale=2.5)
    assert frame.scale == 2.5
