"""Poses from three points, and from more, with no initial values."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from geomosaic.estimation.statistics import correlations
from geomosaic.sensor.solve import dangerous_cylinder, poses, three_point_poses
from geomosaic.types import FloatArray


def scene(seed: int, count: int = 3) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Bearings, points, and the centre and rotation they are made with: any tilt, any turn."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(-500.0, 500.0, (count, 3)) * [1.0, 1.0, 0.2]
    centre = np.array([*rng.uniform(-800.0, 800.0, 2), rng.uniform(600.0, 3000.0)])
    rotation = Rotation.random(random_state=seed).as_matrix()
    return (points - centre) @ rotation.T, points, centre, rotation


def unit(rays: FloatArray) -> FloatArray:
    out: FloatArray = rays / np.linalg.norm(rays, axis=1)[:, None]
    return out


@pytest.mark.parametrize("seed", range(60))
def test_the_truth_is_among_the_solutions_and_all_of_them_fit(seed: int) -> None:
    bearings, points, centre, rotation = scene(seed)
    found = three_point_poses(bearings, points)
    assert 1 <= len(found) <= 4
    best = min(found, key=lambda pose: float(np.linalg.norm(pose.centre - centre)))
    assert np.linalg.norm(best.centre - centre) < 1e-5
    assert np.abs(best.rotation - rotation).max() < 1e-8
    for pose in found:
        assert np.abs(pose.bearings(points) - unit(bearings)).max() < 1e-9
        assert np.abs(pose.rotation @ pose.rotation.T - np.eye(3)).max() < 1e-12
        assert np.linalg.det(pose.rotation) == pytest.approx(1.0)


def counted(bearings: FloatArray, points: FloatArray) -> int:
    """How many places there are, by looking: the distance to the first point is walked through, and for each the law
    of cosines gives up to two distances to the second and two to the third; each change of sign of what is left over
    in the third triangle is a place."""
    r1, r2, r3 = unit(bearings)
    a, b, c = (float(np.linalg.norm(points[i] - points[j])) for i, j in ((1, 2), (0, 2), (0, 1)))
    cos_a, cos_b, cos_c = float(r2 @ r3), float(r1 @ r3), float(r1 @ r2)
    # Beyond both bounds a triangle does not close. Equal steps in the angle, for the ends where two roots meet.
    reach = min(b / np.sqrt(1.0 - cos_b**2), c / np.sqrt(1.0 - cos_c**2))
    s1 = reach * np.sin(np.linspace(1e-4, np.pi / 2 - 1e-7, 400_001))
    found = 0
    for i in (-1.0, 1.0):
        s2 = s1 * cos_c + i * np.sqrt(np.maximum(c**2 - s1**2 * (1.0 - cos_c**2), 0.0))
        for j in (-1.0, 1.0):
            s3 = s1 * cos_b + j * np.sqrt(np.maximum(b**2 - s1**2 * (1.0 - cos_b**2), 0.0))
            left = s2**2 + s3**2 - 2.0 * s2 * s3 * cos_a - a**2
            ahead = (s2 > 0.0) & (s3 > 0.0)
            found += int(((left[1:] * left[:-1] < 0.0) & ahead[1:] & ahead[:-1]).sum())
    return found


def test_all_the_solutions_are_found() -> None:
    """As many as an independent search counts; the cases have from one to four."""
    numbers = []
    for seed in range(40):
        bearings, points, _, _ = scene(500 + seed)
        numbers.append(counted(bearings, points))
        assert len(three_point_poses(bearings, points)) == numbers[-1], f"case {seed}"
    assert set(numbers) >= {2, 4}


@pytest.mark.slow
def test_three_thousand_random_cases() -> None:
    lost = []
    for seed in range(3000):
        bearings, points, centre, _ = scene(seed)
        if min(np.linalg.norm(pose.centre - centre) for pose in three_point_poses(bearings, points)) > 1e-3:
            lost.append(seed)
    assert not lost


def test_four_solutions_of_the_regular_pyramid() -> None:
    """Above the middle of an equilateral triangle, beyond its circle's radius over √2: four real places (Grunert)."""
    turn = np.radians([90.0, 210.0, 330.0])
    points = np.column_stack([np.cos(turn), np.sin(turn), np.zeros(3)])
    found = three_point_poses(points - [0.0, 0.0, 1.5], points)
    above = [pose.centre for pose in found]
    assert len(found) == 4
    assert min(np.linalg.norm(centre - [0.0, 0.0, 1.5]) for centre in above) < 1e-9
    # The other three are alike, one towards each corner.
    others = sorted(above, key=lambda centre: float(np.hypot(*centre[:2])))[1:]
    assert np.ptp([np.linalg.norm(centre) for centre in others]) < 1e-9


