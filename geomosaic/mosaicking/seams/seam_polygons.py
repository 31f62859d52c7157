"""Seam polygons, computed or drawn: the share of the ground that each image shows; outlines of valid pixels."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from geomosaic.errors import GeomosaicWarning
from geomosaic.geo.grid import Grid
from geomosaic.mosaicking.colour.balance import comparison_grid, thumbnail
from geomosaic.mosaicking.colour.corrections import Correction
from geomosaic.mosaicking.reruns.earlier_results import EarlierResults
from geomosaic.mosaicking.seams.image_order import image_index, image_order, visible_regions, with_base_image
from geomosaic.mosaicking.seams.partition import canonical
from geomosaic.mosaicking.seams.voronoi import voronoi_regions
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.options.render import RenderOptions
from geomosaic.raster.source import inspect
from geomosaic.raster.validity import traced
from geomosaic.render.photos import Photos
from geomosaic.render.workers import in_order
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
    from geomosaic.mosaicking.water.filling import least_glint, read_water

    return with_cutlines(shares, least_glint(photos, read_water(options.seamlines.water, photos.grid), shapes, colours))


def _automatic(photos: Photos, shapes: list[Any], colours: Sequence[Correction], options: MosaicOptions) -> list[Any]:
    """Computed seam polygons, by the method of `options.seamlines.seams`."""
    if options.seamlines.seams == "alike":
        from geomosaic.mosaicking.seams.cost_raster import read_seam_layers
        from geomosaic.mosaicking.seams.layout import least_cost_regions

        layers = read_seam_layers(options.seamlines.follow, options.seamlines.avoid, photos.grid)
        return least_cost_regions(photos, shapes, colours, options.render, options.seamlines.seam_weights, layers)
    if options.seamlines.seams == "halve":
        from geomosaic.mosaicking.seams.layout import halved_regions

        return halved_regions(photos, shapes)
    if options.seamlines.seams == "order":
        return visible_regions(
            shapes, image_order(photos.block.scenes, photos.outlines, options.merge.order, options.merge.base)
        )
    centres = photos.centres
    if options.merge.base is None:
        return voronoi_regions(shapes, centres)
    base = image_index(options.merge.base, photos.block.scenes)
    return with_base_image(
        voronoi_regions(shapes[:base] + shapes[base + 1 :], centres[:base] + centres[base + 1 :]), shapes, base
    )


CELLS = 256
"""Cells across a footprint on which its valid pixels are outlined."""
COMPLETE = 0.995
"""Valid part of its rectangle from which on an image counts as complete."""
# Cells of the smallest hole that is kept: every hole becomes a seam.
_MIN_HOLE = 64


def valid_outlines(photos: Photos, options: RenderOptions) -> list[Any]:
    """Outlines of the valid pixels of all images, in the output map.

    The outline is the image's rectangle, unless the file marks missing pixels and more than a few are missing. Then it
    is that of the valid cells of a coarse grid, shrunk by three quarters of a cell: the image surely shows all of it.

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
    shapes: list[Any] = [outline.polygon for outline in photos.outlines]
    masked = [
        i for i, scene in enumerate(photos.block.scenes)
        if scene.nodata is not None or inspect(scene.path, scene.bands).masked
    ]  # fmt: skip
    if not masked or len(photos) == 1:
        return shapes
    grid = comparison_grid(photos, CELLS)
    empty = []
    for i, (part, valid) in in_order(lambda i: _valid_cells(photos, i, grid), masked, options.threads, ahead=1):
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


def _valid_cells(photos: Photos, index: int, grid: Grid) -> tuple[Grid, ByteArray]:
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
    if not valid.any() or valid.sum() * cell >= COMPLETE * rectangle.area:
        return None
    parts = [polygon for polygon, _ in traced(np.where(valid > 0, 0, -1), grid)]
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
