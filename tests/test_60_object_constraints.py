"""Lakes, planes, lines, distances and rigs in a block: derivatives, datum, and what they bring it nearer to truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from block_rig import Block, grid_block, pose_of
from scipy.spatial.transform import Rotation

from geomosaic.estimation.solver import Outcome, Unknowns, solve
from geomosaic.orientation.block.adjustment import RULES, BlockAdjustment, adjust_block
from geomosaic.orientation.block.blunder_causes import blunders
from geomosaic.orientation.block.object_constraints import CommonHeights, Distances, OnSurfaces
from geomosaic.orientation.block.observations import GroundControl, Group, ImagePositions
from geomosaic.orientation.block.poses import RelativeAttitudes, RelativePositions
from geomosaic.orientation.block.problem import BlockProblem
from geomosaic.orientation.block.solution import BlockSolution
from geomosaic.orientation.block.unknowns import BlockState, BlockUnknowns

PLANE, LINE, LAKE = np.array([0.15, -0.1, 1.0]), np.array([0.6, 0.8, 0.05]), 35.0
UNIT = {name: v / np.linalg.norm(v) for name, v in (("plane", PLANE), ("line", LINE))}
THROUGH = np.array([15.0, -5.0, 8.0])


def shaped(kind: str, *, every: int = 3, control: int = 0, seed: int = 2) -> tuple[Block, np.ndarray]:
    """Block some of whose points lie on a plane, on a line or at one height, and these points."""
    block = grid_block(2, 3, 30, seed=seed, control=control)
    seen = np.bincount(block.point, minlength=len(block.points)) >= 2
    seen[block.control] = False
    on = np.flatnonzero(seen)[::every]
    points = block.points.copy()
    if kind == "plane":
        points[on, 2] = 10.0 - points[on, :2] @ PLANE[:2]
    elif kind == "line":
        points[on] = (points[on] @ UNIT["line"])[:, None] * UNIT["line"] + THROUGH
    else:
        ground = block.frame.to_ground(points)
        ground[on, 2] = 300.0 + LAKE
        points = block.frame.from_ground(ground)
    colrow = block.colrow.copy()
    for image, model in enumerate(block.models):
        rows = block.image == image
        colrow[rows] = model.ground_to_image(block.frame.places(model.crs, points[block.point[rows]]))
    block.points, block.colrow = points, colrow
    return block, on


def of_shape(kind: str, on: np.ndarray, first: np.ndarray, block: Block, sigma: float = 0.05) -> tuple[Group, Unknowns]:
    """Observations that points belong together, by a fit to their first coordinates."""
    sigmas, body = np.full(len(on), sigma), np.zeros(len(on), dtype=np.int64)
    if kind == "lake":
        height = block.frame.to_ground(first[on])[:, 2].mean()
        return CommonHeights(on, body, sigmas), Unknowns(("lake a: height",), np.array([height]), np.ones(1), FREE[:1])
    middle = first[on].mean(axis=0)
    axes = np.linalg.svd(first[on] - middle)[2]
    axes = axes[[1, 2, 0]] if kind == "line" else axes
    axes = axes * np.sign(np.linalg.det(axes))
    count = 4 if kind == "line" else 3
    names = tuple(f"{kind} a: {each}" for each in "abcd"[:count])
    group = OnSurfaces(
        on, body, np.broadcast_to(axes, (len(on), 3, 3)), np.broadcast_to(middle, (len(on), 3)), sigmas, kind == "line"
    )
    return group, Unknowns(names, np.zeros(count), np.array([1e-2, 1e-2, 0.1, 0.1])[:count], FREE[:count])


FREE = np.full(4, np.inf)


def built(
    block: Block, groups: Sequence[Group], further: Sequence[Unknowns], first: np.ndarray, kept: Sequence[int] = ()
) -> tuple[BlockProblem, BlockState]:
    count = len(block.colrow)
    views = ImagePositions(
        block.image, block.point, block.colrow + block.noise, np.broadcast_to(np.eye(2) / 0.3, (count, 2, 2)).copy()
    )
    unknowns = BlockUnknowns.of(
        block.names, block.start, np.full(len(block.names), -1), further, np.array(kept, dtype=np.int64), first
    )
    found = BlockProblem.of(block.frame, unknowns, [views, *groups])
    return found, found.start(block.start, first, [each.start for each in further])


def near(block: Block, size: float = 5.0) -> np.ndarray:
    return block.points + size * np.random.default_rng(4).normal(size=block.points.shape)


def rig_of(block: Block, rig: int = -1) -> list[Group]:
    """Relative poses of each photo of the first strip and the one beside it."""
    first, second = np.arange(3), np.arange(3) + 3
    poses = [pose_of(model, block.frame) for model in block.models]
    pairs = [(poses[a], poses[b]) for a, b in zip(first, second, strict=True)]
    base = np.array([one.rotation @ (other.centre - one.centre) for one, other in pairs])
    turn = np.array([other.rotation @ one.rotation.T for one, other in pairs])
    roots = np.broadcast_to(np.eye(3) / 0.02, (3, 3, 3))
    rigs = np.full(3, rig) if rig >= 0 else np.zeros(0, dtype=np.int64)
    return [
        RelativePositions(first, second, roots, base, rig=rigs),
        RelativeAttitudes(first, second, roots * 4.0, turn, rig=rigs + (rig >= 0)),
    ]


@pytest.mark.parametrize("kind", ["plane", "line", "lake", "distance", "rig"])
def test_derivatives_agree_with_differences(kind: str) -> None:
    block, on = shaped(kind if kind in ("plane", "line") else "lake")
    first = near(block)
    kept: tuple[int, ...] = ()
    if kind == "distance":
        kept = (int(on[0]), int(on[1]))
        groups: list[Group] = [Distances(on[:1], on[1:2], np.array([500.0]), np.array([0.1]))]
        further = []
    elif kind == "rig":
        groups = rig_of(block, 0)
        further = [Unknowns((f"rig: {a}",) * 3, np.full(3, 0.2), np.ones(3), FREE[:3]) for a in "ab"]
    else:
        group, unknown = of_shape(kind, on, first, block)
        groups, further = [group], [replace(unknown, start=unknown.start + 3.0)]
    problem, state = built(block, groups, further, first, kept)
    network = problem.linearise(state)
    rows = slice(2 * len(block.point[state.weights[0] > 0.0]), None)
    random = np.random.default_rng(1)
    steps = problem.unknowns.all.steps[problem.unknowns.all.free]
    for _ in range(4):
        change = np.concatenate([steps * random.normal(size=len(steps)), np.zeros(network.unknowns - len(steps))])
        change[len(steps) :] = 0.1 * random.normal(size=network.unknowns - len(steps))

        def computed(size: float, change: np.ndarray = change) -> np.ndarray:
            moved = problem.moved(state, size * change)
            return -np.concatenate([g.misclosure(moved, problem.frame).ravel() for g in groups])

        # Four ends: the error of plain central differences, of the third order, is above the bound.
        slope = (8.0 * (computed(0.1) - computed(-0.1)) - (computed(0.2) - computed(-0.2))) / 1.2
        found = (network.design @ change)[rows]
        assert np.abs(found - slope).max() < 1e-7 * np.abs(slope).max()


@pytest.mark.parametrize(("kind", "directions"), [("plane", 7), ("line", 7), ("lake", 5), ("rig", 0)])
def test_a_free_datum_goes_along_with_planes_and_lines_and_leaves_out_what_is_observed(
    kind: str, directions: int
) -> None:
    block, on = shaped(kind if kind != "rig" else "lake")
    first = near(block)
    if kind == "rig":
        groups, further = rig_of(block), []
        directions = 6  # its base has a length
    else:
        group, unknown = of_shape(kind, on, first, block)
        groups, further = [group], [unknown]
    problem, state = built(block, groups, further, first)
    solution = solve(replace(problem, free="similarity"), state, RULES)
    assert solution.outcome is Outcome.CONVERGED
    assert solution.rounds <= 8
    network = solution.equations
    assert network.datum.directions.shape[1] == directions  # type: ignore[attr-defined]
    assert solution.squares / network.redundancy == pytest.approx(1.0, abs=0.5)  # type: ignore[attr-defined]
    shares = [np.trace(each, axis1=1, axis2=2).sum() for each in network.redundancy_numbers()]  # type: ignore[attr-defined]
    # The scale alone is not quite free where planes have a standard deviation in metres.
    assert sum(shares) == pytest.approx(network.redundancy, abs=0.2)  # type: ignore[attr-defined]


def weak(block: Block, sigma: float = 5.0) -> GroundControl:
    """Control that hardly holds the block."""
    given = block.points[block.control]
    return GroundControl(block.control, given, np.broadcast_to(np.eye(3) / sigma, (len(given), 3, 3)))


def spread(block: Block, found: BlockAdjustment, on: np.ndarray) -> np.ndarray:
    """Standard deviations (3,) of some points, RMS."""
    return np.sqrt(np.diagonal(found.network.point_cofactors()[on], axis1=1, axis2=2).mean(axis=0))


@pytest.mark.parametrize("kind", ["plane", "line", "lake"])
def test_points_that_belong_together_bring_a_weak_block_nearer_to_truth(kind: str) -> None:
    before, after = [], []
    for seed in range(2):
        block, on = shaped(kind, control=4, seed=seed + 2)
        first = near(block)
        group, unknown = of_shape(kind, on, first, block, 0.02)
        without = adjust_block(*built(block, [weak(block)], [], first), robust=False, alpha=None)
        found = adjust_block(*built(block, [weak(block), group], [unknown], first), robust=False, alpha=None)
        assert found.redundancy - without.redundancy == len(on) * (2 if kind == "line" else 1) - len(unknown.names)
        total = sum(np.trace(one.share[w > 0.0], axis1=1, axis2=2).sum()
                    for one, w in zip(found.statistics, found.state.weights, strict=True))  # fmt: skip
        assert total == pytest.approx(found.redundancy, abs=1e-5)
        flat = lake_scatter if kind == "lake" else surface_scatter
        before.append(flat(block, without, on, kind))
        after.append(flat(block, found, on, kind))
        if kind == "lake":  # it holds the tilts of the block, too
            assert spread(block, found, on)[2] < 0.7 * spread(block, without, on)[2]
    assert np.median(after) < 0.1 * np.median(before)


def lake_scatter(block: Block, found: BlockAdjustment, on: np.ndarray, kind: str) -> float:
    """Scatter of heights that are one."""
    return float(block.frame.to_ground(found.state.points[on])[:, 2].std())


def surface_scatter(block: Block, found: BlockAdjustment, on: np.ndarray, kind: str) -> float:
    """Distances from the best plane or line, RMS."""
    off = found.state.points[on] - found.state.points[on].mean(axis=0)
    values = np.linalg.svd(off, compute_uv=False)
    return float(np.hypot(*values[1:]) if kind == "line" else values[2])


def off_shape(kind: str, points: np.ndarray) -> np.ndarray:
    """Distances of points from the true plane or line, or of their heights from the lake's."""
    if kind == "line":
        return np.linalg.norm(np.cross(points - THROUGH, UNIT["line"]), axis=1)
    return np.abs((points - [0.0, 0.0, 10.0]) @ UNIT["plane"]) if kind == "plane" else np.abs(points[:, 2] - LAKE)


