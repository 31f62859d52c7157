"""Overlap samples of a block: thumbnails of its images on a coarse grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geomosaic.geo.grid import Grid, Window
from geomosaic.mosaicking.seams.voronoi import image_index
from geomosaic.options.render import BLOCK_HEIGHT, BLOCK_WIDTH, RenderOptions
from geomosaic.radiometry.overlaps import Overlap, Overlaps, Thumbnail
from geomosaic.raster.validity import rasterized
from geomosaic.render.aligned import cell_means, picked
from geomosaic.render.photo import Photo, Rectifier
from geomosaic.render.photos import Photos, map_in_order
from geomosaic.resample.engine import Target, engine_for
from geomosaic.resample.warp import Colour, value_range
from geomosaic.sensor.map_to_image import Ground
from geomosaic.surface.model import Surface
from geomosaic.types import ByteArray, FloatArray

# Cells across a footprint on which images are compared: coarse, so that small errors of geometry do not count.
CELLS = 96
# Largest error of the interpolated geometry in cells, as only colours are compared.
LATTICE_TOLERANCE = 0.1
# Photos of which single pixels are kept: all of so few, every second one of more, which saves time, and no more than so
# many, which bounds memory.
FEW_PICTURES, MAX_PICTURES = 8, 256
# Samples along each side of a cell, of an image reduced on reading; two take 0.6 of the time and double the noise.
MAX_SAMPLES = 3


@dataclass(frozen=True)
class BlockSamples:
    """Samples of a block: its overlaps, the level of each photo, and single pixels.

    Attributes
    ----------
    overlaps : list of Overlap
    level : array (images, bands)
        Median of all that each photo shows; NaN where it shows nothing.
    pixels : dict of int to Thumbnail
        Single pixels of photos by their number, valid where the photo is the nearest.
    """

    overlaps: list[Overlap]
    level: FloatArray
    pixels: dict[int, Thumbnail]


def block_samples(photos: Photos, options: RenderOptions, grid: Grid, hidden: Sequence[Any] = ()) -> BlockSamples:
    """Samples of all photos and their overlaps on a coarse grid.

    Parameters
    ----------
    photos : Photos
    options : RenderOptions
        Threads and progress.
    grid : Grid
        Coarse grid of the overlaps.
    hidden : sequence of Polygon or MultiPolygon
        Areas to leave out, in the output map.

    Returns
    -------
    BlockSamples
    """
    level = np.full((len(photos), photos.info.bands), np.nan)
    low, high, whole = value_range(photos.info.dtype)
    windows = [grid.window_of(outline.bounds) for outline in photos.outlines]
    # Only integers have ends of their range, at which values are clipped.
    overlaps, cells = Overlaps(windows, (low, high) if whole else None), cell_count(windows)
    several = min(len(photos), max(FEW_PICTURES, len(photos) // 2), MAX_PICTURES)
    chosen = set(np.linspace(0, len(photos) - 1, several).round().astype(int).tolist())
    pixels: dict[int, Thumbnail] = {}
    centres = np.array([outline.centre for outline in photos.outlines])

    def piece(index: int) -> tuple[Thumbnail, Thumbnail | None]:
        # Pixels besides means, which are hardly ever clipped.
        whole, dtype = windows[index], photos.info.dtype
        wanted = [("average", "float32", whole), ("nearest", dtype, _middle(whole))][: 1 + (index in chosen)]
        with photos.using(index) as photo:
            mean, *single = thumbnails(photo, photos.block.surface, grid, whole, wanted, cells)
        mean = replace(mean, valid=_with_valid_neighbours(mean.valid))
        return restricted(mean, grid, hidden), _where_nearest(single[0], grid, centres, index) if single else None

    rendered = map_in_order(piece, range(len(photos)), options.threads, ahead=1)
    for done, (index, (found, single)) in enumerate(rendered):
        overlaps.add(index, found)
        if single is not None:
            pixels[index] = single
        if found.valid.any():
            level[index] = np.median(found.values[found.valid > 0], axis=0)
        options.report(done + 1, len(photos), "balance")
    return BlockSamples(overlaps.found, level, pixels)


def _middle(window: Window) -> Window:
    """Middle of a window, three fifths of it along each side: a photo is seldom the nearest beyond."""
    cols, rows = (max(size, 0) // 5 for size in (window.width, window.height))
    return Window(window.col + cols, window.row + rows, window.width - 2 * cols, window.height - 2 * rows)


def _where_nearest(piece: Thumbnail, grid: Grid, centres: FloatArray, index: int) -> Thumbnail:
    """Thumbnail, valid only where no centre (images, 2) is nearer than that of its own image."""
    rows, cols = np.nonzero(piece.valid)
    xy = grid.xy(np.column_stack([cols + piece.window.col + 0.5, rows + piece.window.row + 0.5]))
    own = ((xy - centres[index]) ** 2).sum(axis=1)
    # Centres farther than twice the farthest cell are nearer to none of them.
    apart = ((centres - centres[index]) ** 2).sum(axis=1)
    nearest = own.copy()
    for centre in centres[apart <= 4 * own.max(initial=0.0)]:
        nearest = np.minimum(nearest, ((xy - centre) ** 2).sum(axis=1))
    piece.valid[rows, cols] = own <= nearest
    return piece


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
    photo: Photo,
    surface: Surface | None,
    grid: Grid,
    window: Window,
    resampling: str,
    dtype: str,
    cells: int = 0,
    places: Grid | None = None,
) -> Thumbnail:
    """Thumbnail of one photo on a coarse grid.

    Parameters
    ----------
    photo, surface, grid, window, cells, places
        As in `thumbnails`.
    resampling : str
        'average' for means of cells, 'nearest' for one pixel of each.
    dtype : str
        Sample type of the values.

    Returns
    -------
    Thumbnail
    """
    return thumbnails(photo, surface, grid, window, [(resampling, dtype, window)], cells, places)[0]


def thumbnails(
    photo: Photo,
    surface: Surface | None,
    grid: Grid,
    window: Window,
    wanted: Sequence[tuple[str, str, Window]],
    cells: int = 0,
    places: Grid | None = None,
) -> list[Thumbnail]:
    """Thumbnails of one photo on a coarse grid, by several ways of resampling; the ground is looked at once.

    Parameters
    ----------
    photo : Photo
    surface : Surface, optional
    grid : Grid
    window : Window
        Of the grid.
    wanted : sequence of (str, str, Window)
        Resampling ('average' for means of cells, 'nearest' for one pixel of each), sample type and part of the window.
    cells : int
        Of all thumbnails that will be made, if this is one of many; they decide on compiled kernels.
    places : Grid, optional
        Of the places that are looked up in photos that have to be rectified, where they are not the cells' centres.

    Returns
    -------
    list of Thumbnail
        Values before any correction; 0 where not valid.
    """
    found = [_blank(own, photo.source.info.bands, dtype) for _, dtype, own in wanted]
    if window.empty:
        return found
    left = [
        (resampling, piece)
        for (resampling, *_), piece in zip(wanted, found, strict=True)
        if not _read_aligned(photo, grid, resampling, piece)
    ]
    if not left:
        return found
    colour = Colour.identity(photo.source.info.bands)
    places, size = places or grid, 4 * max(cells, window.width * window.height)
    rectifiers = [
        Rectifier(engine_for(size, resampling), places, resampling, LATTICE_TOLERANCE, MAX_SAMPLES)
        for resampling, _ in left
    ]
    below = Ground.under(places, surface)
    # The window itself is cut into blocks, not the grid: only the heights below the photo are read.
    for part in window.split(BLOCK_WIDTH, BLOCK_HEIGHT):
        ground = below.block(part)
        for rectifier, (_, piece) in zip(rectifiers, left, strict=True):
            own = part.intersection(piece.window)
            if not own.empty:
                here = own.slices_in(piece.window)
                target = Target(piece.values[here], piece.valid[here])
                rectifier.fill(photo, replace(ground, window=own), colour, target)
    return found


def _blank(window: Window, bands: int, dtype: str) -> Thumbnail:
    shape = max(window.height, 0), max(window.width, 0)
    return Thumbnail(window, np.zeros((*shape, bands), dtype=dtype), np.zeros(shape, dtype=np.uint8))


def _read_aligned(photo: Photo, grid: Grid, resampling: str, piece: Thumbnail) -> bool:
    """Whether a raster's pixels fit into the cells, so that a thumbnail is read without rectification."""
    size = photo.step_of(grid)
    if size is None or photo.offset is None:
        return False
    if resampling == "average":
        cell_means(photo.source, photo.offset, piece.window, size, piece.values, piece.valid)
        np.multiply(piece.values, photo.scale, out=piece.values)
        return True
    if photo.source.decimates and photo.scale == 1.0 and piece.values.dtype == photo.source.dtype:
        picked(photo.source, photo.offset, size, piece.window, piece.values, piece.valid)
        return True
    return False


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
