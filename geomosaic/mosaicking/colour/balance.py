"""Overlap samples of a block: thumbnails of its images on a coarse grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from geomosaic.geo.grid import Grid, Window
from geomosaic.mosaicking.seams.voronoi import image_index
from geomosaic.options.render import BLOCK_HEIGHT, BLOCK_WIDTH, RenderOptions
from geomosaic.radiometry.overlaps import Overlap, Overlaps, Thumbnail
from geomosaic.raster.validity import rasterized
from geomosaic.render.aligned import cell_means, picked
from geomosaic.render.photo import Photo, Rectifier
from geomosaic.render.photos import Photos
from geomosaic.render.workers import in_order
from geomosaic.resample.engine import engine_for
from geomosaic.resample.warp import Colour, value_range
from geomosaic.sensor.map_to_image import Ground
from geomosaic.surface.model import Surface
from geomosaic.types import ByteArray, FloatArray

# Cells across a footprint on which images are compared: coarse, so that small errors of geometry do not count.
CELLS = 96
# Largest error of the interpolated geometry in cells, as only colours are compared.
LATTICE_TOLERANCE = 0.1
# Samples along each side of a cell, of an image reduced on reading; two take 0.6 of the time and double the noise.
MAX_SAMPLES = 3


def overlap_samples(
    photos: Photos, options: RenderOptions, grid: Grid, hidden: Sequence[Any] = ()
) -> tuple[list[Overlap], FloatArray]:
    """Samples of all overlaps of the photos on a coarse grid, and the median level of each photo.

    Parameters
    ----------
    photos : Photos
    options : RenderOptions
        Threads and progress.
    grid : Grid
        Coarse grid of the samples.
    hidden : sequence of Polygon or MultiPolygon
        Areas to leave out, in the output map.

    Returns
    -------
    overlaps : list of Overlap
    level : array (images, bands)
        Median of all that each photo shows; NaN where it shows nothing.
    """
    level = np.full((len(photos), photos.info.bands), np.nan)
    low, high, whole = value_range(photos.info.dtype)
    windows = [grid.window_of(outline.bounds) for outline in photos.outlines]
    # Only integers have ends of their range, at which values are clipped.
    overlaps, cells = Overlaps(windows, (low, high) if whole else None), cell_count(windows)

    def piece(index: int) -> Thumbnail:
        return restricted(_mean(photos, index, windows[index], grid, cells), grid, hidden)

    rendered = in_order(piece, range(len(photos)), options.threads, ahead=1)
    for done, (index, found) in enumerate(rendered):
        overlaps.add(index, found)
        if found.valid.any():
            level[index] = np.median(found.values[found.valid > 0], axis=0)
        options.report(done + 1, len(photos), "balance")
    return overlaps.found, level


def restricted(
    piece: Thumbnail, grid: Grid, hidden: Sequence[Any] = (), region: Sequence[Any] | None = None
) -> Thumbnail:
    """Thumbnail without the cells whose centres lie in some areas, or outside others.

    Parameters
    ----------
    piece : Thumbnail
        Its `valid` is changed in place.
    grid : Grid
        Coarse grid of all thumbnails; areas are in its map.
    hidden : sequence of Polygon or MultiPolygon
        Areas to leave out.
    region : sequence of Polygon or MultiPolygon, optional
        Areas to keep; all unless given.

    Returns
    -------
    Thumbnail
        `piece` itself.
    """
    if piece.window.empty:
        return piece
    crop = grid.crop(piece.window)
    if hidden:
        piece.valid[rasterized([(shape, 1) for shape in hidden], crop) == 1] = 0
    if region is not None:
        piece.valid[rasterized([(shape, 1) for shape in region], crop) != 1] = 0
    return piece


def comparison_grid(photos: Photos, cells: int = CELLS) -> Grid:
    """Coarse grid on which images are compared: the output grid coarsened by a whole factor.

    Parameters
    ----------
    photos : Photos
    cells : int
        Cells across the median footprint, about.

    Returns
    -------
    Grid
        With the upper left corner of the output grid; cells are never finer than its pixels.
    """
    # The median, so that one image of another scale does not choose the cells of all.
    areas = [np.prod(np.ptp(outline.ring, axis=0)) for outline in photos.outlines]
    cell = np.sqrt(float(np.median(areas))) / cells
    return photos.grid.coarser(max(1, round(cell / photos.grid.resolution[0])))


def cell_count(windows: Sequence[Window]) -> int:
    """Number of cells of all thumbnails.

    Parameters
    ----------
    windows : sequence of Window
        Of the coarse grid; empty ones do not count.

    Returns
    -------
    int
    """
    return sum(window.width * window.height for window in windows if not window.empty)


def _mean(photos: Photos, index: int, window: Window, grid: Grid, cells: int) -> Thumbnail:
    with photos.using(index) as photo:
        found = thumbnail(photo, photos.block.surface, grid, window, "average", "float32", cells)
    return replace(found, valid=_with_valid_neighbours(found.valid))


def _with_valid_neighbours(valid: ByteArray) -> ByteArray:
    """Cells whose eight neighbours are valid as well."""
    # A cell on the edge of an image may be half covered, and its mean is that of the covered half: other ground than in
    # the image that goes on there. Tiles that share no more than a line of pixels would be balanced by nothing else.
    wide = np.pad(valid, 1)
    rows, cols = valid.shape
    out = valid.copy()
    for row in range(3):
        for col in range(3):
            out &= wide[row : row + rows, col : col + cols]
    return out


def thumbnail(
    photo: Photo, surface: Surface | None, grid: Grid, window: Window, resampling: str, dtype: str, cells: int = 0
) -> Thumbnail:
    """Thumbnail of one photo on a coarse grid.

    Parameters
    ----------
    photo : Photo
    surface : Surface, optional
    grid : Grid
    window : Window
        Of the grid.
    resampling : str
        'average' for means of cells, 'nearest' for one pixel of each.
    dtype : str
        Sample type of the values.
    cells : int
        Of all thumbnails that will be made, if this is one of many; they decide on compiled kernels.

    Returns
    -------
    Thumbnail
        Values before any correction; 0 where not valid.
    """
    bands = photo.source.info.bands
    values = np.zeros((max(window.height, 0), max(window.width, 0), bands), dtype=dtype)
    valid = np.zeros(values.shape[:2], dtype=np.uint8)
    if window.empty:
        return Thumbnail(window, values, valid)
    # A raster whose pixels fit into the cells needs no rectification.
    size = photo.step_of(grid)
    if size is not None and photo.offset is not None:
        if resampling == "average":
            cell_means(photo.source, photo.offset, window, size, values, valid)
            values *= photo.scale
            return Thumbnail(window, values, valid)
        if photo.source.decimates and photo.scale == 1.0 and values.dtype == photo.source.dtype:
            picked(photo.source, photo.offset, size, window, values, valid)
            return Thumbnail(window, values, valid)
    engine, colour = engine_for(4 * max(cells, valid.size), resampling), Colour.identity(bands)
    rectifier = Rectifier(engine, grid, resampling, LATTICE_TOLERANCE, MAX_SAMPLES)
    below = Ground.under(grid, surface)
    # The window itself is cut into blocks, not the grid: only the heights below the photo are read.
    for part in window.split(BLOCK_WIDTH, BLOCK_HEIGHT):
        ground = below.block(part)
        here = part.slices_in(window)
        rectifier.fill(photo, ground, colour, values[here], valid[here])
    return Thumbnail(window, values, valid)


def master_index(photos: Photos, master: str | None) -> int | None:
    """Number of the master image.

    Parameters
    ----------
    photos : Photos
    master : str or None
        Name of the image, with or without its suffix.

    Returns
    -------
    int or None
        None without a master.

    Raises
    ------
    InputError
        No image, or several, of that name.
    """
    if master is None:
        return None
    hint = "; a raster besides the images is a reference"
    return image_index(master, photos.block.scenes, where="master", hint=hint)
