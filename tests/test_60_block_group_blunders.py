"""Groups of observations that contradict the rest of a block as a whole: they are named, and nothing else is blamed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from block_rig import Block, adjust_block, grid_block, pose_of, problem
from scipy.spatial.transform import Rotation

from geomosaic.orientation.block.adjustment import BlockAdjustment
from geomosaic.orientation.block.blunder_causes import blunders, group_blunder_text
from geomosaic.orientation.block.facts import block_facts
from geomosaic.orientation.block.observations import SurfaceHeights
from geomosaic.orientation.block.poses import Attitudes, CameraPositions
from geomosaic.orientation.block.solution import BlockSolution
from geomosaic.orientation.block.weak_rotation import weak_rotation

pytestmark = pytest.mark.ci


@pytest.fixture(scope="module")
def block() -> Block:
    return grid_block(2, 3, 30, seed=3)


def positions(block: Block, sigma: float, *, offset: tuple[float, ...] = (0.0, 0.0, 0.0), scatter: float = 1.0):  # type: ignore[no-untyped-def]
    true = np.array([pose_of(model, block.frame).centre for model in block.models])
    noise = scatter * sigma * np.random.default_rng(0).normal(size=true.shape)
    root = np.broadcast_to(np.eye(3) / sigma, (len(true), 3, 3))
    return CameraPositions(np.arange(len(true)), true + offset + noise, root)


def attitudes(block: Block, sigma: float, turn: tuple[float, ...] = (0.0, 0.0, 0.0)) -> Attitudes:
    random, by = np.random.default_rng(1), Rotation.from_rotvec(turn, degrees=True).as_matrix()
    true = [by @ pose_of(model, block.frame).rotation for model in block.models]
    noise = [Rotation.from_rotvec(sigma * random.normal(size=3), degrees=True).as_matrix() for _ in true]
    turned = np.array([a @ b for a, b in zip(noise, true, strict=True)])
    return Attitudes(np.arange(len(true)), turned, np.broadcast_to(np.eye(3) / sigma, (len(true), 3, 3)))


def dem(block: Block, sigma: float, offset: float) -> SurfaceHeights:
    # Heights of the true points, whatever their plan: the hills of the rig are gentle at the scale of an error in plan.
    loose = np.arange(len(block.control), len(block.points))
    height = block.points[loose, 2] + offset + sigma * np.random.default_rng(2).normal(size=len(loose))
    slope = np.broadcast_to([0.0, 0.0, 1.0], (len(loose), 3))
    return SurfaceHeights(loose, np.full(len(loose), sigma), lambda places: (places[:, 2] - height, slope))


def names(found: BlockAdjustment) -> list[str]:
    return [found.problem.groups[each.index].name for each in found.wrong_groups]


def solution_of(block: Block, found: BlockAdjustment) -> BlockSolution:
    ids = tuple(f"P{k}" for k in range(len(block.points)))
    check = np.zeros(len(ids), dtype=bool)
    return BlockSolution(found, ids, np.full((len(ids), 3), np.nan), check)


def test_a_dem_on_another_height_datum_is_left_out_as_a_whole(block: Block) -> None:
    found = adjust_block(*problem(block, dem(block, 0.3, 8.0)))
    (wrong,) = found.wrong_groups
    assert names(found) == ["heights of the DEM"]
    assert wrong.offset == pytest.approx([8.0], abs=0.3)
    assert 0.85 < found.sigma0 < 1.15
    assert not any(out.any() for out in found.rejected[:2])
    assert found.rejected[2].all()
    assert np.abs(found.state.points - block.points)[found.state.moving, 2].max() < 2.0
    words = group_blunder_text(solution_of(block, found), wrong)
    assert f"{wrong.offset[0]:.2f} m too high" in words
    assert "height datum?" in words
    assert not blunders(solution_of(block, found))


def test_a_dem_that_only_chance_moves_stays(block: Block) -> None:
    assert not adjust_block(*problem(block, dem(block, 0.3, 0.3))).wrong_groups


def test_what_two_groups_explain_alike_says_so(block: Block) -> None:
    """Nothing but the DEM and the control points gives a height."""
    found = adjust_block(*problem(block, dem(block, 0.3, 8.0), sigma_control=0.3))
    (wrong,) = found.wrong_groups
    assert names(found) == ["heights of the DEM"]
    assert [found.problem.groups[other].name for other in wrong.others] == ["control"]
    assert "unless control is wrong instead" in group_blunder_text(solution_of(block, found), wrong)


def test_camera_positions_of_another_datum_are_left_out_as_a_whole(block: Block) -> None:
    found = adjust_block(*problem(block, positions(block, 0.05, offset=(3.0, 0.0, -4.0)), attitudes(block, 0.02)))
    assert names(found) == ["camera positions"]
    assert found.wrong_groups[0].offset == pytest.approx([3.0, 0.0, -4.0], abs=0.3)
    assert not any(out.any() for out in (found.rejected[0], found.rejected[1], found.rejected[3]))


def test_a_boresight_that_was_not_told_is_named(block: Block) -> None:
    found = adjust_block(*problem(block, positions(block, 0.05), attitudes(block, 0.02, (1.0, 0.0, 0.0))))
    assert names(found) == ["attitudes"]
    assert found.wrong_groups[0].offset == pytest.approx([1.0, 0.0, 0.0], abs=0.05)


@pytest.mark.parametrize("control", [0, pytest.param(6, marks=pytest.mark.slow)])
def test_camera_positions_worse_than_their_sigmas_take_part_with_larger_ones(control: int) -> None:
    block = grid_block(2, 4, 30, seed=3, control=control)
    found = adjust_block(*problem(block, positions(block, 0.05, scatter=20.0), attitudes(block, 0.02)))
    assert names(found) == ["camera positions"]
    (wrong,) = found.wrong_groups
    assert wrong.offset is None
    assert 10.0 < wrong.scatter < 40.0
    assert 0.85 < found.sigma0 < 1.15
    assert found.variance_components["camera positions"][0] > 100.0
    assert sum(out.sum() for out in found.rejected) <= 1
    said = block_facts(solution_of(block, found))["wrong_groups"][0]["text"]
    assert said.startswith("camera positions scatter ")


def test_a_shift_below_the_accuracy_of_single_images_is_still_one_of_all() -> None:
    """Control places each photo to half a metre only, but all of them together to centimetres."""
    block = grid_block(3, 5, 30, seed=4)
    found = adjust_block(*problem(block, positions(block, 0.05, offset=(1.0, 0.0, 0.0)), attitudes(block, 0.05)))
    assert names(found) == ["camera positions"]
    assert found.problem.groups[found.wrong_groups[0].others[0]].name == "control"
    assert found.wrong_groups[0].offset == pytest.approx([1.0, 0.0, 0.0], abs=0.3)


def test_some_wrong_positions_are_not_a_wrong_group(block: Block) -> None:
    some = positions(block, 0.05)
    xyz = some.xyz.copy()
    xyz[:2] += 5.0
    found = adjust_block(*problem(block, replace(some, xyz=xyz), attitudes(block, 0.02)))
    assert not found.wrong_groups
    assert np.flatnonzero(found.rejected[2]).tolist() == [0, 1]


@pytest.mark.parametrize("wrong", [0, 1, 5])
def test_one_wrong_height_among_six_camera_positions_is_named_and_does_not_enlarge_their_sigma(wrong: int) -> None:
    """Without control, and at a corner: the roll is known to 0.9 degrees with the position, to 1.1 without it."""
    block = grid_block(2, 3, 30, seed=3, control=0)
    some = positions(block, 10.0)
    xyz = some.xyz.copy()
    xyz[wrong, 2] += 300.0
    found = adjust_block(*problem(block, replace(some, xyz=xyz)))
    assert not found.wrong_groups
    assert not found.rejected[0].any()
    assert np.flatnonzero(found.rejected[1]).tolist() == [wrong]
    (named,) = blunders(solution_of(block, found))
    assert named.image == block.names[wrong]
    off = [pose_of(model, block.frame).centre for model in found.state.models] - some.xyz
    assert np.abs(np.delete(off, wrong, axis=0)).max() < 35.0


def test_one_wrong_control_point_is_not_a_wrong_table(block: Block) -> None:
    given = block.points[block.control].copy()
    given[1, 2] += 6.0
    found = adjust_block(*problem(block, positions(block, 0.05), dem(block, 0.3, 0.0), given=given))
    assert not found.wrong_groups
    assert np.flatnonzero(found.rejected[1]).tolist() == [1]


def test_control_of_another_datum_is_named_where_positions_and_dem_agree(block: Block) -> None:
    given = block.points[block.control] + [0.0, 0.0, 12.0]
    found = adjust_block(*problem(block, positions(block, 0.05), dem(block, 0.3, 0.0), given=given))
    assert names(found) == ["control"]
    assert found.wrong_groups[0].offset == pytest.approx([0.0, 0.0, 12.0], abs=0.3)


def test_two_wrong_positions_of_a_block_without_control_are_not_a_wrong_group() -> None:
    block = grid_block(2, 4, 30, seed=3, control=0)
    some = positions(block, 0.05)
    xyz = some.xyz.copy()
    xyz[[1, 6]] += [5.0, -3.0, 4.0]
    found = adjust_block(*problem(block, replace(some, xyz=xyz), attitudes(block, 0.02)))
    assert not found.wrong_groups
    assert np.flatnonzero(found.rejected[1]).tolist() == [1, 6]


def test_control_that_alone_holds_the_roll_of_a_strip_is_not_left_out() -> None:
    """Five points within 60 m of the flight line know the roll to 2 degrees, and cannot convict the sixth."""
    block = grid_block(1, 6, 90, seed=1, control=0, shift=2.0)
    seen = np.flatnonzero(np.bincount(block.point, minlength=len(block.points)) >= 3)
    x, y = block.points[seen, :2].T
    near, far = seen[np.abs(x) < 60.0], seen[np.argmin(np.hypot(x - 350.0, y))]
    along = near[np.argsort(block.points[near, 1])]
    block = replace(block, control=np.array([*along[np.linspace(0, len(along) - 1, 5).astype(int)], far]))
    given = block.points[block.control] + 3.0 * np.random.default_rng(1).normal(size=(6, 3))
    given[5, 2] += 75.0
    found = adjust_block(*problem(block, sigma_control=3.0, given=given))
    assert not found.rejected[1].any()
    (wrong,) = found.wrong_groups
    assert wrong.offset is None
    assert wrong.scatter > 2.0
    weak = weak_rotation(found.problem, found.state)
    assert weak is None or weak.sigma < 2.0  # degrees; 2.7 without the point, at less than half the scatter


def test_of_control_more_than_a_third_of_which_is_wrong_no_point_is_blamed_and_the_message_says_so() -> None:
    block = grid_block(2, 3, 30, seed=5, control=9)
    given = block.points[block.control] + 0.02 * np.random.default_rng(5).normal(size=(9, 3))
    given[[0, 2, 4, 7]] += 3.0 * np.random.default_rng(6).normal(size=(4, 3))
    found = adjust_block(*problem(block, given=given))
    assert not any(out.any() for out in found.rejected)
    (wrong,) = found.wrong_groups
    assert "or more than a third of them are wrong" in group_blunder_text(solution_of(block, found), wrong)
    assert 0.85 < found.sigma0 < 1.15
