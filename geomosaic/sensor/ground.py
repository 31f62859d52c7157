"""Heights over one block of output pixels, whatever CRS the surface has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.geo.crs import horizontal
from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.transform import Transform
from geomosaic.surface.model import HeightPatch, Surface
from geomosaic.types import FloatArray


@dataclass(frozen=True, eq=False)
class BlockGround:
    """Heights over one block of output pixels."""

    window: Window
    patch: HeightPatch | None
    heights: tuple[float, float]

    @property
    def unknown(self) -> bool:
        """Whether no height is known here."""
        return bool(np.isnan(self.heights[0]))

    def over(self, surface_xy: FloatArray) -> tuple[float, float]:
        """Lowest and highest height within the bounds of some places (N, 2) of the surface's map; NaN where unknown."""
        if self.patch is None:
            return self.heights
        t = self.patch.transform
        x, y = surface_xy[:, 0], surface_xy[:, 1]
        col, row = t.a * x + t.b * y + t.c - 0.5, t.d * x + t.e * y + t.f - 0.5
        first_col, first_row = (max(0, int(np.floor(np.nanmin(v) - 1e-6)) - 1) for v in (col, row))
        last_col, last_row = (max(0, int(np.ceil(np.nanmax(v) + 1e-6)) + 2) for v in (col, row))
        return HeightPatch(self.patch.heights[first_row:last_row, first_col:last_col], t).range


@dataclass(frozen=True, eq=False)
class Ground:
    """A surface under an output grid.

    Attributes
    ----------
    surface : Surface or None
        None where heights play no part.
    grid : Grid
    to_surface : Transform or None
        Output map to the surface's map.
    spacing : float
        Over which heights may be means, in units of the surface's map: the size of an output pixel at the middle of the
        grid, or a part of it.
    """

    surface: Surface | None
    grid: Grid
    to_surface: Transform | None
    spacing: float = 0.0

    @classmethod
    def under(cls, grid: Grid, surface: Surface | None, detail: float = 1.0) -> Ground:
        """Put a surface under a grid; `detail` is in how many parts of an output pixel its heights may differ."""
        if surface is None:
            return cls(None, grid, None)
        to_surface = Transform(horizontal(grid.crs), horizontal(surface.crs))
        middle = np.array([grid.width / 2, grid.height / 2])
        place, right, below = to_surface(grid.xy(middle + np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])))
        spacing = float(min(np.hypot(*(right - place)), np.hypot(*(below - place))))
        return cls(surface, grid, to_surface, spacing / detail if np.isfinite(spacing) else 0.0)

    def block(self, window: Window) -> BlockGround:
        """Read the heights of one block."""
        if self.surface is None or self.to_surface is None:
            return BlockGround(window, None, (0.0, 0.0))
        cols = np.linspace(window.col, window.stop_col, 5)
        rows = np.linspace(window.row, window.stop_row, 5)
        c, r = np.meshgrid(cols, rows)
        xy = self.to_surface(self.grid.xy(np.column_stack([c.ravel(), r.ravel()])))
        xy = xy[np.isfinite(xy).all(axis=1)]
        if not len(xy):
            return BlockGround(window, None, (float("nan"), float("nan")))
        (left, bottom), (right, top) = xy.min(axis=0), xy.max(axis=0)
        margin = 0.01 * max(right - left, top - bottom)
        bounds = left - margin, bottom - margin, right + margin, top + margin
        patch = self.surface.patch(bounds, self.spacing)
        return BlockGround(window, patch, patch.range)
