"""Lines of sight over a relief: the kernel against NumPy, and relief that must not hide itself."""

from __future__ import annotations

import numpy as np
import numpy_occlusion as oracle
import pytest

from geomosaic.resample.occlusion import STEP, Field, Relief, hidden
from geomosaic.types import ByteArray, Float32Array

SHAPE = (90, 110)


def field(s: tuple[float, float], spread: float = 0.0, width: float = 1.0, between: float = 0.0) -> Field:
    """Lines of sight s (nodes per metre) over a block whose pixels are the nodes 40 columns and rows into the patch.

    Or so far between these nodes and the next.
    """
    rows, cols = -(-SHAPE[0] // STEP) + 1, -(-SHAPE[1] // STEP) + 1
    nodes = np.zeros((rows, cols, 8))
    c, r = np.meshgrid(STEP * np.arange(cols), STEP * np.arange(rows))
    nodes[..., 0], nodes[..., 1] = c - 0.5 + 40 + between, r - 0.5 + 40 + between
    nodes[..., 2] = s[0] + spread * (c - 50) / 100
    nodes[..., 5] = s[1] + spread * (r - 40) / 100
    nodes[..., 3], nodes[..., 7] = 0.02 * s[0], -0.01 * s[1]
    return Field(nodes, 10.0, 0.1, width)


def look(lines: Field, relief: Relief, wanted: ByteArray) -> ByteArray:
    """Hidden places, once the kernel and NumPy agree on them."""
    found, expected = np.zeros_like(wanted), np.zeros_like(wanted)
    hidden(lines, relief, wanted, found)
    oracle.hidden(lines, relief, wanted, expected)
    np.testing.assert_array_equal(found, expected)
    return found


def plain() -> Float32Array:
    return np.zeros((SHAPE[0] + 80, SHAPE[1] + 80), dtype=np.float32)


@pytest.mark.parametrize("between", [0.0, 0.3, 1.0 - 1e-9])
@pytest.mark.parametrize("seed", range(6))
def test_the_kernel_gives_what_numpy_does(seed: int, between: float) -> None:
    rng = np.random.default_rng(seed)
    heights = rng.normal(0.0, 0.3, plain().shape).astype(np.float32)
    for _ in range(25):
        r, c, h, w = rng.integers(0, 150, 2).tolist() + rng.integers(2, 25, 2).tolist()
        heights[r : r + h, c : c + w] = rng.uniform(2.0, 30.0)
    heights[rng.integers(0, 170, 30), rng.integers(0, 190, 30)] = np.nan
    direction = ((0.6, -0.4), (0.0, 0.5), (-0.7, 0.0), (-0.3, -0.3), (1e-9, 1.2), (0.25, 0.9))[seed]
    wanted = (rng.random(SHAPE) < 0.8).astype(np.uint8)
    relief, same = Relief.of(heights, 1.6, 0.5), oracle.prepared(heights, 1.6, 0.5)
    for name, value in vars(relief).items():
        np.testing.assert_array_equal(value, getattr(same, name))
    one = look(field(direction, 0.3, 0.5, between), relief, wanted)
    assert 0.05 < one.mean() < 0.8
    assert not one[wanted == 0].any()


@pytest.mark.parametrize("direction", [(0.5, 0.0), (-0.5, 0.0), (0.0, 0.5), (0.0, -0.5)])
def test_the_shadow_of_a_wall_has_the_length_of_the_closed_form(direction: tuple[float, float]) -> None:
    """A block of 20 m hides 20·|s| nodes behind it, and up to a node more: its walls may stand a node farther out."""
    heights = plain()
    heights[80:90, 90:100] = 20.0
    lines = field(direction)
    lines.nodes[..., 3], lines.nodes[..., 7] = 0.0, 0.0
    one = look(lines, Relief.of(heights, 0.6, 1.0), np.ones(SHAPE, dtype=np.uint8))
    rows, cols = np.nonzero(one)
    rows, cols = rows + 40, cols + 40
    along, low, high = (cols, 90, 99) if direction[0] else (rows, 80, 89)
    beside, first, last = (rows, 80, 89) if direction[0] else (cols, 90, 99)
    behind = low - along if sum(direction) > 0 else along - high
    # For the same reason a line of nodes beside it is called hidden too.
    assert first - 1 <= beside.min() <= beside.max() <= last + 1
    among = behind[(beside >= first) & (beside <= last)]
    assert sorted(set(among.tolist())) in (list(range(1, 11)), list(range(1, 12)))
    assert not one[heights[40 : 40 + SHAPE[0], 40 : 40 + SHAPE[1]] > 0].any()


def test_who_stands_between_nodes_of_a_wall_is_seen_from_before_it_alone() -> None:
    """Wherever between its nodes the wall stands: from the low side, never from behind or past a corner."""
    heights = plain()
    heights[80:90, 90:100] = 20.0
    lines = field((0.5, 0.1), between=0.5)  # the sensor is to the right, and a little below
    lines.nodes[..., 3], lines.nodes[..., 7] = 0.0, 0.0
    one = look(lines, Relief.of(heights, 0.6, 1.0), np.ones(SHAPE, dtype=np.uint8))
    seen = one == 0
    top, bottom, left, right = 39, 49, 49, 59  # pixels between nodes of both
    assert seen[top + 1 : bottom, right].all()
    assert seen[bottom, right]  # the corner towards the sensor
    assert not seen[top : bottom + 1, left].any()
    assert not seen[top, left : right + 1].any()
    assert seen[top + 1 : bottom, left + 1 : right].all()  # the roof


def test_slopes_hide_nothing_until_they_are_as_steep_as_the_line_of_sight() -> None:
    x = np.arange(plain().shape[1], dtype=np.float32)
    for slope, direction, seen in ((0.9, 0.6, True), (-3.0, 0.6, True), (2.0, 0.6, False)):
        heights = np.tile(np.float32(slope) * x, (len(plain()), 1))
        lines = field((direction, 0.0))
        lines.nodes[..., 3] = 0.0  # the same at all heights
        one = look(lines, Relief.of(heights, 0.6, 1.0), np.ones(SHAPE, dtype=np.uint8))
        # Lines of sight rise by 1 / 0.6 m per node. Below that nothing is hidden, above all is but the edge.
        assert one.mean() < 1e-9 if seen else one.mean() > 0.9


def test_rough_ground_does_not_hide_itself() -> None:
    rng = np.random.default_rng(5)
    heights = (0.25 * rng.random(plain().shape)).astype(np.float32)
    relief = Relief.of(heights, 0.45, 0.5)
    one = look(field((0.4, 0.2), width=0.5), relief, np.ones(SHAPE, dtype=np.uint8))
    assert not one.any()
    assert not relief.may_hide(0.45)
    assert not oracle.prepared(heights, 0.45, 0.5).may_hide(0.45)
    assert Relief.of(heights, 8.0, 0.5).may_hide(8.0)
