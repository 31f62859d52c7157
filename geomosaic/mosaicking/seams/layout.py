"""Seam layout: by distance, halved overlaps or least cost, with roads to follow and areas to avoid."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from geomosaic.geo.grid import Grid
from geomosaic.mosaicking.colour.corrections import Correction
from geomosaic.mosaicking.seams.cost_raster import SeamLayers, seam_cost
from geomosaic.mosaicking.seams.cost_terms import SeamWeights
from geomosaic.mosaicking.seams.graph_cut import divide, graph
from geomosaic.mosaicking.seams.partition import (
    SMALLEST,
    keep_whole,
    partition,
    widened,
    without_islands,
    without_spurs,
)
from geomosaic.mosaicking.seams.voronoi import MOST, inner_edges, nearest, polygonal, regions, shown_deepest
from geomosaic.raster.validity import burn, traced
from geomosaic.render.options import RenderOptions
from geomosaic.render.photos import Photos
from geomosaic.types import IntArray

CELLS = 400
"""Cells across a footprint at which images are compared for their seams."""
SMOOTH = 2.0
"""Cells: about the root of the area of the corners that are cut off seams."""
MOST_CELLS = 16_000_000
"""Cells of a whole mosaic; larger ones get larger cells."""
PART = 256
"""Cells along the sides of the parts in which candidates are found."""


def alike_regions(
    photos: Photos,
    outlines: Sequence[Any],
    colours: Sequence[Correction],
    options: RenderOptions,
    weights: SeamWeights | None = None,
    layers: SeamLayers | None = None,
) -> list[Any]:
    """Each image's share of the ground, divided where seams cost least.

    Parameters
    ----------
    photos : Photos
    outlines : sequence of Polygon
        Footprints in the output map; empty for images that are not to be used.
    colours : sequence of Colour or Curve
        Corrections of the images: they are compared as they will be seen.
    options : RenderOptions
    weights : SeamWeights, optional
    layers : SeamLayers, optional
        What seams follow, and what they keep out of.

    Returns
    -------
    list of Polygon or MultiPolygon
        They share no area, and together they cover the union of the footprints.
    """
    weights, layers, grid = weights or SeamWeights(), layers or SeamLayers(), coarse(photos)
    candidates = _candidates(photos, grid, outlines, weights.reach)
    cost = seam_cost(photos, grid, candidates, colours, weights, layers, options)
    parts = graph(candidates, cost.own, cost.seam)
    chosen = divide(parts, parts.first_choice(candidates[0]))
    known = parts.region >= 0
    label = np.where(known, chosen[np.where(known, parts.region, 0)] if len(chosen) else -1, -1)
    shares = _traced(photos, outlines, label, grid)
    return keep_whole(shares, outlines, layers.avoid)


def halved_regions(photos: Photos, outlines: Sequence[Any]) -> list[Any]:
    """Each image's share where overlaps are halved: a place is that image's whose inner edge is farthest away."""
    grid = coarse(photos)
    label: IntArray = np.full(grid.shape, -1)
    edges = inner_edges(outlines)
    for rows, cols, near, covers, xy in _parts(photos, grid, outlines):
        chosen = shown_deepest([edges[i] for i in near], xy, covers)
        label[rows, cols] = np.where(chosen >= 0, near[chosen], -1).reshape(label[rows, cols].shape)
    return _traced(photos, outlines, label, grid)


def coarse(photos: Photos) -> Grid:
    """Grid of the cells at which seams are laid."""
    areas = [np.prod(np.ptp(outline.ring, axis=0)) for outline in photos.outlines]
    pixel = photos.grid.resolution[0]
    factor = max(1, round(float(np.sqrt(np.median(areas))) / CELLS / pixel))
    while photos.grid.width * photos.grid.height / factor**2 > MOST_CELLS:
        factor += 1
    return photos.grid.coarser(factor)


def _traced(photos: Photos, outlines: Sequence[Any], label: IntArray, grid: Grid) -> list[Any]:
    """From labels of cells to shares that divide the footprints exactly."""
    import shapely

    cell = grid.resolution[0]
    shares = [shapely.Polygon() for _ in outlines]
    found = traced(widened(without_islands(without_spurs(label)), 2), grid)
    # Borders of cells are stairs: simplified all together, neighbours keep a common border.
    smooth = shapely.coverage_simplify(np.array([part for part, _ in found], dtype=object), SMOOTH * cell)
    of_image: dict[int, list[Any]] = {}
    for polygon, (_, number) in zip(smooth, found, strict=True):
        of_image.setdefault(number, []).append(polygon)
    for number, own in of_image.items():
        shares[number] = polygonal(shapely.union_all(own))
    rest = regions(list(outlines), photos.centres)
    return partition(shares, outlines, rest, cell, SMALLEST * cell**2)


def _candidates(photos: Photos, grid: Grid, outlines: Sequence[Any], reach: float) -> IntArray:
    """Images (ranks, rows, cols) that may show each cell, the nearest first."""
    found: IntArray = np.full((MOST, *grid.shape), -1, dtype=np.int32)
    centres = np.array(photos.centres)
    for rows, cols, near, covers, xy in _parts(photos, grid, outlines):
        ranked = nearest(centres[near], xy, covers, reach)
        found[:, rows, cols] = np.where(ranked >= 0, near[ranked], -1).reshape(found[:, rows, cols].shape)
    return found


def _parts(photos: Photos, grid: Grid, outlines: Sequence[Any]) -> Any:
    """Parts of a grid: rows, columns, images at hand, which of them show which cells, and where the cells lie."""
    windows = [grid.window_of(outline.bounds) for outline in photos.outlines]
    for part in grid.window.split(PART, PART):
        own = grid.crop(part)
        near = [
            i for i, window in enumerate(windows) if not outlines[i].is_empty and not window.intersection(part).empty
        ]
        if not near:
            continue
        covers = np.stack([burn([(outlines[i], 1)], own).ravel() == 1 for i in near])
        c, r = np.meshgrid(np.arange(part.width) + 0.5, np.arange(part.height) + 0.5)
        xy = own.xy(np.column_stack([c.ravel(), r.ravel()]))
        yield slice(part.row, part.stop_row), slice(part.col, part.stop_col), np.array(near), covers, xy
