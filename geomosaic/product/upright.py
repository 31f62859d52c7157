"""The ground of a true ortho: its walls stand upright, so that no pixel lies half-way up one."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from affine import Affine
from pyproj import CRS

from geomosaic.geo.grid import Grid, Window
from geomosaic.resample.sight import WALL
from geomosaic.resample.upright import Way
from geomosaic.sensor.ground import BlockGround, Ground
from geomosaic.surface.model import HeightPatch, Surface

COARSE = 0.75
"""Output pixels between nodes from which on it matters; finer nodes leave less than a pixel of every wall."""


@dataclass(frozen=True, eq=False)
class UprightGround(Ground):
    """A surface whose heights of a block are those of its pixels, not of the surface's nodes.

    Where the output has another map than the surface, or is turned against it, they are those of the nodes as ever.

    Attributes
    ----------
    compiled : bool
        Whether the compiled kernel is worth its start; the answer is the same.
    """

    compiled: bool = False

    @classmethod
    def of(cls, grid: Grid, surface: Surface | None, detail: float, *, compiled: bool) -> UprightGround:
        """Put a surface under a grid, see `Ground.under`."""
        below = Ground.under(grid, surface, detail)
        return cls(below.surface, below.grid, below.to_surface, below.spacing, compiled)

    def block(self, window: Window) -> BlockGround:
        """Read the heights of one block."""
        found = super().block(window)
        if found.patch is None or found.unknown or self.to_surface is None or not self.to_surface.identical:
            return found
        node = 1.0 / math.sqrt(abs(found.patch.transform.determinant))
        if self.surface is None or node < COARSE * math.sqrt(math.prod(self.grid.resolution)):
            return found
        # A pixel around the block, for what lies between its outer pixels' centres and its edge.
        wider = self.grid.crop(Window(window.col - 1, window.row - 1, window.width + 2, window.height + 2))
        t = found.patch.transform @ wider.transform @ Affine.translation(0.5, 0.5)
        if t.b != 0.0 or t.d != 0.0:
            return found
        way: Way = (t.a, t.c - 0.5, t.e, t.f - 0.5)
        heights = np.empty(wider.shape, dtype=np.float32)
        wall = WALL * node * rough_metres(self.surface.crs)
        if self.compiled:
            from geomosaic.resample.kernels.upright import upright

            upright(found.patch.heights, way, wall, heights)
        else:
            from geomosaic.resample.upright import upright as by_numpy

            by_numpy(found.patch.heights, way, wall, heights)
        return BlockGround(window, HeightPatch(heights, ~wider.transform), found.heights)


def rough_metres(crs: CRS) -> float:
    """Metres in a unit of a map, roughly."""
    return float(crs.axis_info[0].unit_conversion_factor * (6.4e6 if crs.is_geographic else 1.0))
