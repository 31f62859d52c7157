"""Occlusion by a surface: each place looks along its line of sight until it is above all heights.

Everything is in pixels of a patch of heights, 0 being the centre of its first node. From a place (x, y) at height z the
line of sight goes by s(x, y, z) patch pixels sideways per metre of height, towards the sensor, so that it rises by
1 / |s| per node. It runs from cell to cell, a cell having a node at each corner, and the place is hidden where the
highest corner of a cell is above the line of sight as it enters.

Walls between nodes may stand anywhere between them: that way they are taken as near as they can be, so that what is
called visible is visible, and a shadow is called up to one node too wide. Lest steep ground hides itself, a cell nearer
than four nodes counts only where it is a wall: where it rises by more than SHARE of the line of sight's rise, or by
more than WALL times its width.

A place between nodes of a wall may stand on it or at its foot. It is taken as seen where its foot is, wherever between
these nodes the wall stands: where the line of sight leaves the cell by an edge that is low, and away from the wall.
The lines are followed in `kernels/occlusion.cpp`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.kernels.library import native
from geomosaic.types import ByteArray, Float32Array, FloatArray

# Output pixels between nodes of a field: lines of sight turn evenly over the ground.
STEP = 64
TILE = 8
SHARE = 0.6
WALL = 3.0
# Ground that rises by less than this share of a line of sight is not in its way beyond what only walls count in.
STEEP = 0.73

_prepare = native("prepare_relief", "sffisss")
_hidden = native("hidden", "dffisssfiffuu")
_upright = native("upright", "sfffffs")


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
    tiles : float32 array
        Highest of `TILE` × `TILE` cells, each of which is as high as the highest of its nodes.
    walls : float32 array
        Highest of those of them that may be walls to the line of sight that rises least.
    top : float
        Highest of all.
    steepest : float
        Metres per node that no slope exceeds; 0 where all slopes are too gentle to be in the way of anything.
    """

    heights: Float32Array
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
        heights = np.ascontiguousarray(heights)
        least = min(SHARE / longest, WALL * width) if longest > 0.0 else WALL * width
        gentle = STEEP / longest / 2.0 if longest > 0.0 else np.inf
        shape = -(-(heights.shape[0] - 1) // TILE), -(-(heights.shape[1] - 1) // TILE)
        tiles, walls = np.empty(shape, dtype=np.float32), np.empty(shape, dtype=np.float32)
        rises = np.empty(2, dtype=np.float32)
        _prepare(heights, least, gentle, TILE, tiles, walls, rises)
        return cls(heights, tiles, walls, float(tiles.max()), float(np.hypot(float(rises[0]), float(rises[1]))))

    def may_hide(self, longest: float) -> bool:
        """Whether anything can be in the way of lines of sight that go sideways by up to `longest` nodes per metre."""
        if longest == 0.0:
            return False
        return bool((self.walls > -np.inf).any()) or self.steepest * longest >= STEEP


def hidden(field: Field, relief: Relief, wanted: ByteArray, out: ByteArray) -> None:
    """Places of a block that the surface hides.

    Parameters
    ----------
    field : Field
        Lines of sight over the block.
    relief : Relief
        Heights that they may run into.
    wanted : uint8 array (rows, cols)
        Pixels of the block that are looked at.
    out : uint8 array (rows, cols)
        Set to 1 where the place is hidden.
    """
    _hidden(
        field.nodes,
        field.z_middle,
        field.z_inverse,
        STEP,
        relief.heights,
        relief.tiles,
        relief.walls,
        relief.top,
        TILE,
        SHARE,
        WALL * field.width,
        wanted,
        out,
    )


# From pixels to nodes: x = a · col + b, y = c · row + d.
Way = tuple[float, float, float, float]


def upright(heights: Float32Array, way: Way, wall: float, out: Float32Array) -> None:
    """Fill `out` (rows, cols) with heights at whole cols and rows; NaN beyond the nodes and where one is unknown.

    Parameters
    ----------
    heights : float32 array (rows, cols)
        NaN where unknown.
    way : tuple of float
        From columns and rows of `out` to nodes.
    wall : float
        Metres between nodes beyond which a wall stands there.
    out : float32 array (rows, cols)
    """
    _upright(np.ascontiguousarray(heights), *way, wall, out)