@pytest.mark.parametrize("kind", ["plane", "line", "lake"])
def test_a_point_that_is_not_where_it_was_said_to_be_is_named(kind: str) -> None:
    block, on = shaped(kind, control=4)
    rays = np.bincount(block.point, minlength=len(block.points))
    # High above the plane, the line and the lake.
    others = np.flatnonzero((rays >= 3) & ~np.isin(np.arange(len(rays)), [*on, *block.control]))
    stray = int(others[np.argmax(off_shape(kind, block.points[others]))])
    members = np.sort(np.append(on, stray))
    first = near(block)
    group, unknown = of_shape(kind, members, first, block)
    found = adjust_block(*built(block, [weak(block, 0.02), group], [unknown], first))
    assert np.flatnonzero(found.rejected[2]).tolist() == [int(np.flatnonzero(members == stray)[0])]
    assert not found.rejected[0].any()
    names = tuple(f"t{index}" for index in range(len(block.points)))
    none = np.full(block.points.shape, np.nan)
    (told,) = blunders(BlockSolution(found, names, none, np.zeros(len(names), dtype=bool)))
    assert f"point 't{stray}' is off by" in str(told)
    assert f"it does not lie on {kind} a" in str(told)


def test_a_wrong_distance_is_named_with_its_ends() -> None:
    block, on = shaped("lake", control=4)
    a, b = int(on[0]), int(on[-1])
    length = float(np.linalg.norm(block.points[a] - block.points[b]))
    bar = Distances(np.array([a]), np.array([b]), np.array([length + 2.0]), np.array([0.01]))
    found = adjust_block(*built(block, [weak(block, 0.02), bar], [], near(block), (a, b)))
    assert found.rejected[2].tolist() == [True]
    assert not found.rejected[0].any()
    names = tuple(f"t{index}" for index in range(len(block.points)))
    (told,) = blunders(
        BlockSolution(found, names, np.full(block.points.shape, np.nan), np.zeros(len(names), dtype=bool))
    )
    assert f"points 't{a}' and 't{b}' is off by" in str(told)


