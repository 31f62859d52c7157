"""Blunders of points with two or three rays: exchanged ids are named, and nobody is accused whom nothing convicts."""

from __future__ import annotations

import numpy as np
import pytest
from block_rig import Block, adjust_block, grid_block, problem

from geomosaic.orientation.block.blunder_causes import BlockBlunder, blunders
from geomosaic.orientation.block.solution import BlockSolution


@pytest.fixture(scope="module")
def strip() -> Block:
    return grid_block(1, 4, 60, seed=5)


def found(block: Block, colrow: np.ndarray) -> list[BlockBlunder]:
    ids = tuple(f"P{k}" for k in range(len(block.points)))
    given = np.full((len(ids), 3), np.nan)
    return blunders(BlockSolution(adjust_block(*problem(block, colrow=colrow)), ids, given, np.zeros(len(ids), bool)))


def of_rays(block: Block, count: int) -> np.ndarray:
    points = np.flatnonzero(np.bincount(block.point, minlength=len(block.points)) == count)
    return points[points >= len(block.control)]


def rows_of(block: Block, point: int) -> np.ndarray:
    return np.flatnonzero(block.point == point)


def test_ids_of_two_points_of_two_rays_exchanged_in_an_image_are_named(strip: Block) -> None:
    measured = strip.colrow + strip.noise
    points = [p for p in of_rays(strip, 2) if {0, 1} == set(strip.image[rows_of(strip, p)])]
    # Far enough apart across the flight for the rays to miss each other.
    one, other = max(
        ((a, b) for a in points for b in points),
        key=lambda pair: np.ptp([measured[rows_of(strip, p)[0], 0] for p in pair]),
    )
    a, b = rows_of(strip, one)[0], rows_of(strip, other)[0]
    measured[[a, b]] = measured[[b, a]]
    causes = {each.point: each.cause for each in found(strip, measured)}
    assert causes[f"P{one}"] == f"exchanged with point 'P{other}' in s1p1 or s1p2"
    assert causes[f"P{other}"] == f"exchanged with point 'P{one}' in s1p1 or s1p2"


def test_two_rays_that_no_exchange_explains_accuse_neither(strip: Block) -> None:
    measured = strip.colrow + strip.noise
    some = of_rays(strip, 2)[:4]
    for point, off in zip(some, (60.0, -85.0, 130.0, -170.0), strict=True):
        measured[rows_of(strip, point)[0], 0] += off
    causes = {each.point: each.cause for each in found(strip, measured)}
    assert {causes[f"P{point}"] for point in some} == {"its two rays do not meet: either is wrong"}


def test_three_rays_of_a_strip_do_not_tell_which_is_wrong_along_it(strip: Block) -> None:
    measured = strip.colrow + strip.noise
    point = of_rays(strip, 3)[0]
    rows = rows_of(strip, point)
    measured[rows[1], 1] += 25.0
    (wrong,) = (each for each in found(strip, measured) if each.point == f"P{point}")
    others = {strip.names[image] for image in strip.image[rows]} - {wrong.image}
    assert all(name in wrong.cause for name in others)
    assert "three rays cannot tell which" in wrong.cause


def test_three_rays_tell_which_is_wrong_across_the_strip(strip: Block) -> None:
    measured = strip.colrow + strip.noise
    point = of_rays(strip, 3)[0]
    rows = rows_of(strip, point)
    measured[rows[1], 0] += 25.0
    (wrong,) = (each for each in found(strip, measured) if each.point == f"P{point}")
    assert (wrong.image, wrong.cause) == (strip.names[strip.image[rows[1]]], "")


def lost_beside_wrong_rays(seeds: tuple[int, ...]) -> tuple[int, int]:
    """Good rays left out in points of three rays, one of which is wrong (3 % of all), and how many there are."""
    lost = there = 0
    for seed in seeds:
        block = grid_block(3, 4, 60, seed=seed)
        random = np.random.default_rng(seed + 5000)
        ties = ~np.isin(block.point, block.control)
        wrong = ties & (random.random(len(ties)) < 0.03)
        off = random.choice([-1.0, 1.0], block.colrow.shape) * random.uniform(5.0, 400.0, block.colrow.shape)
        measured = block.colrow + block.noise + np.where(wrong[:, None], off, 0.0)
        rejected = adjust_block(*problem(block, colrow=measured, seed=seed)).rejected[0]
        of_three = (np.bincount(block.point) == 3) & (np.bincount(block.point, wrong) == 1)
        beside = of_three[block.point] & ~wrong
        lost, there = lost + int((rejected & beside).sum()), there + int(beside.sum())
        assert rejected[of_three[block.point] & wrong].all()
    return lost, there


def test_two_rays_that_meet_stay_where_robust_rounds_kept_the_wrong_third() -> None:
    """Before such points were intersected anew, it took three good rays with it here, and stayed."""
    assert lost_beside_wrong_rays((106,)) == (0, 6)


@pytest.mark.slow
def test_good_rays_beside_a_wrong_one_of_three_stay() -> None:
    """Measured when written: none of 220; in seven of the 30 blocks the wrong ray stayed, alone."""
    lost, there = lost_beside_wrong_rays(tuple(range(100, 130)))
    assert there > 150
    assert lost <= 0.01 * there
