"""Camera parameters that stray: held where that costs next to nothing, free where the measurements ask for them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from block_rig import CAMERA, MIDDLE, Block, grid_block, photo, pose_of, problem

from geomosaic.orientation.block.adjustment import BlockAdjustment, adjust_block
from geomosaic.orientation.block.poses import CameraPositions
from geomosaic.orientation.block.strayed_parameters import Stray, adjust_near_known

SIGMA = 4.0


def adjusted(block: Block, focal: float, sigma_positions: float) -> tuple[BlockAdjustment, list[Stray]]:
    """Block without control whose focal length is declared, with its standard deviation."""
    start = []
    for model in block.start:
        pose = model.parameters.values
        other = photo(
            "start", np.array([*MIDDLE, 1300.0]), np.zeros(3), {**CAMERA, "focal_length_px": focal}
        ).with_values(pose)
        sigmas = np.where([name == "focal_length" for name in other.interior.names], SIGMA, 0.0)
        other = other.with_interior(replace(other.interior, sigmas=sigmas))
        start.append(replace(other, frame=model.frame, seed=model.seed))
    places = np.array([pose_of(model, block.frame).centre for model in block.models])
    noise = sigma_positions * np.random.default_rng(0).normal(size=places.shape)
    root = np.broadcast_to(np.eye(3) / sigma_positions, (len(places), 3, 3))
    positions = CameraPositions(np.arange(len(places)), places + noise, root)
    block = replace(block, start=start)
    built, first = problem(block, positions, interior=("focal_length",))
    return adjust_near_known(built, first, adjust_block)


@pytest.fixture(scope="module")
def flat() -> Block:
    """Vertical photos whose image positions are bent by what no parameter describes."""
    block = grid_block(2, 3, 60, seed=1, control=0)
    return replace(block, noise=block.noise + bent(block))


def bent(block: Block) -> np.ndarray:
    """Errors (N, 2) that rise to the corners of the images as those of a curved sensor do."""
    off = (block.colrow - np.median(block.colrow, axis=0)) / 2000.0
    return 0.8 * off * np.abs(off)


def test_a_focal_length_that_gains_next_to_nothing_is_held(flat: Block) -> None:
    found, (stray,) = adjusted(flat, 5000.0, 20.0)
    assert stray.rms is not None
    assert stray.rms[1] < 1.1 * stray.rms[0]
    assert stray.deviations > 4.0
    assert "camera 1: focal_length is held at 5000: free it would come to" in stray.text
    interior = found.state.models[0].interior
    assert interior.values[interior.names.index("focal_length")] == 5000.0


def test_a_focal_length_that_the_measurements_ask_for_stays_free() -> None:
    block = grid_block(2, 3, 60, seed=1, control=0)
    found, (stray,) = adjusted(block, 5200.0, 0.1)
    assert stray.rms is None
    assert "either that was wrong" in stray.text
    interior = found.state.models[0].interior
    assert interior.values[interior.names.index("focal_length")] == pytest.approx(5000.0, abs=10.0)


def test_a_focal_length_near_what_was_known_is_found_as_ever() -> None:
    block = grid_block(2, 3, 60, seed=1, control=0)
    found, strays = adjusted(block, 5003.0, 0.1)
    assert not strays
    interior = found.state.models[0].interior
    assert interior.values[interior.names.index("focal_length")] == pytest.approx(5000.0, abs=2.0)