def test_large_coordinates_cost_nothing() -> None:
    bearings, points, centre, _ = scene(5)
    far = np.array([4_000_000.0, 1_000_000.0, 4_800_000.0])
    found = three_point_poses(bearings, points + far)
    assert min(np.linalg.norm(pose.centre - centre - far) for pose in found) < 1e-5


def test_what_has_no_solution_is_empty() -> None:
    line = np.array([[0.0, 0, 0], [1, 1, 0], [2, 2, 0]])
    assert three_point_poses(line - [0, 0, 5.0], line) == ()
    _, points, centre, _ = scene(1)
    same = np.tile(points[:1] - centre, (3, 1))
    assert three_point_poses(same, points) == ()
    assert three_point_poses(np.full((3, 3), np.nan), points) == ()


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("count", [4, 6, 40])
def test_more_points_put_the_truth_first(count: int, flat: bool) -> None:
    for seed in range(10):
        bearings, points, centre, rotation = scene(100 + seed, count)
        if flat:
            points[:, 2] = 0.0
            bearings = (points - centre) @ rotation.T
        assert np.linalg.norm(poses(bearings, points)[0].centre - centre) < 1e-3


def test_two_wrong_points_of_nine_do_not_decide() -> None:
    for seed in range(10):
        bearings, points, centre, _ = scene(200 + seed, 9)
        bearings[[2, 5]] = bearings[[5, 2]]
        assert np.linalg.norm(poses(bearings, points)[0].centre - centre) < 1e-3


def circle(count: int = 3) -> FloatArray:
    turn = np.radians([10.0, 130.0, 200.0, 280.0])[:count]
    flat = np.column_stack([300.0 * np.cos(turn), 300.0 * np.sin(turn), np.zeros(count)])
    return flat + np.array([1000.0, 2000.0, 50.0])


def test_cylinder_by_hand() -> None:
    for centre, gap in (([1300.0, 2000.0, 900.0], 0.0), ([1000.0, 2000.0, 900.0], 1.0), ([1000.0, 2450.0, 7.0], 0.5)):
        assert dangerous_cylinder(np.array(centre), circle()) == pytest.approx(gap, abs=1e-12)
    assert dangerous_cylinder(np.zeros(3), np.outer([0.0, 1.0, 2.0], [1.0, 2.0, 3.0])) == np.inf


def conditions(gap: float, count: int) -> float:
    """Condition of the pose from `count` points on a circle, by differences of bearings."""
    points, centre = circle(count), np.array([1000.0 + 300.0 * (1.0 + gap), 2000.0, 900.0])

    def bearings(change: FloatArray) -> FloatArray:
        rays = (points - centre - 500.0 * change[:3]) @ Rotation.from_rotvec(change[3:]).as_matrix()
        return unit(rays).ravel()

    steps = 1e-5 * np.eye(6)
    slopes = np.column_stack([(bearings(step) - bearings(-step)) / 2e-5 for step in steps])
    singular = np.linalg.svd(slopes, compute_uv=False)
    return float(singular[0] / singular[-1])


def test_three_points_fail_on_the_cylinder_and_four_do_not() -> None:
    assert conditions(0.0, 3) > 1e7
    assert conditions(0.01, 3) > 5.0 * conditions(0.1, 3)
    assert conditions(0.0, 4) < 2.0 * conditions(0.3, 4) < 200.0


def test_correlations_by_hand() -> None:
    covariance = np.array([[4.0, 3.0, 0.0], [3.0, 9.0, 0.0], [0.0, 0.0, 0.0]])
    assert correlations(covariance).tolist() == [[1.0, 0.5, 0.0], [0.5, 1.0, 0.0], [0.0, 0.0, 0.0]]
