"""Water shown by the image with the least glint: one image for a whole lake, where one shows it whole."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.geo.grid import Grid
from geomosaic.product.areas import read_areas
from geomosaic.product.colour.balance import comparison_grid, thumbnail
from geomosaic.product.colour.corrections import Correction, corrected
from geomosaic.product.photos import Photos
from geomosaic.raster.burn import burn
from geomosaic.seam.voronoi import polygonal

LAYER = "water"
CELLS = 256
"""Cells across a footprint at which glint is looked for."""
GLINT = 90.0
"""Percentile of brightness over a piece of water by which images are compared: glint is bright, and not everywhere."""


def read_water(path: Path, grid: Grid) -> list[Any]:
    """Pieces of water in the map of a grid, each a polygon; those that touch are one piece.

    Parameters
    ----------
    path : Path
        Vector file with a layer `water`, or with one layer.
    grid : Grid
        Of the output.

    Raises
    ------
    InputError
        No such layer, no CRS, a geometry that is no area, an area that crosses itself.
    """
    import shapely

    joined = shapely.union_all(np.array(read_areas(path, grid, LAYER), dtype=object))
    return [part for part in getattr(joined, "geoms", [joined]) if part.area > 0]


def calmest(
    photos: Photos, water: Sequence[Any], outlines: Sequence[Any], colours: Sequence[Correction]
) -> dict[int, Any]:
    """Shares of the images in water: of each piece, what the least glinting image shows, then the next.

    An image's glint is the 90th percentile of its corrected brightness (mean over bands) in the piece. An image that
    shows less than half of what another shows of a piece comes after all those that show more.

    Parameters
    ----------
    photos : Photos
    water : sequence of Polygon
        In the output map.
    outlines : sequence of Polygon or MultiPolygon
        What each image shows.
    colours : sequence of Correction

    Returns
    -------
    dict of int to Polygon or MultiPolygon
        By number of the image.
    """
    import shapely

    grid = comparison_grid(photos, CELLS)
    tree = shapely.STRtree(list(outlines))
    seen: dict[int, tuple[Grid, Any, Any]] = {}
    shares: dict[int, list[Any]] = {}
    for piece in water:
        ranked = []
        for i in sorted(int(k) for k in tree.query(piece, predicate="intersects")):
            if i not in seen:
                seen[i] = _brightness(photos, i, grid, colours[i])
            part, bright, valid = seen[i]
            here = (burn([(piece, 1)], part) == 1) & valid if bright.size else np.zeros((0, 0), dtype=bool)
            shown = shapely.intersection(piece, outlines[i]).area
            glint = float(np.percentile(bright[here], GLINT)) if here.any() else np.inf
            ranked.append((shown, glint, i))
        most = max((shown for shown, _, _ in ranked), default=0.0)
        ranked.sort(key=lambda entry: (entry[0] < most / 2, entry[1], entry[2]))
        left = piece
        for _, _, i in ranked:
            own = polygonal(shapely.intersection(left, outlines[i]))
            if not own.is_empty:
                shares.setdefault(i, []).append(own)
                left = polygonal(shapely.difference(left, outlines[i]))
    return {i: shapely.union_all(np.array(parts, dtype=object)) for i, parts in shares.items()}


def _brightness(photos: Photos, index: int, grid: Grid, colour: Correction) -> tuple[Grid, Any, Any]:
    """Mean over bands of what an image shows, corrected, on its part of a coarse grid."""
    window = grid.window_of(photos.outlines[index].bounds)
    if window.empty:
        return grid, np.zeros((0, 0)), np.zeros((0, 0), dtype=bool)
    with photos.using(index) as photo:
        piece = thumbnail(photo, photos.block.surface, grid, window, "average", "float32")
    values = corrected(colour, piece.values, window, grid, photos.grid)
    return grid.crop(window), values.mean(axis=2), piece.valid > 0
