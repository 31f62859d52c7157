"""Seam polygons of a block: halved overlaps, seams of least cost or drawn ones; the ground each image gets."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import partial
from typing import Any

import numpy as np

from geomosaic.errors import warn
from geomosaic.execution.units import map_units
from geomosaic.geo.grid import Grid
from geomosaic.geo.window_index import WindowIndex
from geomosaic.mosaicking.colour.balance import ThumbnailOfImage, comparison_grid
from geomosaic.mosaicking.colour.corrections import Correction
from geomosaic.mosaicking.precedence import image_order, image_ranks
from geomosaic.mosaicking.reruns import EarlierResults
from geomosaic.mosaicking.seams.cost import SeamLayers, seam_cost
from geomosaic.mosaicking.seams.graph_cut import minimise, region_graph
from geomosaic.mosaicking.seams.partition import (
    MIN_ISLAND,
    canonical,
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
    visible_regions,
    voronoi_regions,
)
from geomosaic.options.mosaic import MosaicOptions, SeamWeights
from geomosaic.options.render import RenderOptions
from geomosaic.raster.source import inspect
from geomosaic.raster.validity import polygons_of_labels, rasterized
from geomosaic.render.photos import Photos
from geomosaic.types import ByteArray, IntArray

# Cells across a median footprint: fine enough for seams around houses, coarse enough for blocks of thousands.
LAYOUT_CELLS = 400
# Simplification of seams, in cells: about the root of the area of the corners that are cut off.
SMOOTHING = 2.0
# Cells of a whole mosaic; larger mosaics get larger cells, so that memory stays bounded.
MAX_CELLS = 16_000_000
# Side in cells of the tiles in which candidates are found.
TILE = 256


def _least_cost_regions(
    photos: Photos,
    outlines: Sequence[Any],
    colours: Sequence[Correction],
    options: RenderOptions,
    weights: SeamWeights | None = None,
    layers: SeamLayers | None = None,
) -> list[Any]:
    """Seam polygons of least cost, by graph cuts over image differences, raised objects and given lines and areas."""
    weights, layers, grid = weights or SeamWeights(), layers or SeamLayers(), _seam_grid(photos)
    candidates = _candidates(photos, grid, outlines, weights.reach)
    cost = seam_cost(photos, grid, candidates, colours, weights, layers, options)
    regions = region_graph(candidates, cost.unary, cost.pairwise)
    best = minimise(regions, regions.initial_labels(candidates[0]))
    known = regions.region >= 0
    label = np.where(known, best[np.where(known, regions.region, 0)] if len(best) else -1, -1)
    shares = _vectorised(photos, outlines, label, grid)
    return undivided(shares, outlines, layers.avoid)


def _halved_regions(photos: Photos, outlines: Sequence[Any]) -> list[Any]:
    """Seam polygons that halve overlaps: a place belongs to the image whose inner edge is farthest away."""
    grid = _seam_grid(photos)
    label: IntArray = np.full(grid.shape, -1)
    edges = inner_edges(outlines)
    for rows, cols, near, covers, xy in _tiles(photos, grid, outlines):
        deepest = farthest_inside([edges[i] for i in near], xy, covers)
        label[rows, cols] = np.where(deepest >= 0, near[deepest], -1).reshape(label[rows, cols].shape)
    return _vectorised(photos, outlines, label, grid)


def _seam_grid(photos: Photos) -> Grid:
    """Coarse grid on which seams are laid: about `LAYOUT_CELLS` across a footprint, at most `MAX_CELLS` in all."""
    areas = [np.prod(np.ptp(outline.ring, axis=0)) for outline in photos.outlines]
    pixel = photos.grid.resolution[0]
    factor = max(1, round(float(np.sqrt(np.median(areas))) / LAYOUT_CELLS / pixel))
    while photos.grid.width * photos.grid.height / factor**2 > MAX_CELLS:
        factor += 1
    return photos.grid.coarser(factor)


def _vectorised(photos: Photos, outlines: Sequence[Any], label: IntArray, grid: Grid) -> list[Any]:
    """Polygons of labelled cells, made to divide the footprints exactly."""
    import shapely

    cell = grid.resolution[0]
    shares = [shapely.Polygon() for _ in outlines]
    found = polygons_of_labels(extrapolated(without_islands(without_spurs(label)), 2), grid)
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
    windows = WindowIndex([grid.window_of(outline.bounds) for outline in photos.outlines])
    for part in grid.window.split(TILE, TILE):
        own = grid.crop(part)
        near = [i for i in windows.meeting(part) if not outlines[i].is_empty]
        if not near:
            continue
        covers = np.stack([rasterized([(outlines[i], 1)], own).ravel() == 1 for i in near])
        c, r = np.meshgrid(np.arange(part.width) + 0.5, np.arange(part.height) + 0.5)
        xy = own.xy(np.column_stack([c.ravel(), r.ravel()]))
        yield slice(part.row, part.stop_row), slice(part.col, part.stop_col), np.array(near), covers, xy


# Of a pixel: far below what pixels can show, far above the last digits that a GIS changes on saving.
_STEP = 1e-6


def seam_polygons(
    photos: Photos, shapes: list[Any], colours: Sequence[Correction], options: MosaicOptions, earlier: EarlierResults
) -> list[Any]:
    """Seam polygons of all images in the output map: drawn cutlines first, then water, then computed seams.

    Parameters
    ----------
    photos : Photos
    shapes : list of Polygon or MultiPolygon
        Valid outlines of the images; empty for images that are left out.
    colours : sequence of Correction
    options : MosaicOptions
    earlier : EarlierResults
        Results of an earlier run.

    Returns
    -------
    list of Polygon or MultiPolygon
        They share no area; each within its outline.
    """
    step = _STEP * photos.grid.resolution[0]
    return [canonical(share, step) for share in _shares(photos, shapes, colours, options, earlier)]


def _shares(
    photos: Photos, shapes: list[Any], colours: Sequence[Correction], options: MosaicOptions, earlier: EarlierResults
) -> list[Any]:
    def computed() -> list[Any]:
        return earlier.shares(shapes, colours, lambda: _with_water_polygons(photos, shapes, colours, options))

    if options.seamlines.cutlines is None:
        return computed()
    from geomosaic.mosaicking.seams.cutlines import cover_everything, read_cutlines, warn_of_gaps, with_cutlines

    names = [outline.name for outline in photos.outlines]
    drawn = read_cutlines(options.seamlines.cutlines, names, shapes, photos.grid.crs)
    if cover_everything(drawn, shapes):  # an edited layer of all shares: computing others would be for nothing
        return with_cutlines(voronoi_regions(shapes, photos.centres), drawn)
    if len(drawn) == sum(not shape.is_empty for shape in shapes):
        warn_of_gaps(options.seamlines.cutlines, drawn, shapes)
    return with_cutlines(computed(), drawn)


def _with_water_polygons(
    photos: Photos, shapes: list[Any], colours: Sequence[Correction], options: MosaicOptions
) -> list[Any]:
    shares = _automatic(photos, shapes, colours, options)
    if options.seamlines.water is None:
        return shares
    from geomosaic.mosaicking.seams.cutlines import with_cutlines
    from geomosaic.mosaicking.water_filling import least_glint, read_water

    water = read_water(options.seamlines.water, photos.grid)
    return with_cutlines(shares, least_glint(photos, water, shapes, colours, options.render))


def _automatic(photos: Photos, shapes: list[Any], colours: Sequence[Correction], options: MosaicOptions) -> list[Any]:
    """Computed seam polygons: images of a rank divide what those of the ranks before them leave."""
    import shapely

    scenes, outlines = photos.block.scenes, photos.outlines
    if options.seamlines.seams == "order":
        return visible_regions(shapes, image_order(scenes, outlines, options.merge))
    ranks = image_ranks(scenes, outlines, options.merge)
    if len(set(ranks)) == 1:
        return _divided(photos, shapes, colours, options)
    shares, covered = [shapely.Polygon()] * len(shapes), shapely.Polygon()
    for rank in sorted(set(ranks)):
        own = [i for i, of in enumerate(ranks) if of == rank and not shapes[i].is_empty]
        left = [shapely.Polygon()] * len(shapes)
        for i in own:
            left[i] = polygonal(shapes[i].difference(covered))
        if len(own) == 1:
            shares[own[0]] = left[own[0]]
        elif any(not left[i].is_empty for i in own):
            divided = _divided(photos, left, colours, options)
            for i in own:
                shares[i] = divided[i]
        covered = shapely.union_all([covered, *(shapes[i] for i in own)])
    return shares


def _divided(photos: Photos, shapes: list[Any], colours: Sequence[Correction], options: MosaicOptions) -> list[Any]:
    """Seam polygons of images of one rank, by the method of `options.seamlines.seams`."""
    if options.seamlines.seams == "graph-cut":
        from geomosaic.mosaicking.seams.cost import read_seam_layers

        layers = read_seam_layers(options.seamlines.follow, options.seamlines.avoid, photos.grid)
        return _least_cost_regions(photos, shapes, colours, options.render, options.seamlines.seam_weights, layers)
    if options.seamlines.seams == "halve":
        return _halved_regions(photos, shapes)
    return voronoi_regions(shapes, photos.centres)


def without_covered(photos: Photos, shapes: Sequence[Any], filling: Collection[int]) -> list[Any]:
    """Outlines of which those of some images keep only what lies outside of all others, so that nothing is blended in.

    Within the others' footprints such images fill gaps, pixel by pixel.

    Parameters
    ----------
    photos : Photos
    shapes : sequence of Polygon or MultiPolygon
        Valid outlines; empty for images that are left out.
    filling : collection of int
        Numbers of those images.

    Returns
    -------
    list of Polygon or MultiPolygon
    """
    import shapely

    if not filling:
        return list(shapes)
    others = [i for i, shape in enumerate(shapes) if i not in filling and not shape.is_empty]
    covered = shapely.union_all([photos.outlines[i].polygon for i in others])
    return [polygonal(shape.difference(covered)) if i in filling else shape for i, shape in enumerate(shapes)]


# Cells across a footprint on which its valid pixels are outlined.
CELLS = 256
# Valid part of its rectangle from which on an image counts as complete.
COMPLETE = 0.995
# Cells of the smallest hole that is kept: every hole becomes a seam.
_MIN_HOLE = 64


def valid_outlines(photos: Photos, options: RenderOptions) -> list[Any]:
    """Outlines of the valid pixels of all images, in the output map.

    Parameters
    ----------
    photos : Photos
    options : RenderOptions
        Threads.

    Returns
    -------
    list of Polygon or MultiPolygon

    Warns
    -----
    GeomosaicWarning
        Every pixel of an image is missing.
    """
    # The outline is the image's rectangle, unless the file marks missing pixels and more than a few are missing. Then
    # it is that of the valid cells of a coarse grid, shrunk by three quarters of a cell: the image surely shows all of
    # it.
    shapes: list[Any] = [outline.polygon for outline in photos.outlines]
    masked = [
        i for i, scene in enumerate(photos.block.scenes)
        if scene.nodata is not None or scene.clouds is not None or inspect(scene.path, scene.bands).masked
    ]  # fmt: skip
    if not masked or len(photos) == 1:
        return shapes
    grid = comparison_grid(photos, CELLS)
    empty = []
    for i, (found, shown) in map_units(partial(_valid_outline, photos, grid), masked, options, ahead=1):
        if found is not None:
            shapes[i] = found
        elif not shown:
            empty.append(photos.outlines[i].name)
    if empty:
        warn(
            f"{', '.join(empty[:5])}{' ...' if len(empty) > 5 else ''}: every pixel is marked as missing; "
            "others fill the place"
        )
    return shapes


def _valid_outline(photos: Photos, grid: Grid, index: int) -> tuple[Any | None, bool]:
    """Outline of the valid pixels of an image, None where those are all or none, and whether there are any."""
    piece = ThumbnailOfImage(photos, grid, "nearest", photos.info.dtype)(index)
    if piece.window.empty:
        return None, True
    return _outline(grid.crop(piece.window), piece.valid, photos.outlines[index].polygon), bool(piece.valid.any())


def _outline(grid: Grid, valid: ByteArray, rectangle: Any) -> Any | None:
    """Polygon of the valid cells; None where those are all, or none."""
    import shapely

    cell = grid.resolution[0] * grid.resolution[1]
    if not valid.any() or valid.sum() * cell >= COMPLETE * rectangle.area:
        return None
    parts = [polygon for polygon, _ in polygons_of_labels(np.where(valid > 0, 0, -1), grid)]
    kept = [
        shapely.Polygon(
            part.exterior, [ring for ring in part.interiors if shapely.Polygon(ring).area > _MIN_HOLE * cell]
        )
        for part in parts
    ]
    size = max(grid.resolution)
    whole = shapely.union_all(kept).buffer(-0.75 * size, join_style="mitre").simplify(0.5 * size)
    within = shapely.intersection(whole, rectangle)
    return None if within.is_empty or within.geom_type not in ("Polygon", "MultiPolygon") else within
