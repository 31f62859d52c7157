"""Block adjustment: known orientations give measurements, and come back from them with the errors that are stated."""

from __future__ import annotations

import numpy as np
import pytest
from block_rig import Block, grid_block, pose_of, problem

from geomosaic.orientation.block.adjustment import BlockAdjustment, adjust_block
from geomosaic.orientation.block.control_blunders import smallest_set
from geomosaic.orientation.block.poses import CameraPositions


def centre_errors(block: Block, found: BlockAdjustment) -> np.ndarray:
    pairs = zip(found.state.models, block.models, strict=True)
    return np.array([pose_of(one, block.frame).centre - pose_of(true, block.frame).centre for one, true in pairs])


def test_exact_measurements_give_the_orientations_back() -> None:
    block = grid_block(2, 3, 40, seed=2)
    built, start = problem(block, colrow=block.colrow, given=block.points[block.control])
    found = adjust_block(built, start)
    assert np.abs(centre_errors(block, found)).max() < 1e-4
    assert np.abs((found.state.points - block.points)[found.state.moving]).max() < 1e-4
    assert not any(out.any() for out in found.rejected)


@pytest.fixture(scope="module")
def noisy() -> tuple[Block, BlockAdjustment]:
    block = grid_block(2, 4, 60, seed=3)
    return block, adjust_block(*problem(block))


def test_redundancy_numbers_sum_to_the_redundancy(noisy: tuple[Block, BlockAdjustment]) -> None:
    _, found = noisy
    total = sum(
        np.trace(share[weight > 0.0], axis1=1, axis2=2).sum()
        for share, weight in zip(found.redundancy_numbers, found.state.weights, strict=True)
    )
    assert total == pytest.approx(found.redundancy, abs=1e-6)


def test_errors_are_as_large_as_their_covariance_says(noisy: tuple[Block, BlockAdjustment]) -> None:
    block, found = noisy
    assert 0.9 < found.sigma0 < 1.1
    off = (found.state.points - block.points)[found.state.moving]
    cofactors = found.network.point_cofactors()[found.state.moving]
    statistic = np.einsum("ni,nij,nj->n", off, np.linalg.inv(cofactors), off)
    # Points of one block err together, so that a share has more spread than of as many alone.
    assert 0.85 < (statistic < 7.815).mean() < 0.99


def test_gross_errors_and_wrong_control_are_found_and_nothing_else() -> None:
    block = grid_block(3, 5, 60, seed=1)
    random = np.random.default_rng(3)
    measured, bad = block.colrow + block.noise, random.random(len(block.colrow)) < 0.03
    bad[np.isin(block.point, block.control)] = False
    measured[bad] += random.choice([-1.0, 1.0], (bad.sum(), 2)) * random.uniform(5.0, 400.0, (bad.sum(), 2))
    given = block.points[block.control] + 0.02 * random.normal(size=(len(block.control), 3))
    given[0, 2] += 5.0
    given[3, :2] += 3.0
    found = adjust_block(*problem(block, colrow=measured, given=given))
    rejected, used = found.rejected[0], found.state.weights[0] > 0.0
    assert not (bad & used).any()
    assert (rejected & ~bad).sum() <= 0.02 * len(bad)  # two rays that disagree cannot say which of them is wrong
    assert np.flatnonzero(found.rejected[1]).tolist() == [0, 3]


def test_camera_positions_with_a_lever_arm_stand_in_for_control() -> None:
    block = grid_block(2, 4, 60, seed=4, control=0)
    arm = np.array([0.3, -0.2, -1.5])
    poses = [pose_of(model, block.frame) for model in block.models]
    places = np.array([pose.centre + pose.rotation.T @ arm for pose in poses])
    random = np.random.default_rng(0)
    observed = CameraPositions(
        np.arange(len(poses)), places + 0.05 * random.normal(size=places.shape),
        np.broadcast_to(np.eye(3) / 0.05, (len(poses), 3, 3)), arm,
    )  # fmt: skip
    found = adjust_block(*problem(block, observed))
    errors = centre_errors(block, found)
    assert np.sqrt((errors**2).mean()) < 0.06
    assert 0.9 < found.sigma0 < 1.1


def test_the_smallest_set_of_wrong_points_is_preferred_to_the_points_it_bends() -> None:
    # A line through seven given values; two of them are wrong.
    x = np.linspace(-1.0, 1.0, 9)
    design = np.column_stack([np.ones(9), x])
    values = 2.0 + 3.0 * x + 0.1 * np.random.default_rng(1).normal(size=9)
    values[[0, 1]] += 2.0
    share = np.eye(9) - design @ np.linalg.inv(design.T @ design) @ design.T
    wrong = smallest_set((share @ values / 0.1)[:, None], share, np.ones((9, 1), dtype=bool), 1e-4)
    assert np.flatnonzero(wrong).tolist() == [0, 1]
