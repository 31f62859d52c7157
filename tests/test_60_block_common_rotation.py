"""Blocks whose form is known far better than their place: they turn as a whole without being bent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from block_rig import grid_block, pose_of, problem

from geomosaic.estimation.solver import Outcome, Stopping, solve
from geomosaic.geo.local_frames import angle_axis
from geomosaic.orientation.block.adjustment import RULES
from geomosaic.orientation.block.common_rotation import with_pose
from geomosaic.orientation.block.poses import Pose


def test_a_block_on_weak_control_turns_by_degrees_without_damping() -> None:
    # Rays are good to 0.02 px, 4 mm on the ground, control to 20 m: a linear step of 0.1 radians would bend the block
    # by 5 m, and damping against that would need thousands of rounds.
    block = grid_block(2, 4, 30, shift=0.0, turn=0.0, sigma_px=0.02)
    built, start = problem(block, sigma_px=0.02, sigma_control=20.0)
    start = built.checked(replace(start, points=block.points.copy()))
    near = solve(built, start, RULES)
    turned, free = angle_axis(np.array([0.03, -0.04, 0.1])), np.ones(6, dtype=bool)
    models = []
    for model in block.models:
        pose = pose_of(model, block.frame)
        wanted = Pose(turned @ pose.centre, pose.rotation @ turned.T)
        models.append(with_pose(with_pose(model, wanted, free, block.frame), wanted, free, block.frame))
    far = solve(built, replace(start, models=tuple(models), points=block.points @ turned.T), RULES)
    assert [each.outcome for each in (near, far)] == [Outcome.CONVERGED] * 2
    assert far.rounds <= 12
    np.testing.assert_allclose(far.squares, near.squares, rtol=1e-7)


def test_a_step_of_a_rotation_alone_leaves_all_image_positions_where_they_are() -> None:
    block = grid_block(2, 3, 20, shift=0.0, turn=0.0, control=4)
    built, start = problem(block)
    start = built.checked(replace(start, points=block.points.copy()))
    # A linear step: all poses and points by the derivatives of a common rotation.
    rotation = np.array([0.02, 0.05, -0.06])
    models, steps = start.models, []
    for model in models:
        pose, size = pose_of(model, block.frame), 1e-5
        turned = angle_axis(size * rotation)
        wanted = Pose(turned @ pose.centre, pose.rotation @ turned.T)
        near = with_pose(model, wanted, np.ones(6, dtype=bool), block.frame)
        steps.append((near.parameters.values - model.parameters.values) / size)
    moved = np.cross(rotation, start.points[start.moving])
    after = built.moved(start, np.concatenate([*steps, moved.ravel()]))
    before, now = (built.views.residuals(state, block.frame) for state in (start, after))
    assert float(np.abs(now - before).max()) < 0.05
    linear = [m.with_values(m.parameters.values + s) for m, s in zip(models, steps, strict=True)]
    plain = replace(start, models=tuple(linear), points=np.where(start.moving[:, None], after.points * 0.0, 0.0))
    points = start.points.copy()
    points[start.moving] += moved
    bent = built.views.residuals(replace(plain, points=points), block.frame)
    assert float(np.abs(bent - before).max()) > 10.0


def test_a_direction_that_nothing_determines_well_does_not_keep_a_block_from_its_end() -> None:
    block = grid_block(2, 4, 30, sigma_px=0.02)
    built, start = problem(block, sigma_px=0.02, sigma_control=20.0)
    found = solve(built, start, Stopping(rounds=30, step=1e-6, near=1e-3, gain=1e-9))
    assert found.outcome is Outcome.CONVERGED