def test_a_plane_that_keeps_too_few_points_takes_no_part() -> None:
    block, on = shaped("plane", every=10, control=4)
    assert len(on) >= 4
    first = near(block)
    first[on[2:]] = np.nan
    group, unknown = of_shape("plane", on, near(block), block)
    found = adjust_block(*built(block, [weak(block, 0.02), group], [unknown], first))
    assert not found.state.weights[2].any()
    assert 0.8 < found.sigma0 < 1.2


@pytest.mark.slow
def test_a_rig_of_unknown_base_is_found_from_all_its_exposures() -> None:
    """Two strips as a rig: second photos stand as the truth of the first pair says, in each pair alike."""
    block = grid_block(2, 3, 40, seed=2)
    poses = [pose_of(model, block.frame) for model in block.models]
    groups = rig_of(block, 0)
    shift, turn = np.array([1.0, -2.0, 0.5]), np.array([0.1, -0.2, 0.3])
    further = [Unknowns((f"rig: {a}",) * 3, np.zeros(3), np.full(3, 0.1), FREE[:3]) for a in "ab"]
    # What was read of the rig is wrong by the same in all exposures.
    wrong = Rotation.from_rotvec(turn, degrees=True).as_matrix().T
    assert isinstance(groups[0], RelativePositions)
    assert isinstance(groups[1], RelativeAttitudes)
    groups = [replace(groups[0], base=groups[0].base - shift), replace(groups[1], rotation=wrong @ groups[1].rotation)]
    found = adjust_block(*built(block, [weak(block, 0.02), *groups], further, near(block)))
    for value, true in zip(found.state.further, (shift, turn), strict=True):
        sigma = np.sqrt(np.diagonal(found.network.parameter_cofactors())[-6:].max())
        assert np.abs(value - true).max() < 4.0 * sigma
    assert len(poses) == 6
