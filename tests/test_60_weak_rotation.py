"""Rotations that a block hardly determines: the roll of a single strip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from block_rig import Block, adjust_block, grid_block, pose_of, problem

from geomosaic.errors import SolveError
from geomosaic.orientation.block.poses import CameraPositions
from geomosaic.orientation.block.weak_rotation import weak_roll, weak_rotation


def positions(block: Block, sigma: float) -> CameraPositions:
    """Camera positions of all photos."""
    places = np.array([pose_of(model, block.frame).centre for model in block.models])
    roots = np.broadcast_to(np.eye(3) / sigma, (len(places), 3, 3)).copy()
    return CameraPositions(np.arange(len(places)), places, roots, np.zeros(3))


def strip(half_width: float, seed: int = 1) -> Block:
    """Strip of eight photos with tie points up to so many pixels from the flight line."""
    whole = grid_block(1, 8, round(60 * 3000 / half_width), seed=seed, control=0, shift=2.0)
    near = np.abs(whole.colrow[:, 0] - 3000.0) < half_width
    near &= np.bincount(whole.point[near], minlength=len(whole.points))[whole.point] >= 2
    used, point = np.unique(whole.point[near], return_inverse=True)
    return replace(
        whole, image=whole.image[near], point=point, points=whole.points[used], colrow=whole.colrow[near],
        noise=whole.noise[near],
    )  # fmt: skip


@pytest.mark.parametrize("half_width", [80.0, 150.0])
def test_ties_near_the_flight_line_leave_the_roll_of_the_strip_free_and_it_is_named(half_width: float) -> None:
    block = strip(half_width)
    built, start = problem(block, positions(block, 1.0))
    try:  # with what lies 80 px from the line the solution may run away
        found = adjust_block(built, start)
        weak = weak_roll(found.problem, found.state)
        assert weak is not None
        words, hint = weak.text(block.names), weak.hint
    except SolveError as error:
        words, hint = str(error), error.hint
    assert "the roll of s1p" in words
    assert "about the flight line" in words
    assert "both sides of the flight line" in hint


def test_the_standard_deviation_of_the_roll_is_that_of_repeated_adjustments() -> None:
    block = strip(3000.0)
    built, start = problem(block, positions(block, 1.0))
    truth = replace(start, models=tuple(block.models), points=block.points)
    weak = weak_rotation(built, truth)
    assert weak is not None
    assert weak.roll
    assert len(weak.images) == 8
    rolls, random = [], np.random.default_rng(2)
    for _ in range(30):
        noisy = replace(positions(block, 1.0), xyz=positions(block, 1.0).xyz + random.normal(size=(8, 3)))
        colrow = block.colrow + 0.3 * random.normal(size=block.colrow.shape)
        again = problem(block, noisy, colrow=colrow)[0]
        step = again.linearise(truth).step()
        moved = again.moved(truth, 1e-3 * step)
        turn = [pose_of(a, block.frame).rotation.T @ pose_of(b, block.frame).rotation
                for a, b in zip(moved.models, truth.models, strict=True)]  # fmt: skip
        rolls.append(np.mean([each[0, 2] for each in turn]) / 1e-3)
    assert np.degrees(np.std(rolls)) == pytest.approx(weak.sigma, rel=0.3)


def test_attitudes_points_off_the_line_and_a_second_strip_hold_the_roll() -> None:
    block = grid_block(2, 5, 60, seed=1, control=0, shift=2.0)
    built, start = problem(block, positions(block, 0.1))
    assert weak_rotation(built, start) is None
    block = grid_block(1, 8, 60, seed=1, control=6, shift=2.0)
    assert weak_rotation(*problem(block, positions(block, 1.0))) is None
