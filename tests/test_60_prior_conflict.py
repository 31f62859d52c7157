"""Camera parameters that stray: held where that costs next to nothing, free where the measurements ask for them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from block_rig import CAMERA, MIDDLE, Block, grid_block, photo, pose_of, problem

from geomosaic.orientation.block.adjustment import BlockAdjustment, adjust_block
from geomosaic.orientation.block.poses import CameraPositions
from geomosaic.orientation.block.prior_conflict import PriorConflict, adjust_near_known


def adjusted(
    block: Block, focal: float, sigma: float, sigma_positions: float
) -> tuple[BlockAdjustment, list[PriorConflict]]:
    """Block whose focal length is 5000 px and is declared otherwise, with its standard deviation."""
    start = []
    for model in block.start:
        pose = model.parameters.values
        other = photo(
            "start", np.array([*MIDDLE, 1300.0]), np.zeros(3), {**CAMERA, "focal_length_px": focal}
        ).with_values(pose)
        sigmas = np.where([name == "focal_length" for name in other.interior.names], sigma, 0.0)
        other = other.with_interior(replace(other.interior, sigmas=sigmas))
        start.append(replace(other, frame=model.frame, seed=model.seed))
    places = np.array([pose_of(model, block.frame).centre for model in block.models])
    noise = sigma_positions * np.random.default_rng(0).normal(size=places.shape)
    root = np.broadcast_to(np.eye(3) / sigma_positions, (len(places), 3, 3))
    positions = CameraPositions(np.arange(len(places)), places + noise, root)
    block = replace(block, start=start)
    built, first = problem(block, positions, interior=("focal_length",))
    return adjust_near_known(built, first, adjust_block)


def focal_length(found: BlockAdjustment) -> float:
    interior = found.state.models[0].interior
    return float(interior.values[interior.names.index("focal_length")])


def test_a_focal_length_that_gains_next_to_nothing_is_held() -> None:
    found, (stray,) = adjusted(grid_block(2, 3, 150, seed=1, control=0), 5080.0, 8.0, 20.0)
    assert stray.rms is not None
    assert 1.0 < stray.rms[1] / stray.rms[0] < 1.1
    assert stray.deviations > 4.0
    assert "camera 1: focal_length is held at 5080: free it would come to" in stray.text
    assert focal_length(found) == 5080.0


def test_a_focal_length_that_control_points_ask_for_stays_free() -> None:
    found, (stray,) = adjusted(grid_block(2, 3, 20, seed=1), 5030.0, 4.0, 0.1)
    assert stray.rms is None
    assert "either that was wrong" in stray.text
    assert focal_length(found) == pytest.approx(5000.0, abs=3.0)


def test_a_focal_length_near_what_was_known_is_found_as_ever() -> None:
    found, conflicts = adjusted(grid_block(2, 3, 20, seed=1), 5003.0, 4.0, 0.1)
    assert not conflicts
    assert focal_length(found) == pytest.approx(5000.0, abs=2.0)
