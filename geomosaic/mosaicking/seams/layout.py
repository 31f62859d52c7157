"""Seam layout of a block: halved overlaps, or seams of least cost along roads and around areas to avoid."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from geomosaic.geo.grid import Grid
from geomosaic.mosaicking.colour.corrections import Correction
from geomosaic.mosaicking.seams.cost_raster import SeamLayers, seam_cost
from geomosaic.mosaicking.seams.graph_cut import minimise, region_graph
from geomosaic.mosaicking.seams.partition import (
    MIN_ISLAND,
    extrapolated,
    partition,
    undivided,
    without_islands,
    without_spurs,
)
from geomosaic.mosaicking.seams.voronoi import (
    MAX_CANDIDATES,
    farthest_inside,
    inner_edges,
    nearest_images,
    polygonal,
    voronoi_regions,
)
from geomosaic.options.mosaic import SeamWeights
from geomosaic.options.render import RenderOptions
from geomosaic.raster.validity import burn, traced
from geomosaic.render.photos import Photos
from geomosaic.types import IntArray

CELLS = 400
"""Cells across a median footprint: fine enough for seams around houses, coarse enough for blocks of thousands."""
SMOOTHING = 2.0
"""Simplification of seams, in cells: about the root of the area of the corners that are cut off."""
MAX_CELLS = 16_000_000
"""Cells of a whole mosaic; larger mosaics get larger cells, so that memory stays bounded."""
TILE = 256
"""Side in cells of the tiles in which candidates are found."""


def least_cost_regions(
    photos: Photos,
    outlines: Sequence[Any],
    colours: Sequence[Correction],
    options: RenderOptions,
    weights: SeamWeights | None = None,
    layers: SeamLayers | None = None,
) -> list[Any]:
    """Seam polygons of least cost, by graph cuts over image differences, raised objects and the user's lines and areas.

    Parameters
    ----------
    photos : Photos
    outlines : sequence of Polygon
        Footprints in the output map; empty for images that are not to be used.
    colours : sequence of Correction
        Corrections of the images: they are compared as they will be seen.
    options : RenderOptions
    weights : SeamWeights, optional
    layers : SeamLayers, optional
        Lines to follow and areas to avoid.

    Returns
    -------
    list of Polygon or MultiPolygon
        They share no area, and together they cover the union of the footprints.
    """
    weights, layers, grid = weights or SeamWeights(), layers or SeamLayers(), seam_grid(photos)
    candidates = _candidates(photos, grid, outlines, weights.reach)
    cost = seam_cost(photos, grid, candidates, colours, weights, layers, options)
    regions = region_graph(candidates, cost.unary, cost.pairwise)
    best = minimise(regions, regions.initial_labels(candidates[0]))
    known = regions.region >= 0
    label = np.where(known, best[np.where(known, regions.region, 0)] if len(best) else -1, -1)
    shares = _vectorised(photos, outlines, label, grid)
    return undivided(shares, outlines, layers.avoid)


def halved_regions(photos: Photos, outlines: Sequence[Any]) -> list[Any]:
    """Seam polygons that halve overlaps: a place belongs to the image whose inner edge is farthest away.

    Parameters
    ----------
    photos : Photos
    outlines : sequence of Polygon
        Footprints in the output map.

    Returns
    -------
    list of Polygon or MultiPolygon
        As from `least_cost_regions`.
    """
    grid = seam_grid(photos)
    label: IntArray = np.full(grid.shape, -1)
    edges = inner_edges(outlines)
    for rows, cols, near, covers, xy in _tiles(photos, grid, outlines):
        deepest = farthest_inside([edges[i] for i in near], xy, covers)
        label[rows, cols] = np.where(deepest >= 0, near[deepest], -1).reshape(label[rows, cols].shape)
    return _vectorised(photos, outlines, label, grid)


def seam_grid(photos: Photos) -> Grid:
    """Coarse grid on which seams are laid: about `CELLS` across a footprint, at most `MAX_CELLS` in all.

    Parameters
    ----------
    photos : Photos

    Returns
    -------
    Grid
        The output grid coarsened by a whole factor.
    """
    areas = [np.prod(np.ptp(outline.ring, axis=0)) for outline in photos.outlines]
    pixel = photos.grid.resolution[0]
    factor = max(1, round(float(np.sqrt(np.median(areas))) / CELLS / pixel))
    while photos.grid.width * photos.grid.height / factor**2 > MAX_CELLS:
        factor += 1
    return photos.grid.coarser(factor)


def _vectorised(photos: Photos, outlines: Sequence[Any], label: IntArray, grid: Grid) -> list[Any]:
    """Polygons of labelled cells, made to divide the footprints exactly."""
    import shapely

    cell = grid.resolution[0]
    shares = [shapely.Polygon() for _ in outlines]
    found = traced(extrapolated(without_islands(without_spurs(label)), 2), grid)
    # The staircase of cells is simplified as a coverage: neighbours keep a common border, without gaps or overlaps.
    smooth = shapely.coverage_simplify(np.array([part for part, _ in found], dtype=object), SMOOTHING * cell)
    of_image: dict[int, list[Any]] = {}
    for polygon, (_, number) in zip(smooth, found, strict=True):
        of_image.setdefault(number, []).append(polygon)
    for number, own in of_image.items():
        shares[number] = polygonal(shapely.union_all(own))
    # Ground that no cell covers: cells are coarse, and footprints are not made of them.
    rest = voronoi_regions(list(outlines), photos.centres)
    return partition(shares, outlines, rest, cell, MIN_ISLAND * cell**2)


def _candidates(photos: Photos, grid: Grid, outlines: Sequence[Any], reach: float) -> IntArray:
    """Candidate images (ranks, rows, cols) of each cell, the nearest first."""
    found: IntArray = np.full((MAX_CANDIDATES, *grid.shape), -1, dtype=np.int32)
    centres = np.array(photos.centres)
    for rows, cols, near, covers, xy in _tiles(photos, grid, outlines):
        ranked = nearest_images(centres[near], xy, covers, reach)
        found[:, rows, cols] = np.where(ranked >= 0, near[ranked], -1).reshape(found[:, rows, cols].shape)
    return found


def _tiles(photos: Photos, grid: Grid, outlines: Sequence[Any]) -> Any:
    """Tiles of a grid: rows, columns, images at hand (K,), cells each shows (K, N), cell centres (N, 2) in the map."""
    windows = [grid.window_of(outline.bounds) for outline in photos.outlines]
    for part in grid.window.split(TILE, TILE):
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
