"""Start of a block: orientations and points from image positions of tie points, without initial values."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest
import unoriented_rig as rig

from geomosaic.errors import InputError, SolveError
from geomosaic.orientation.block.absolute_orientation import Correspondences, absolute_orientation
from geomosaic.orientation.block.connectivity import connectivity
from geomosaic.orientation.block.initial_values import initial_values
from geomosaic.orientation.block.relative_orientation import essential_matrices, relative_orientations
from geomosaic.orientation.block.triangulation import Rays, triangulate


def corners(truth: rig.Truth) -> tuple[int, ...]:
    """Three points with three rays or more, far from each other."""
    block = truth.block
    seen = np.bincount(block.point[~truth.wrong], minlength=len(truth.points))
    many = np.flatnonzero(seen >= 3)
    first = many[np.argmin(truth.points[many] @ (1.0, 1.0, 0.0))]
    second = many[np.argmax(truth.points[many] @ (1.0, 1.0, 0.0))]
    along = truth.points[second] - truth.points[first]
    across = np.linalg.norm(np.cross(truth.points[many] - truth.points[first], along), axis=1)
    return int(first), int(second), int(many[np.argmax(across)])


@pytest.fixture(scope="module")
def flown() -> rig.Truth:
    centres, rotations = rig.flight(2, 5)
    return rig.block(centres, rotations, rig.hills(centres, 500))


def test_a_block_starts_from_ties_and_three_control_points(flown: rig.Truth) -> None:
    start = initial_values(flown.knowing(points=flown.control(*corners(flown)), sigma_points=np.full(500, 0.05)))
    centre, point, attitude = flown.errors(start)
    assert centre < 0.005
    assert attitude < 0.2
    assert point < 0.005
    assert start.used.mean() > 0.95
    assert not start.notes


def test_a_block_starts_from_ties_and_camera_positions(flown: rig.Truth) -> None:
    noise = np.random.default_rng(3).normal(0.0, 5.0, flown.centres.shape)
    start = initial_values(flown.knowing(centres=flown.centres + noise, sigma_centres=np.full(10, 5.0)))
    centre, _, attitude = flown.errors(start)
    assert centre < 0.02
    assert attitude < 1.0


@pytest.mark.parametrize("gross", [0.03, 0.1])
def test_wrong_ties_do_not_spoil_the_start(gross: float) -> None:
    centres, rotations = rig.flight(2, 5)
    truth = rig.block(centres, rotations, rig.hills(centres, 500), gross=gross)
    start = initial_values(truth.knowing(points=truth.control(*corners(truth)), sigma_points=np.full(500, 0.05)))
    centre, _, attitude = truth.errors(start)
    assert centre < 0.02
    assert attitude < 1.0
    three = np.bincount(truth.block.point, minlength=500)[truth.block.point] >= 3
    assert start.used[truth.wrong & three].mean() < 0.1
    assert start.used[~truth.wrong & three].mean() > 0.8


def test_flat_ground_is_no_trap() -> None:
    centres, rotations = rig.flight(2, 4)
    truth = rig.block(centres, rotations, rig.hills(centres, 300, relief=0.0))
    start = initial_values(truth.knowing(centres=truth.centres, sigma_centres=np.full(8, 0.1)))
    assert truth.errors(start)[0] < 0.01
    assert truth.errors(start)[2] < 0.5


def test_oblique_photos_of_a_circle_start_without_a_datum_in_their_own_frame() -> None:
    centres, rotations = rig.circle(12)
    points = np.random.default_rng(2).normal(0.0, 1.2, (100, 3))
    truth = rig.block(centres, rotations, points)
    start = initial_values(truth.knowing(points=truth.control(0, 1, 2), sigma_points=np.full(100, 0.001)))
    assert truth.errors(start)[0] < 0.02
    assert truth.errors(start)[2] < 0.5
    free = initial_values(truth.block, datum=False)
    there = np.array([model.pose[0] for model in free.models])
    apart, true = (np.linalg.norm(places - places[0], axis=1)[1:] for places in (there, truth.centres))
    assert np.ptp(apart / true) < 0.02 * np.mean(apart / true)


def test_fisheyes_beyond_a_right_angle_start_too() -> None:
    centres, rotations = rig.flight(2, 4, height=10.0)
    truth = rig.block(centres, rotations, rig.hills(centres, 400) * (2.5, 2.5, 1.0), model=rig.photo(rig.FISHEYE))
    start = initial_values(truth.knowing(centres=truth.centres, sigma_centres=np.full(8, 0.01)))
    assert truth.errors(start)[0] < 0.01
    assert truth.errors(start)[2] < 0.5


def test_a_strip_with_positions_alone_says_what_it_assumed() -> None:
    centres, rotations = rig.flight(1, 6, forward=0.7, tilt=1.0)
    centres[:, [0, 2]] = (0.0, 1000.0)
    truth = rig.block(centres, rotations, rig.hills(centres, 300))
    start = initial_values(truth.knowing(centres=truth.centres, sigma_centres=np.full(6, 0.1)))
    assert "on one line" in start.notes[0]
    assert truth.errors(start)[2] < 5.0


def test_attitudes_take_the_place_of_a_third_position() -> None:
    centres, rotations = rig.flight(1, 6, forward=0.7)
    centres[:, [0, 2]] = (0.0, 1000.0)
    truth = rig.block(centres, rotations, rig.hills(centres, 300))
    start = initial_values(
        truth.knowing(
            centres=truth.centres,
            sigma_centres=np.full(6, 0.1),
            rotations=truth.rotations,
            sigma_rotations=np.full(6, 0.02),
        )
    )
    assert not start.notes
    assert truth.errors(start)[2] < 0.3


def test_a_strip_of_little_overlap_holds_together() -> None:
    centres, rotations = rig.flight(1, 8)
    points = rig.hills(centres, 300)
    truth = rig.block(centres, rotations, points)
    rays = np.bincount(truth.block.point, minlength=300)[truth.block.point]
    # Too few points with three rays for resections: neighbours are oriented pair by pair.
    assert min(np.bincount(truth.block.image[rays >= 3])) < 12
    start = initial_values(truth.knowing(points=truth.control(*corners(truth)), sigma_points=np.full(300, 0.05)))
    assert truth.errors(start)[0] < 0.02
    assert truth.errors(start)[2] < 1.0


def test_a_photo_with_two_points_starts_at_its_known_position(flown: rig.Truth) -> None:
    block = flown.knowing(centres=flown.centres, sigma_centres=np.full(10, 0.1))
    rays = np.bincount(block.point)[block.point]
    rows = np.flatnonzero((block.image == 4) & (rays >= 3))
    ends = rows[[np.argmin(block.colrow[rows, 0]), np.argmax(block.colrow[rows, 0])]]
    few = (block.image != 4) | np.isin(np.arange(len(block.image)), ends)
    start = initial_values(replace(block, image=block.image[few], point=block.point[few], colrow=block.colrow[few]))
    assert flown.errors(start)[2] < 1.0


def test_photos_with_an_orientation_give_points_and_place_the_others(flown: rig.Truth) -> None:
    oriented = np.zeros(10, dtype=bool)
    oriented[[0, 1, 2]] = True
    models = tuple(m if o else u for m, u, o in zip(flown.models, flown.block.models, oriented, strict=True))
    start = initial_values(replace(flown.block, models=models, oriented=oriented))
    assert flown.errors(start)[0] < 0.02
    assert flown.errors(start)[2] < 0.5
    assert start.models[0] is flown.models[0]


def test_parts_without_a_common_point_are_named() -> None:
    centres, rotations = rig.flight(2, 4, side=-1.0)
    truth = rig.block(centres, rotations, rig.hills(centres, 600))
    known = np.full((8, 3), np.nan)
    known[:4] = truth.centres[:4]
    with pytest.raises(SolveError, match=r"1 part .* without a datum: 4 images \(photo 5, photo 6, photo 7"):
        initial_values(truth.knowing(centres=known))
    start = initial_values(truth.knowing(centres=truth.centres))
    assert truth.errors(start)[0] < 0.01


def test_one_wrong_position_or_control_point_does_not_move_the_block(flown: rig.Truth) -> None:
    centres = flown.centres + (np.arange(10) == 3)[:, None] * (500.0, 0.0, 100.0)
    start = initial_values(flown.knowing(centres=centres, sigma_centres=np.full(10, 1.0)))
    assert flown.errors(start)[0] < 0.005
    known = np.flatnonzero(np.bincount(flown.block.point, minlength=500) >= 3)[:40:6]
    control = flown.control(*known)
    control[known[1], 2] += 300.0
    start = initial_values(flown.knowing(points=control, sigma_points=np.full(500, 0.05)))
    assert flown.errors(start)[0] < 0.005


def test_rough_orientations_give_rough_points_of_all_ties(flown: rig.Truth) -> None:
    off = np.random.default_rng(0).normal(size=(10, 6)) * [5.0, 5.0, 5.0, 1.0, 1.0, 1.0]
    models = tuple(m.with_values(m.parameters.values + d) for m, d in zip(flown.models, off, strict=True))
    start = initial_values(replace(flown.block, models=models, oriented=np.ones(10, dtype=bool)))
    seen = np.bincount(flown.block.point, minlength=500) >= 2
    assert np.isfinite(start.points[seen]).all()
    assert np.nanmedian(np.linalg.norm(start.points - flown.points, axis=1)) < 100.0
    assert start.models == models


def test_scenes_without_rays_give_points_and_place_photos(flown: rig.Truth) -> None:
    oriented = np.arange(10) % 5 < 3
    models = tuple(
        rig.Scene(posed) if given else photo
        for posed, photo, given in zip(flown.models, flown.block.models, oriented, strict=True)
    )
    start = initial_values(replace(flown.block, models=models, oriented=oriented))
    assert np.nanmedian(np.linalg.norm(start.points - flown.points, axis=1)) < 1.0
    for index in np.flatnonzero(~oriented):
        centre = flown.block.frame.to_enu(start.models[index].pose[0])
        assert np.linalg.norm(centre - flown.centres[index]) < 20.0


def test_a_sensor_without_a_pose_is_named(flown: rig.Truth) -> None:
    models = (flown.block.models[0], rig.Scene(flown.models[1]), *flown.block.models[2:])
    with pytest.raises(InputError, match=r"1 image \(photo 2\) without an orientation"):
        initial_values(replace(flown.block, models=models))


def test_a_block_without_ties_says_that_its_images_are_alone(flown: rig.Truth) -> None:
    for colrow in (flown.block.colrow * np.nan, np.full_like(flown.block.colrow, 7.0)):
        with pytest.raises(SolveError, match=r"10 images alone \(photo 1, photo 2, photo 3, \.\.\.\)"):
            initial_values(replace(flown.block, colrow=colrow))


def test_a_photo_with_too_few_points_is_named(flown: rig.Truth) -> None:
    few = (flown.block.image != 3) | (np.cumsum(flown.block.image == 3) <= 3)
    block = flown.knowing(points=flown.control(*corners(flown)), sigma_points=np.full(500, 0.05))
    with pytest.raises(SolveError, match=r"1 image \(photo 4\) cannot be oriented") as caught:
        initial_values(replace(block, image=block.image[few], point=block.point[few], colrow=block.colrow[few]))
    assert "six tie points" in (caught.value.hint or "")


def test_the_order_of_image_positions_does_not_matter(flown: rig.Truth) -> None:
    block = flown.knowing(centres=flown.centres)
    order = np.random.default_rng(0).permutation(len(block.image))
    shuffled = replace(block, image=block.image[order], point=block.point[order], colrow=block.colrow[order])
    one, other = initial_values(block), initial_values(shuffled)
    assert np.array_equal(one.points, other.points, equal_nan=True)
    assert np.array_equal(one.used[order], other.used)


def test_points_on_one_line_join_no_images() -> None:
    image, point = np.repeat([0, 1, 2], 8), np.tile(np.arange(8), 3)
    along = np.arange(8.0)[:, None] * (100.0, 40.0)
    spread = np.random.default_rng(0).uniform(0.0, 1000.0, (8, 2))
    found = connectivity(image, point, np.vstack([along, along, along]), 3)
    assert len(found.pairs) == 0
    found = connectivity(image, point, np.vstack([spread, spread, along]), 4)
    assert found.pairs.tolist() == [[0, 1]]
    assert found.common.tolist() == [8]
    assert [part.tolist() for part in found.parts] == [[0, 1], [2], [3]]


def test_five_points_give_the_essential_matrix_among_the_solutions() -> None:
    rng = np.random.default_rng(4)
    points = np.array([0.0, 0.0, 4.0]) + rng.uniform(-1.0, 1.0, (40, 5, 3))
    rotation = rig.angle_axis(np.array([0.1, -0.3, 0.7]))
    base = np.array([0.6, 0.1, -0.2])
    first, second = points, points @ rotation.T + base
    first, second = (rays / np.linalg.norm(rays, axis=2)[:, :, None] for rays in (first, second))
    x, y, z = base
    true = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]) @ rotation
    true /= np.linalg.norm(true)
    for a, b in zip(first, second, strict=True):
        found = essential_matrices(a[None], b[None])
        assert min(np.abs(found - true).max(axis=(1, 2)).min(), np.abs(found + true).max(axis=(1, 2)).min()) < 1e-7


def test_opencv_finds_the_same_relative_orientation() -> None:
    cv2 = pytest.importorskip("cv2", reason="OpenCV is not installed")
    centres, rotations = rig.flight(1, 2)
    truth = rig.block(centres, rotations, rig.hills(centres, 400))
    camera, block = truth.models[0], truth.block
    _, a, b = np.intersect1d(block.point[block.image == 0], block.point[block.image == 1], return_indices=True)
    first, second = (camera.directions(block.colrow[block.image == index][rows]) for index, rows in ((0, a), (1, b)))
    found = relative_orientations(first, second, np.full(len(a), 1.0 / 4000.0), 4.0)[0]
    flat = [rays[:, :2] / rays[:, 2:] for rays in (first, second)]
    matrix, _ = cv2.findEssentialMat(*flat, np.eye(3), cv2.RANSAC, 0.9999, 2.0 / 4000.0)
    _, rotation, base, _ = cv2.recoverPose(matrix, *flat)
    assert np.degrees(np.arccos((np.trace(found.rotation @ rotation.T) - 1.0) / 2.0)) < 0.3
    assert -(found.rotation @ found.centre) @ base.ravel() > np.cos(np.radians(1.0))


def test_a_plane_does_not_turn_the_relative_orientation() -> None:
    rng = np.random.default_rng(5)
    points = rng.uniform(-1.0, 1.0, (200, 3)) * (1.0, 1.0, 0.0) + (0.2, 0.0, 3.0)
    rotation, centre = rig.angle_axis(np.array([0.1, 0.05, 0.4])), np.array([0.5, 0.1, -0.1])
    first, second = points, (points - centre) @ rotation.T
    first, second = (rays + rng.normal(0.0, 2e-4, rays.shape) for rays in (first, second))
    first, second = (rays / np.linalg.norm(rays, axis=1)[:, None] for rays in (first, second))
    found = relative_orientations(first, second, np.full(200, 1e-4), 4.0)[0]
    assert np.degrees(np.arccos((np.trace(found.rotation @ rotation.T) - 1.0) / 2.0)) < 0.3
    assert found.centre @ centre / np.linalg.norm(centre) > np.cos(np.radians(1.0))


def test_wrong_rays_are_left_out_of_an_intersection() -> None:
    rng = np.random.default_rng(6)
    points = rng.uniform(-50.0, 50.0, (300, 3))
    centres = np.array([0.0, 0.0, 500.0]) + rng.uniform(-100.0, 100.0, (7, 3))
    origins, point = np.repeat(centres, 300, axis=0), np.tile(np.arange(300), 7)
    towards = points[point] - origins
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    wrong = rng.random(len(point)) < 0.15
    towards[wrong] += rng.normal(0.0, 0.05, (int(wrong.sum()), 3))
    towards /= np.linalg.norm(towards, axis=1)[:, None]
    found = triangulate(Rays(origins, towards, point, np.full(len(point), 1e-4)), 301, 4.0)
    assert np.isnan(found.xyz[300]).all()
    enough = np.bincount(point[~wrong], minlength=301)[:300] >= 3
    assert np.linalg.norm(found.xyz[:300] - points, axis=1)[enough].max() < 0.5
    assert found.used[~wrong].mean() > 0.98
    assert found.used[wrong].mean() < 0.02


@pytest.mark.slow
def test_a_large_block_starts_in_seconds() -> None:
    """Measured when written: 6 s of processor time for 91,000 image positions."""
    centres, rotations = rig.flight(8, 15, forward=0.75, side=0.65)
    truth = rig.block(centres, rotations, rig.hills(centres, 12_000), gross=0.03)
    assert len(truth.block.image) > 80_000
    before = time.process_time()
    start = initial_values(truth.knowing(centres=truth.centres, sigma_centres=np.full(120, 0.1)))
    assert time.process_time() - before < 15.0
    assert truth.errors(start)[0] < 0.002
    assert truth.errors(start)[2] < 0.05


def test_rays_of_coarse_pixels_do_not_pull_a_point_from_where_those_of_fine_pixels_meet() -> None:
    random = np.random.default_rng(2)
    places = random.uniform(-100.0, 100.0, (40, 3))
    stations = [(np.array([x, 0.0, 500.0]), 1e-4) for x in (-200.0, 0.0, 200.0)]
    stations += [(np.array([x, 3e4, 8e5]), 2.5e-5) for x in (-3e5, -1e5, 1e5, 3e5)]
    origins, directions, point, angle = [], [], [], []
    for where, pixel in stations:
        towards = places - where
        towards /= np.linalg.norm(towards, axis=1)[:, None]
        directions.append(towards + 0.3 * pixel * random.normal(size=towards.shape))
        origins.append(np.broadcast_to(where, places.shape))
        point.append(np.arange(len(places)))
        angle.append(np.full(len(places), pixel))
    unit = np.vstack(directions)
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    found = triangulate(Rays(np.vstack(origins), unit, np.hstack(point), np.hstack(angle)), len(places), 2.0)
    assert found.used.mean() > 0.95
    assert np.abs(found.xyz - places).max() < 0.3  # fine pixels cover 0.05 m, coarse ones 20 m


def test_places_that_agree_far_better_than_declared_are_not_on_one_line() -> None:
    random, nothing = np.random.default_rng(0), (np.zeros((0, 3, 3)), np.zeros(0))
    free = random.uniform(-20.0, 20.0, (6, 3)) * [1.0, 1.0, 0.1]
    known = free + 0.5 * random.normal(size=free.shape)
    for sigma in (0.5, 20.0, 200.0):
        assert absolute_orientation(Correspondences(free / 7.0, known, np.full(6, sigma), *nothing)) is not None
    line = np.linspace(0.0, 200.0, 6)[:, None] * [1.0, 0.0, 0.0] + random.normal(size=(6, 3))
    for _ in range(50):  # as bad as declared, and 1 m off a line
        known = line + 5.0 * random.normal(size=line.shape)
        assert absolute_orientation(Correspondences(line / 7.0, known, np.full(6, 5.0), *nothing)) is None
