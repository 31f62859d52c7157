"""Self-calibration: the block itself says which parameters of the interior orientation it asks for and determines."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from block_rig import CAMERA, MIDDLE, Block, grid_block, photo, pose_of, problem

from geomosaic.orientation.block.adjustment import adjust_block
from geomosaic.orientation.block.facts import block_facts
from geomosaic.orientation.block.poses import CameraPositions
from geomosaic.orientation.block.self_calibration import interior_design, offers, score_test
from geomosaic.orientation.block.solution import BlockSolution
from geomosaic.report.block import offered_text


def declared(block: Block, camera: dict[str, Any], free: tuple[str, ...] = ()) -> Block:
    """Block whose photos start with another camera, of which some parameters are free."""
    start = []
    for model in block.start:
        other = photo("start", np.array([*MIDDLE, 1300.0]), np.zeros(3), camera).with_values(model.parameters.values)
        sigmas = np.where([name in free for name in other.interior.names], np.inf, 0.0)
        other = other.with_interior(replace(other.interior, sigmas=sigmas))
        start.append(replace(other, frame=model.frame, seed=model.seed))
    return replace(block, start=start)


def positions(block: Block, sigma: float = 0.03) -> CameraPositions:
    """Camera positions of all photos, with errors."""
    places = np.array([pose_of(model, block.frame).centre for model in block.models])
    places = places + sigma * np.random.default_rng(4).normal(size=places.shape)
    roots = np.broadcast_to(np.eye(3) / sigma, (len(places), 3, 3)).copy()
    return CameraPositions(np.arange(len(places)), places, roots, np.zeros(3))


def adjusted(block: Block, *more: Any, interior: tuple[str, ...] = ()) -> BlockSolution:
    found = adjust_block(*problem(block, *more, interior=interior))
    ids = tuple(f"P{k}" for k in range(len(block.points)))
    return BlockSolution(found, ids, np.full_like(block.points, np.nan), np.zeros(len(ids), dtype=bool))


TRUE = {**CAMERA, "focal_length_px": 5004.0, "distortion": {"model": "brown", "k1": -0.004}}


@pytest.fixture(scope="module")
def block() -> Block:
    return grid_block(2, 3, 60, seed=11, camera=TRUE, control=6)


def test_a_block_that_determines_its_camera_offers_what_freeing_it_then_finds(block: Block) -> None:
    one = np.zeros(len(block.names), dtype=int)
    solution = adjusted(declared(block, CAMERA), positions(block))
    (offer,) = offers(solution, one)
    assert offer.names == ("focal_length", "k1")
    assert offer.restored  # all camera positions seemed wrong
    (fact,) = block_facts(solution, camera=one)["offered"]
    said = offered_text(fact)
    assert 'interior = ["focal_length", "k1"] would change focal_length by' in said
    assert "px (" in said
    freed = adjusted(declared(block, CAMERA, offer.names), positions(block), interior=offer.names)
    after, before = freed.interior(0), declared(block, CAMERA).start[0].interior
    places = [after.names.index(name) for name in offer.names]
    found = after.values[places] - before.values[places]
    sigmas = np.sqrt(np.diag(freed.camera_covariance(0)))[places]
    assert (np.abs(found - offer.change) < 0.5 * sigmas).all()
    assert offer.sigmas == pytest.approx(sigmas, rel=0.1)
    assert offer.sigma0[1] < offer.sigma0[0]
    assert offer.sigma0[1] == pytest.approx(freed.adjustment.sigma0, rel=0.02)
    assert not freed.correlated()
    assert offers(freed, one) == []


def test_the_score_of_a_block_without_a_datum_is_that_of_freeing_the_parameter(block: Block) -> None:
    def solved(free: tuple[str, ...]) -> BlockSolution:
        built, start = problem(
            replace(declared(block, {**CAMERA, "focal_length_px": 5004.0}, free), control=np.zeros(0, dtype=int)),
            interior=free,
        )
        found = adjust_block(replace(built, free="similarity"), start, robust=False, alpha=None)
        ids = tuple(f"P{k}" for k in range(len(block.points)))
        return BlockSolution(found, ids, np.full_like(block.points, np.nan), np.zeros(len(ids), dtype=bool))

    held, images = solved(()), np.arange(len(block.names))
    names = held.models[0].interior.names
    which = np.array([names.index("k2")])
    score, _ = score_test(
        held.adjustment.network, 1, interior_design(held, images, held.models[0].interior, which), which
    )
    gain = score.freed([0])[2]
    assert gain == pytest.approx(held.adjustment.squares - solved(("k2",)).adjustment.squares, rel=0.02)


def test_a_camera_that_is_right_is_left_alone(block: Block) -> None:
    assert offers(adjusted(declared(block, TRUE), positions(block)), np.zeros(len(block.names), dtype=int)) == []


def test_a_flat_strip_without_camera_positions_is_offered_no_focal_length() -> None:
    strip = grid_block(1, 5, 60, seed=12, camera={**CAMERA, "focal_length_px": 5040.0}, control=6)
    found = offers(adjusted(declared(strip, CAMERA)), np.zeros(len(strip.names), dtype=int))
    assert not any("focal_length" in offer.names for offer in found)
    freed = adjusted(declared(strip, CAMERA, ("focal_length",)), interior=("focal_length",))
    assert any("focal_length" in one for pair in freed.correlated() for one in pair[:2])
