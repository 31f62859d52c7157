"""Reliability of a block: errors of the minimal detectable size are found as often, and move as much, as foretold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from block_rig import Block, adjust_block, grid_block, problem
from scipy.stats import chi2

from geomosaic.orientation.block.adjustment import BlockAdjustment
from geomosaic.orientation.block.observations import in_units
from geomosaic.orientation.block.reliability import ALPHA0, POWER, noncentrality, reliability
from geomosaic.orientation.block.residual_statistics import residual_statistics


@pytest.fixture(scope="module")
def found() -> tuple[Block, BlockAdjustment]:
    block = grid_block(2, 3, 30, seed=3)
    return block, adjust_block(*problem(block), alpha=None)


def worst_error(adjustment: BlockAdjustment, index: int, row: int, effect: np.ndarray | None = None) -> np.ndarray:
    """Whitened error of the detectable size whose length, or effect, is largest: found by trying all directions."""
    share = adjustment.statistics[index].share[row]
    size = len(share)
    tried = np.random.default_rng(0).normal(size=(20000, size))
    tried *= np.sqrt(noncentrality(size) / np.einsum("ni,ij,nj->n", tried, share, tried))[:, None]
    by = np.linalg.pinv(adjustment.problem.groups[index].root[row]) if effect is None else effect
    return tried[np.argmax(np.linalg.norm(tried @ by.T, axis=1))]


def well_checked(adjustment: BlockAdjustment) -> int:
    share = adjustment.statistics[0].share
    return int(np.argmax(np.linalg.eigvalsh(share)[:, 0]))


def test_the_noncentrality_is_baardas() -> None:
    assert noncentrality(1) == pytest.approx(17.075, abs=1e-3)
    assert np.sqrt(noncentrality(1)) == pytest.approx(4.13, abs=5e-3)
    assert noncentrality(2) == pytest.approx(19.66, abs=1e-2)


@pytest.mark.parametrize("index", [0, 1], ids=["image position", "control"])
def test_an_error_of_the_detectable_size_is_found_in_four_of_five_cases(
    found: tuple[Block, BlockAdjustment], index: int
) -> None:
    adjustment = found[1]
    row = well_checked(adjustment) if index == 0 else 0
    error = worst_error(adjustment, index, row)
    of_it = reliability(adjustment)[index].detectable[row]
    whitened = np.zeros((len(adjustment.statistics[index].share), len(error)))
    whitened[row] = error
    assert np.linalg.norm(in_units(adjustment.problem.groups[index], whitened)[row]) == pytest.approx(of_it, rel=5e-3)
    random, network = np.random.default_rng(1), adjustment.network
    share, size = adjustment.statistics[index].share[row], len(error)
    first = index * network.groups[0].misclosure.size + row * size
    count, limit, times = 0, chi2.isf(ALPHA0, size), 200
    for _ in range(times):
        noise = random.normal(size=network.misclosure.shape)
        noise[first : first + size] += error
        # Residuals of one observation: its row of I − A·Q·Aᵀ.
        sides = network.normals.turned_product(
            [part.reshape(g.misclosure.shape) for part, g in zip(split(noise, adjustment), network.groups, strict=True)]
        )
        step = network.solve(np.concatenate([sides[0], sides[1][network.moving]]))
        left = (noise - (network.misclosure - network.residuals(step)))[first : first + size]
        count += left @ np.linalg.solve(share, left) > limit
    assert abs(count / times - POWER) < 3.0 * np.sqrt(POWER * (1.0 - POWER) / times)


def split(values: np.ndarray, adjustment: BlockAdjustment) -> list[np.ndarray]:
    return np.split(values, np.cumsum([g.misclosure.size for g in adjustment.network.groups])[:-1])


def test_an_unseen_error_moves_its_point_as_far_as_foretold(found: tuple[Block, BlockAdjustment]) -> None:
    adjustment = found[1]
    views, row = adjustment.problem.views, well_checked(adjustment)
    effect = adjustment.network.point_influence(0)[row]
    error = worst_error(adjustment, 0, row, effect)
    colrow = views.colrow.copy()
    colrow[row] += np.linalg.inv(views.root[row]) @ error
    groups = (replace(views, colrow=colrow), *adjustment.problem.groups[1:])
    again = adjust_block(replace(adjustment.problem, groups=groups), adjustment.state, alpha=None)
    moved = np.linalg.norm((again.state.points - adjustment.state.points)[views.points[row]])
    assert moved == pytest.approx(reliability(adjustment)[0].shift[row], rel=5e-3)


def test_an_unseen_error_of_control_moves_its_point_as_far_as_foretold(found: tuple[Block, BlockAdjustment]) -> None:
    adjustment = found[1]
    control = adjustment.problem.groups[1]
    error = worst_error(adjustment, 1, 0, adjustment.network.point_influence(1)[0])
    xyz = control.xyz.copy()
    xyz[0] += np.linalg.inv(control.root[0]) @ error
    groups = (adjustment.problem.views, replace(control, xyz=xyz), *adjustment.problem.groups[2:])
    again = adjust_block(replace(adjustment.problem, groups=groups), adjustment.state, alpha=None)
    moved = np.linalg.norm((again.state.points - adjustment.state.points)[control.points[0]])
    assert moved == pytest.approx(reliability(adjustment)[1].shift[0], rel=5e-3)


def test_nothing_checks_a_point_of_two_rays_along_its_rays(found: tuple[Block, BlockAdjustment]) -> None:
    adjustment = found[1]
    views, control = adjustment.problem.views, adjustment.problem.groups[1]
    rays = np.bincount(views.points)[views.points]
    two = (rays == 2) & ~np.isin(views.points, control.points)
    of_rays = reliability(adjustment)[0]
    assert two.any()
    assert np.isinf(of_rays.detectable[two]).all()
    assert np.isfinite(of_rays.detectable[rays > 3]).all()


def test_measurements_that_were_left_out_have_no_reliability(found: tuple[Block, BlockAdjustment]) -> None:
    block, adjustment = found
    colrow = adjustment.problem.views.colrow.copy()
    colrow[well_checked(adjustment)] += 100.0
    again = adjust_block(*problem(block, colrow=colrow))
    assert np.isnan(reliability(again)[0].detectable[again.rejected[0]]).all()
    assert again.rejected[0].any()
    assert len(residual_statistics(again.problem, again.state, again.rejected)) == len(reliability(again))
