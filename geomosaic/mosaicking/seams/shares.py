"""Shares of images: laid by the program or drawn by a person, within what each image shows."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from geomosaic.errors import GeomosaicWarning
from geomosaic.geo.grid import Grid
from geomosaic.mosaicking.colour.balance import comparison_grid, thumbnail
from geomosaic.mosaicking.colour.corrections import Correction
from geomosaic.mosaicking.options import MosaicOptions
from geomosaic.mosaicking.reruns.earlier_results import Earlier
from geomosaic.mosaicking.seams.image_order import by_rank, index_of, ordered, under
from geomosaic.mosaicking.seams.partition import canonical
from geomosaic.mosaicking.seams.voronoi import regions
from geomosaic.raster.source import inspect
from geomosaic.raster.validity import traced
from geomosaic.render.options import RenderOptions
from geomosaic.render.photos import Photos
from geomosaic.render.workers import in_order
from geomosaic.types import ByteArray

_STEP = 1e-6
"""Pixels."""


def shares_of(
    photos: Photos, shapes: list[Any], colours: Sequence[Correction], options: MosaicOptions, earlier: Earlier
) -> list[Any]:
    """Shares of all images, in the output map."""
    step = _STEP * photos.grid.resolution[0]
    return [canonical(share, step) for share in _shares(photos, shapes, colours, options, earlier)]


def _shares(
    photos: Photos, shapes: list[Any], colours: Sequence[Correction], options: MosaicOptions, earlier: Earlier
) -> list[Any]:
    def laid() -> list[Any]:
        return earlier.shares(shapes, colours, lambda: _with_water(photos, shapes, colours, options))

    if options.cutlines is None:
        return laid()
    from geomosaic.mosaicking.seams.cutlines import covers, note_gap, read_cutlines, with_cutlines

    names = [outline.name for outline in photos.outlines]
    drawn = read_cutlines(options.cutlines, names, shapes, photos.grid.crs)
    if covers(drawn, shapes):  # an edited layer has all shares: no others need to be laid
        return with_cutlines(regions(shapes, photos.centres), drawn)
    if len(drawn) == sum(not shape.is_empty for shape in shapes):
        note_gap(options.cutlines, drawn, shapes)
    return with_cutlines(laid(), drawn)


def _with_water(photos: Photos, shapes: list[Any], colours: Sequence[Correction], options: MosaicOptions) -> list[Any]:
    shares = _laid(photos, shapes, colours, options)
    if options.water is None:
        return shares
    from geomosaic.mosaicking.seams.cutlines import with_cutlines
    from geomosaic.mosaicking.water.filling import calmest, read_water

    return with_cutlines(shares, calmest(photos, read_water(options.water, photos.grid), shapes, colours))


def _laid(photos: Photos, shapes: list[Any], colours: Sequence[Correction], options: MosaicOptions) -> list[Any]:
    """Shares as the program lays them."""
    if options.seams == "alike":
        from geomosaic.mosaicking.seams.cost_raster import read_seam_layers
        from geomosaic.mosaicking.seams.layout import alike_regions

        layers = read_seam_layers(options.follow, options.avoid, photos.grid)
        return alike_regions(photos, shapes, colours, options.render, options.seam_weights, layers)
    if options.seams == "halve":
        from geomosaic.mosaicking.seams.layout import halved_regions

        return halved_regions(photos, shapes)
    if options.seams == "order":
        return by_rank(shapes, ordered(photos.block.scenes, photos.outlines, options.order, options.base))
    centres = photos.centres
    if options.base is None:
        return regions(shapes, centres)
    base = index_of(options.base, photos.block.scenes)
    return under(regions(shapes[:base] + shapes[base + 1 :], centres[:base] + centres[base + 1 :]), shapes, base)


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
