"""Seams of a mosaic: halfway between centres, or where two images look most alike."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from geomosaic.geo.grid import Grid, Window
from geomosaic.product.balance import thumbnail
from geomosaic.product.options import RenderOptions
from geomosaic.product.photos import Photos
from geomosaic.product.pool import in_order
from geomosaic.radiometry.curve import Curve
from geomosaic.radiometry.shade import Shade
from geomosaic.raster.burn import burn, traced
from geomosaic.resample.warp import Colour
from geomosaic.seam.voronoi import polygonal
from geomosaic.seam.watershed import flood, nearest_two, unlike, widened, without_islands
from geomosaic.types import AnyArray, BoolArray, FloatArray, IntArray

CELLS = 400
"""Cells across a footprint at which images are compared for their seams."""
SMOOTH = 3.0
"""Cells: about the root of the area of the corners that are cut off seams."""
MOST_CELLS = 40_000_000
"""Cells of a whole mosaic; larger ones get larger cells."""


def alike_regions(
    photos: Photos, outlines: Sequence[Any], colours: Sequence[Colour | Curve | Shade], options: RenderOptions
) -> list[Any]:
    """Each image's share of the ground, divided where neighbours look alike.

    Parameters
    ----------
    photos : Photos
    outlines : sequence of Polygon
        Footprints in the output map.
    colours : sequence of Colour or Curve
        Corrections of the images: they are compared as they will be seen.
    options : RenderOptions

    Returns
    -------
    list of Polygon or MultiPolygon
        They share no area. Along their common borders they have the same vertices.
    """
    import shapely

    grid = _coarse(photos)
    first, second, marker = _candidates(photos, grid, outlines)
    cost = _cost(photos, grid, first, second, marker, colours, options)
    label = widened(without_islands(flood(first, second, marker, cost)), 2)
    shares = [shapely.Polygon() for _ in outlines]
    found = traced(label, grid)
    parts = [polygon for polygon, _ in found]
    # Borders of cells are stairs: simplified all together, neighbours keep a common border.
    smooth = shapely.coverage_simplify(np.array(parts, dtype=object), SMOOTH * grid.resolution[0]) if parts else []
    everything = shapely.union_all(list(outlines))
    of_image: dict[int, list[Any]] = {}
    for polygon, (_, number) in zip(smooth, found, strict=True):
        of_image.setdefault(number, []).append(polygon)
    for number, own in of_image.items():
        shares[number] = polygonal(shapely.union_all(own).intersection(everything))
    return shares


def _coarse(photos: Photos) -> Grid:
    areas = [np.prod(np.ptp(outline.ring, axis=0)) for outline in photos.outlines]
    pixel = photos.grid.resolution[0]
    factor = max(1, round(float(np.sqrt(np.median(areas))) / CELLS / pixel))
    while photos.grid.width * photos.grid.height / factor**2 > MOST_CELLS:
        factor += 1
    return photos.grid.coarser(factor)


def _candidates(photos: Photos, grid: Grid, outlines: Sequence[Any]) -> tuple[IntArray, IntArray, BoolArray]:
    """First and second image of each cell, and the cells that are surely the first's; part by part."""
    first: IntArray = np.full(grid.shape, -1)
    second: IntArray = np.full(grid.shape, -1)
    marker: BoolArray = np.zeros(grid.shape, dtype=np.bool_)
    windows = [grid.window_of(outline.bounds) for outline in photos.outlines]
    centres = np.array([outline.centre for outline in photos.outlines])
    for part in grid.window.split(256, 256):
        near = np.array([i for i, window in enumerate(windows) if not window.intersection(part).empty], dtype=np.int64)
        if not len(near):
            continue
        own = grid.crop(part)
        covers = np.stack([burn([(outlines[i], 1)], own).ravel() == 1 for i in near])
        c, r = np.meshgrid(np.arange(part.width) + 0.5, np.arange(part.height) + 0.5)
        one, two, sure = nearest_two(centres[near], own.xy(np.column_stack([c.ravel(), r.ravel()])), covers)
        here = slice(part.row, part.stop_row), slice(part.col, part.stop_col)
        for target, chosen in ((first, one), (second, two)):
            target[here] = np.where(chosen >= 0, near[chosen], -1).reshape(own.shape)
        marker[here] = sure.reshape(own.shape)
    return first, second, marker


def _cost(
    photos: Photos,
    grid: Grid,
    first: IntArray,
    second: IntArray,
    marker: BoolArray,
    colours: Sequence[Colour | Curve | Shade],
    options: RenderOptions,
) -> FloatArray:
    """How different the first and the second image of each cell are."""
    bands = photos.info.bands
    values = [np.zeros((*grid.shape, bands), dtype=np.float32) for _ in range(2)]
    known = [np.zeros(grid.shape, dtype=bool) for _ in range(2)]
    windows = [grid.window_of(outline.bounds) for outline in photos.outlines]
    rendered = in_order(
        lambda i: _view(photos, i, grid, windows[i], colours[i]), range(len(photos)), options.threads, ahead=1
    )
    for done, (i, (seen, valid)) in enumerate(rendered):
        window = windows[i]
        here = slice(window.row, window.stop_row), slice(window.col, window.stop_col)
        for chosen, into, mask in ((first, values[0], known[0]), (second, values[1], known[1])):
            own = (chosen[here] == i) & valid & ~marker[here]
            into[here][own] = seen[own]
            mask[here][own] = True
        options.report(done + 1, len(photos), "seams")
    return unlike(values[0], values[1], known[0] & known[1])


def _view(
    photos: Photos, index: int, grid: Grid, window: Window, colour: Colour | Curve | Shade
) -> tuple[AnyArray, BoolArray]:
    with photos.using(index) as photo:
        piece = thumbnail(photo, photos.block.surface, grid, window, "average", "float32")
    if isinstance(colour, Curve):
        return colour(piece.values), piece.valid > 0
    if isinstance(colour, Shade):
        factor = grid.resolution[0] / photos.grid.resolution[0]
        cols = factor * np.arange(window.col + 0.5, window.stop_col, dtype=np.float64)
        rows = factor * np.arange(window.row + 0.5, window.stop_row, dtype=np.float64)
        return colour(piece.values, cols, rows), piece.valid > 0
    return piece.values * colour.gain + colour.offset, piece.valid > 0
