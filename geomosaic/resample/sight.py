"""What a surface hides from a sensor: each place looks along its line of sight until it is above all there is.

Everything is in pixels of a patch of heights, 0 being the centre of its first node. From a place (x, y) at height z the
line of sight goes by s(x, y, z) patch pixels sideways per metre of height, towards the sensor, so that it rises by
1 / |s| per node. It runs from cell to cell, a cell having a node at each corner, and the place is hidden where the
highest corner of a cell is above the line of sight as it enters.

Walls between nodes may stand anywhere between them: that way they are taken as near as they can be, so that what is
called visible is visible, and a shadow is called up to one node too wide. Lest steep ground hides itself, a cell nearer
than NEAR nodes counts only where it is a wall: where it rises by more than SHARE of the line of sight's rise, or by
more than WALL times its width. The kernel and the NumPy twin here give the same answer.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.types import ByteArray, Float32Array, FloatArray, IntArray

STEP = 64
"""Output pixels between nodes of a field: lines of sight turn evenly over the ground."""
TILE = 8
NEAR = 4.0
SHARE = 0.6
WALL = 3.0
TOUCH = 1e-6
"""Nodes: a cell of which a line of sight passes less is not in its way; places are at nodes but for rounding."""
STEEP = 0.73
"""Ground that rises by less than this share of a line of sight is not in its way beyond NEAR."""


@dataclass(frozen=True)
class Field:
    """Lines of sight over a block of output pixels, on nodes every `STEP` of them from its corner.

    Attributes
    ----------
    nodes : array (rows, cols, 8)
        x, y in the patch; then quadratics of s in x and y, constant first, in t = (z − z_middle) · z_inverse.
    z_middle, z_inverse : float
        Metres, 1 / metres.
    width : float
        Of a cell, metres.
    """

    nodes: FloatArray
    z_middle: float
    z_inverse: float
    width: float


@dataclass(frozen=True)
class Relief:
    """A patch of heights, prepared.

    Attributes
    ----------
    heights : float32 array (rows, cols)
        NaN where unknown, which hides nothing.
    cells : float32 array (rows − 1, cols − 1)
        Highest of its four nodes.
    ranges : float32 array (rows − 1, cols − 1)
        Between its highest and lowest node.
    tiles : float32 array
        Highest of `TILE` × `TILE` cells.
    walls : float32 array
        Highest of those of them that may be walls to the line of sight that rises least.
    top : float
        Highest of all.
    steepest : float
        Metres per node that no slope exceeds.
    """

    heights: Float32Array
    cells: Float32Array
    ranges: Float32Array
    tiles: Float32Array
    walls: Float32Array
    top: float
    steepest: float

    @classmethod
    def of(cls, heights: Float32Array, longest: float, width: float) -> Relief:
        """Prepare a patch of two rows and columns or more.

        Parameters
        ----------
        heights : float32 array (rows, cols)
        longest : float
            Nodes per metre by which lines of sight go sideways at most.
        width : float
            Of a cell, metres.
        """
        pairs, lower = np.fmax(heights[1:], heights[:-1]), np.fmin(heights[1:], heights[:-1])
        cells = np.fmax(pairs[:, 1:], pairs[:, :-1])
        ranges = cells - np.fmin(lower[:, 1:], lower[:, :-1])
        unknown = np.isnan(cells)
        if unknown.any():
            cells[unknown], ranges[unknown] = -np.inf, 0.0
        walls = np.where(ranges > _least_wall(longest, width), cells, np.float32(-np.inf))
        rises = [float(np.fmax.reduce(np.abs(np.diff(heights, axis=axis)), axis=None, initial=0.0)) for axis in (0, 1)]
        steepest = float(np.hypot(rises[0], rises[1]))
        return cls(heights, cells, ranges, _highest(cells), _highest(walls), float(cells.max()), steepest)

    def may_hide(self, longest: float, width: float) -> bool:
        """Whether anything can be in the way of lines of sight that go sideways by up to `longest` nodes per metre."""
        if longest == 0.0:
            return False
        walls = float(self.ranges.max()) > _least_wall(longest, width)
        return walls or self.steepest * longest >= STEEP


def _least_wall(longest: float, width: float) -> float:
    """Rise of a cell from which on it may be a wall to some line of sight."""
    return min(SHARE / longest, WALL * width) if longest > 0.0 else WALL * width


def _highest(cells: Float32Array) -> Float32Array:
    """Highest of each tile of cells."""
    rows, cols = -(-cells.shape[0] // TILE), -(-cells.shape[1] // TILE)
    padded = np.full((rows * TILE, cols * TILE), np.float32(-np.inf))
    padded[: cells.shape[0], : cells.shape[1]] = cells
    by_rows = np.maximum.reduce(padded.reshape(rows, TILE, cols * TILE), axis=1)
    return np.asarray(np.maximum.reduce(by_rows.reshape(rows, cols, TILE), axis=2))


def hidden(field: Field, relief: Relief, wanted: ByteArray, out: ByteArray) -> None:
    """Set `out` to 1 where the surface hides what is `wanted`, both uint8 (rows, cols) of the block."""
    rows, cols = np.nonzero(wanted)
    if not len(rows):
        return
    x, y, sx, sy, z = _lines(field, relief.heights, rows, cols)
    length = np.sqrt(sx * sx + sy * sy)
    on = np.flatnonzero(np.isfinite(z) & (length > 1e-12))
    rise = 1.0 / length[on]
    ux, uy = sx[on] * rise, sy[on] * rise
    col, row = np.floor(x[on]), np.floor(y[on])
    with np.errstate(divide="ignore", invalid="ignore"):
        across, down = np.abs(1.0 / ux), np.abs(1.0 / uy)
        next_x = np.where(ux == 0.0, np.inf, (col + (ux > 0.0) - x[on]) / ux)
        next_y = np.where(uy == 0.0, np.inf, (row + (uy > 0.0) - y[on]) / uy)
    wall = np.minimum(SHARE * rise, WALL * field.width)
    step_x, step_y = np.where(ux > 0.0, 1.0, -1.0), np.where(uy > 0.0, 1.0, -1.0)
    # One row each, so that those still on their way are kept in one go.
    state = np.stack([z[on], rise, wall, step_x, step_y, across, down, col, row, next_x, next_y, np.zeros(len(on))])
    high, wide = relief.cells.shape
    while len(on):
        z, rise, wall, step_x, step_y, across, down, col, row, next_x, next_y, t = state
        level = z + rise * t
        inside = (col >= 0) & (row >= 0) & (col < wide) & (row < high) & (level < relief.top)
        i, j = np.where(inside, row, 0).astype(np.int64), np.where(inside, col, 0).astype(np.int64)
        leave = np.minimum(next_x, next_y)
        counts = (leave > t + TOUCH) & ((t >= NEAR) | (relief.ranges[i, j] > wall))
        blocked = inside & counts & (relief.cells[i, j] > level)
        out[rows[on[blocked]], cols[on[blocked]]] = 1
        by_x = next_x <= next_y
        state[7:] = (
            np.where(by_x, col + step_x, col),
            np.where(by_x, row, row + step_y),
            np.where(by_x, next_x + across, next_x),
            np.where(by_x, next_y, next_y + down),
            leave,
        )
        keep = inside & ~blocked
        on, state = on[keep], state[:, keep]


def _lines(field: Field, heights: Float32Array, rows: IntArray, cols: IntArray) -> tuple[FloatArray, ...]:
    """Place, direction and height of the lines of sight of some pixels."""
    v, u = (rows + 0.5) / STEP, (cols + 0.5) / STEP
    i, j = v.astype(np.int64), u.astype(np.int64)
    v, u = v - i, u - j
    n = field.nodes
    left = n[i, j] + (n[i + 1, j] - n[i, j]) * v[:, None]
    right = n[i, j + 1] + (n[i + 1, j + 1] - n[i, j + 1]) * v[:, None]
    at = left + (right - left) * u[:, None]
    z = _bilinear(heights, at[:, 0], at[:, 1])
    t = (z - field.z_middle) * field.z_inverse
    sx = at[:, 2] + t * (at[:, 3] + t * at[:, 4])
    sy = at[:, 5] + t * (at[:, 6] + t * at[:, 7])
    return at[:, 0], at[:, 1], sx, sy, z


def _bilinear(heights: Float32Array, x: FloatArray, y: FloatArray) -> FloatArray:
    """Heights between nodes; NaN beyond them, or where one of the four is unknown."""
    inside = (x >= 0.0) & (y >= 0.0) & (x < heights.shape[1] - 1) & (y < heights.shape[0] - 1)
    i, j = np.where(inside, y, 0.0).astype(np.int64), np.where(inside, x, 0.0).astype(np.int64)
    u, v = x - j, y - i
    above = heights[i, j] * (1.0 - u) + heights[i, j + 1] * u
    below = heights[i + 1, j] * (1.0 - u) + heights[i + 1, j + 1] * u
    return np.where(inside, above * (1.0 - v) + below * v, np.nan)
