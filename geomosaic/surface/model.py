"""Surface contract: heights over a map, in a 3-D CRS that names their vertical datum."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from affine import Affine
from pyproj import CRS

from geomosaic.geo.grid import Bounds
from geomosaic.types import Float32Array, FloatArray


@dataclass(frozen=True, eq=False)
class HeightPatch:
    """A window of heights for the sampling kernel.

    Attributes
    ----------
    heights : float32 array (rows, cols)
        Metres; NaN where unknown.
    transform : Affine
        Surface map (x, y) to patch (col, row), corner-based: a node's height holds at (col + 0.5, row + 0.5).
    """

    heights: Float32Array
    transform: Affine

    @property
    def range(self) -> tuple[float, float]:
        """Lowest and highest known height; NaN where none is known."""
        low, high = (step.reduce(self.heights, None, initial=np.nan) for step in (np.fmin, np.fmax))
        return float(low), float(high)


class Surface(Protocol):
    """Heights z over (x, y)."""

    @property
    def crs(self) -> CRS:
        """3-D CRS of x, y and z."""

    @property
    def range(self) -> tuple[float, float]:
        """Lowest and highest height in metres; every height lies between them."""

    def height(self, xy: FloatArray) -> FloatArray:
        """Heights (N,) at (N, 2) in `crs`; NaN where unknown."""

    def patch(self, bounds: Bounds, spacing: float = 0.0) -> HeightPatch:
        """Heights that cover bounds (left, bottom, right, top) in `crs`, with a margin for interpolation.

        They may be means over `spacing`, in units of the CRS: no more detail is needed.
        """
