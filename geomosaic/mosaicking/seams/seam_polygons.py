"""Seam polygons of a block: drawn cutlines, water and computed seams of images of all ranks; valid outlines."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from functools import partial
from typing import Any

import numpy as np

from geomosaic.errors import warn
from geomosaic.geo.grid import Grid
from geomosaic.mosaicking.colour.balance import ThumbnailOfImage, comparison_grid
from geomosaic.mosaicking.colour.corrections import Correction
from geomosaic.mosaicking.precedence import image_order, image_ranks
from geomosaic.mosaicking.reruns import EarlierResults
from geomosaic.mosaicking.seams.layout import halved_regions, least_cost_regions
from geomosaic.mosaicking.seams.partition import canonical
from geomosaic.mosaicking.seams.voronoi import polygonal, visible_regions, voronoi_regions
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.options.render import RenderOptions
from geomosaic.raster.source import inspect
from geomosaic.raster.validity import polygons_of_labels
from geomosaic.render.photos import Photos
from geomosaic.render.regions import map_images
from geomosaic.types import ByteArray

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
        return earlier.shares(shapes, colours, lambda: _with_water_polygons(photos, shapes, colours, options, earlier))

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
    photos: Photos, shapes: list[Any], colours: Sequence[Correction], options: MosaicOptions, earlier: EarlierResults
) -> list[Any]:
    shares = _automatic(photos, shapes, colours, options, earlier)
    if options.seamlines.water is None:
        return shares
    from geomosaic.mosaicking.seams.cutlines import with_cutlines
    from geomosaic.mosaicking.water_filling import least_glint, read_water

    water = read_water(options.seamlines.water, photos.grid)
    return with_cutlines(shares, least_glint(photos, water, shapes, colours, options.render))


def _automatic(
    photos: Photos, shapes: list[Any], colours: Sequence[Correction], options: MosaicOptions, earlier: EarlierResults
) -> list[Any]:
    """Computed seam polygons: images of a rank divide what those of the ranks before them leave."""
    import shapely

    scenes, outlines = photos.scenes, photos.outlines
    if options.seamlines.seams == "order":
        return visible_regions(shapes, image_order(scenes, outlines, options.merge))
    ranks = image_ranks(scenes, outlines, options.merge)
    if len(set(ranks)) == 1:
        return _divided(photos, shapes, colours, options, earlier)
    shares, covered = [shapely.Polygon()] * len(shapes), shapely.Polygon()
    for rank in sorted(set(ranks)):
        own = [i for i, of in enumerate(ranks) if of == rank and not shapes[i].is_empty]
        left = [shapely.Polygon()] * len(shapes)
        for i in own:
            left[i] = polygonal(shapes[i].difference(covered))
        if len(own) == 1:
            shares[own[0]] = left[own[0]]
        elif any(not left[i].is_empty for i in own):
            divided = _divided(photos, left, colours, options, earlier)
            for i in own:
                shares[i] = divided[i]
        covered = shapely.union_all([covered, *(shapes[i] for i in own)])
    return shares


def _divided(
    photos: Photos, shapes: list[Any], colours: Sequence[Correction], options: MosaicOptions, earlier: EarlierResults
) -> list[Any]:
    """Seam polygons of images of one rank, by the method of `options.seamlines.seams`."""
    if options.seamlines.seams == "graph-cut":
        from geomosaic.mosaicking.seams.seam_layers import read_seam_layers

        layers = read_seam_layers(options.seamlines.follow, options.seamlines.avoid, photos.grid)
        weights, kept = options.seamlines.seam_weights, earlier.subdomains(shapes, colours)
        return least_cost_regions(photos, shapes, colours, options.render, weights, layers, kept)
    if options.seamlines.seams == "halve":
        return halved_regions(photos, shapes, options.render, earlier.subdomains(shapes, colours))
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
        i for i, scene in enumerate(photos.scenes)
        if scene.nodata is not None or scene.clouds is not None or inspect(scene.path, scene.bands).masked
    ]  # fmt: skip
    if not masked or len(photos) == 1:
        return shapes
    grid = comparison_grid(photos, CELLS)
    empty = []
    for i, (found, shown) in map_images(lambda some: partial(_valid_outline, some, grid), photos, options, masked):
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
