"""What images show of their rectangles: orthos have corners of nodata; seams and ramps belong to the data's edge."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np

from geomosaic.errors import GeomosaicWarning
from geomosaic.geo.grid import Grid
from geomosaic.product.colour.balance import comparison_grid, thumbnail
from geomosaic.product.options import RenderOptions
from geomosaic.product.photos import Photos
from geomosaic.product.pool import in_order
from geomosaic.raster.burn import traced
from geomosaic.raster.source import inspect
from geomosaic.types import ByteArray

CELLS = 256
"""Cells across a footprint at which it is looked at."""
WHOLE = 0.995
"""Part of the rectangle that an image must show to count as whole."""
_HOLE = 64
"""Cells of the smallest hole that is kept."""


def outlines_of(photos: Photos, options: RenderOptions) -> list[Any]:
    """Outline of what each image shows, in the output map.

    That of its rectangle, unless the file marks missing pixels and more than a few are missing. Then it is that of the
    valid cells of a coarse grid, drawn in by three quarters of a cell, so that the image surely shows what lies within.

    Returns
    -------
    list of Polygon or MultiPolygon
    """
    shapes: list[Any] = [outline.polygon for outline in photos.outlines]
    masked = [
        i for i, scene in enumerate(photos.block.scenes)
        if scene.nodata is not None or inspect(scene.path, scene.bands).masked
    ]  # fmt: skip
    if not masked or len(photos) == 1:
        return shapes
    grid = comparison_grid(photos, CELLS)
    empty = []
    for i, (part, valid) in in_order(lambda i: _valid(photos, i, grid), masked, options.threads, ahead=1):
        found = _outline(part, valid, shapes[i]) if valid.size else None
        if found is not None:
            shapes[i] = found
        elif valid.size and not valid.any():
            empty.append(photos.outlines[i].name)
    if empty:
        warnings.warn(
            f"{', '.join(empty[:5])}{' ...' if len(empty) > 5 else ''}: every pixel is marked as missing; "
            "others fill the place",
            GeomosaicWarning,
            stacklevel=2,
        )
    return shapes


def _valid(photos: Photos, index: int, grid: Grid) -> tuple[Grid, ByteArray]:
    window = grid.window_of(photos.outlines[index].bounds)
    if window.empty:
        return grid, np.zeros((0, 0), dtype=np.uint8)
    with photos.using(index) as photo:
        piece = thumbnail(photo, photos.block.surface, grid, window, "nearest", photos.info.dtype)
    return grid.crop(window), piece.valid


def _outline(grid: Grid, valid: ByteArray, rectangle: Any) -> Any | None:
    """Polygon of the valid cells; None where those are all, or none."""
    import shapely

    cell = grid.resolution[0] * grid.resolution[1]
    if not valid.any() or valid.sum() * cell >= WHOLE * rectangle.area:
        return None
    parts = [polygon for polygon, _ in traced(np.where(valid > 0, 0, -1), grid)]
    kept = [
        shapely.Polygon(part.exterior, [ring for ring in part.interiors if shapely.Polygon(ring).area > _HOLE * cell])
        for part in parts
    ]
    size = max(grid.resolution)
    whole = shapely.union_all(kept).buffer(-0.75 * size, join_style="mitre").simplify(0.5 * size)
    within = shapely.intersection(whole, rectangle)
    return None if within.is_empty or within.geom_type not in ("Polygon", "MultiPolygon") else within
