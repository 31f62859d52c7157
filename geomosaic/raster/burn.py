"""Polygons to pixels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from rasterio.features import rasterize, shapes

from geomosaic.geo.grid import Grid
from geomosaic.types import AnyArray


def burn(shapes: Sequence[tuple[Any, int]], grid: Grid, fill: int = -1) -> AnyArray:
    """Give each pixel whose centre lies in a polygon the polygon's number; later ones win.

    Parameters
    ----------
    shapes : sequence of (geometry, number)
        In the grid's CRS.
    grid : Grid
    fill : int
        Number of pixels in no polygon.

    Returns
    -------
    int32 array (rows, cols)
    """
    kept = [(shape, number) for shape, number in shapes if not shape.is_empty]
    if not kept:
        return np.full(grid.shape, fill, dtype=np.int32)
    burnt: AnyArray = rasterize(kept, out_shape=grid.shape, transform=grid.transform, fill=fill, dtype="int32")
    return burnt


def traced(label: AnyArray, grid: Grid) -> list[tuple[Any, int]]:
    """Polygons around cells of equal number (rows, cols), and their numbers; cells below 0 are left out.

    Their borders follow the edges of cells, and neighbours have common vertices.
    """
    from shapely.geometry import shape

    wanted = np.ascontiguousarray(label, dtype=np.int32)
    found = shapes(wanted, mask=wanted >= 0, connectivity=4, transform=grid.transform)
    return [(shape(geometry), int(number)) for geometry, number in found]
