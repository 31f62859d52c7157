"""Overlap samples of a block: thumbnails of its images on a coarse grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from geomosaic.geo.grid import Grid, Window
from geomosaic.mosaicking.precedence import image_index
from geomosaic.options.render import BLOCK_HEIGHT, BLOCK_WIDTH, RenderOptions
from geomosaic.radiometry.overlaps import Overlap, Overlaps, Thumbnail
from geomosaic.raster.source import Source
from geomosaic.raster.validity import rasterized
from geomosaic.render.aligned import cell_means, picked
from geomosaic.render.photo import Photo, Rectifier
from geomosaic.render.photos import Photos
from geomosaic.render.regions import map_images
from geomosaic.resample.warp import Colour, Target, value_range
from geomosaic.sensor.map_to_image import BlockGround, Ground
from geomosaic.surface.model import Surface
from geomosaic.types import AnyArray, BoolArray, ByteArray, FloatArray, IntArray

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
    overlaps = Overlaps(windows, (low, high) if whole else None)
    several = min(len(photos), max(FEW_PICTURES, len(photos) // 2), MAX_PICTURES)
    chosen = frozenset(np.linspace(0, len(photos) - 1, several).round().astype(int).tolist())
    pixels: dict[int, Thumbnail] = {}
    centres, areas = np.array([each.centre for each in photos.outlines]), tuple(hidden)
    samples = map_images(lambda some: _SamplesOfImage(some, grid, areas, chosen, centres), photos, options)
    for done, (index, (found, single)) in enumerate(samples):
        overlaps.add(index, found)
        if single is not None:
            pixels[index] = single
        if found.valid.any():
            level[index] = np.median(found.values[found.valid > 0], axis=0)
        options.report(done + 1, len(photos), "balance")
    return BlockSamples(overlaps.found, level, pixels)


@dataclass(frozen=True, eq=False)
class _SamplesOfImage:
    """Means of cells of a photo by its number, and single pixels of some; for any thread or process."""

    photos: Photos
    grid: Grid
    hidden: tuple[Any, ...]
    chosen: frozenset[int]
    centres: FloatArray

    def __call__(self, index: int) -> tuple[Thumbnail, Thumbnail | None]:
        photos, grid = self.photos, self.grid
        window = grid.window_of(photos.outlines[index].bounds)
        single: SinglePixels | None = None
        ground = _ground_below(grid, photos.surface, window)
        with photos.using(index) as photo:
            if index in self.chosen:  # pixels besides means, which are hardly ever clipped
                single = SinglePixels.of_nearest(photo, ground, grid, window, self.centres, index)
                photo = replace(photo, source=cast(Source, single))
            mean = _thumbnail_over(ground, photo, grid, window, "average", "float32")
        mean = replace(mean, valid=_with_valid_neighbours(mean.valid))
        pixels_of = None if single is None else single.thumbnail(window, photo.scale, photos.info.dtype)
        return restricted(mean, grid, self.hidden), pixels_of


@dataclass(frozen=True, eq=False)
class SinglePixels:
    """Reader of a photo that keeps some pixels of all that it reads: they cost no reading of their own.

    Attributes
    ----------
    source : Source
    cells : int array (N, 2)
        Columns and rows of the coarse grid.
    pixels : int array (N, 2)
        Columns and rows of the image.
    values : array (N, bands)
    seen : bool array (N,)
        Pixels that were read, and are valid.
    """

    source: Source
    cells: IntArray
    pixels: IntArray
    values: AnyArray
    seen: BoolArray

    @classmethod
    def of_nearest(
        cls,
        photo: Photo,
        ground: Sequence[BlockGround],
        grid: Grid,
        window: Window,
        centres: FloatArray,
        index: int,
    ) -> SinglePixels:
        """One pixel of each cell to which no centre (images, 2) is nearer than that of the photo of this number.

        Parameters
        ----------
        photo : Photo
        ground : sequence of BlockGround
        grid : Grid
        window : Window
        centres : array (images, 2)
            Map positions of the photos' centres.
        index : int
            Number of the photo.
        """
        # The middle three fifths along each side: a photo is seldom the nearest beyond.
        (left, right), (top, bottom) = (
            (first + max(size, 0) // 5, first + size - max(size, 0) // 5)
            for first, size in ((window.col, window.width), (window.row, window.height))
        )
        c, r = np.meshgrid(np.arange(left, right), np.arange(top, bottom))
        cells = np.column_stack([c.ravel(), r.ravel()])
        xy = grid.xy((cells + 0.5).astype(np.float64))
        own = ((xy - centres[index]) ** 2).sum(axis=1)
        # Centres farther than twice the farthest cell are nearer to none of them.
        apart = ((centres - centres[index]) ** 2).sum(axis=1)
        nearest = own.copy()
        for centre in centres[apart <= 4 * own.max(initial=0.0)]:
            nearest = np.minimum(nearest, ((xy - centre) ** 2).sum(axis=1))
        cells, xy = cells[own <= nearest], photo.mapper.surface_xy(xy[own <= nearest])
        z = np.full(len(xy), np.nan)
        for block in ground:
            z = np.where(np.isnan(z), block.height(xy), z)
        places = photo.mapper.image(xy, z)
        size = photo.source.info.width, photo.source.info.height
        with np.errstate(invalid="ignore"):
            inside = ((places >= 0) & (places < size)).all(axis=1)
        found = places[inside].astype(np.int64)
        values = np.zeros((len(found), photo.source.info.bands), dtype=photo.source.dtype)
        return cls(photo.source, cells[inside], found, values, np.zeros(len(found), dtype=np.bool_))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.source, name)

    def read(self, window: Window, shrink: int = 1) -> tuple[AnyArray, ByteArray | None]:
        """As `Source.read`."""
        if shrink > 1:
            return self.source.read(window, shrink, self._keep)
        values, valid = self.source.read(window)
        self._keep(window, values, valid)
        return values, valid

    def _keep(self, window: Window, values: AnyArray, valid: ByteArray | None) -> None:
        first, end = (window.col, window.row), (window.stop_col, window.stop_row)
        here = np.flatnonzero(((self.pixels >= first) & (self.pixels < end)).all(axis=1))
        cols, rows = (self.pixels[here] - first).T
        self.values[here] = values[rows, cols]
        self.seen[here] = True if valid is None else valid[rows, cols] > 0

    def thumbnail(self, window: Window, scale: float, dtype: str) -> Thumbnail:
        """The pixels in a window of the coarse grid, in the sample type of the output.

        Parameters
        ----------
        window : Window
            Of the coarse grid.
        scale : float
        dtype : str
            Sample type of the output.
        """
        found = _blank(window, self.values.shape[1], dtype)
        cols, rows = (self.cells[self.seen] - (window.col, window.row)).T
        values = self.values[self.seen]
        if scale != 1.0:
            low, high, whole = value_range(dtype)
            scaled = values * scale
            values = np.clip(np.floor(scaled + 0.5), low, high) if whole else scaled
        found.values[rows, cols], found.valid[rows, cols] = values, 1
        return found


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
    places: Grid | None = None,
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
    places : Grid, optional
        Of the places that are looked up in photos that have to be rectified, where they are not the cells' centres.

    Returns
    -------
    Thumbnail
        Values before any correction; 0 where not valid.
    """
    ground = _ground_below(places or grid, surface, window)
    return _thumbnail_over(ground, photo, grid, window, resampling, dtype, places)


@dataclass(frozen=True, eq=False)
class ThumbnailOfImage:
    """Thumbnail of a photo by its number; for any thread or process.

    Attributes
    ----------
    photos : Photos
    grid : Grid
    resampling, dtype, places
        As in `thumbnail`.
    hidden, region
        As in `restricted`.
    """

    photos: Photos
    grid: Grid
    resampling: str = "average"
    dtype: str = "float32"
    places: Grid | None = None
    hidden: Sequence[Any] = ()
    region: Sequence[Any] | None = None

    def __call__(self, index: int) -> Thumbnail:
        """Thumbnail on the cells that its footprint's bounds meet."""
        photos, grid = self.photos, self.grid
        window = grid.window_of(photos.outlines[index].bounds)
        with photos.using(index) as photo:
            found = thumbnail(photo, photos.surface, grid, window, self.resampling, self.dtype, self.places)
        return restricted(found, grid, self.hidden, self.region)


def _ground_below(grid: Grid, surface: Surface | None, window: Window) -> list[BlockGround]:
    """Ground below a window of a coarse grid, which is cut into blocks: only heights below the photo are read."""
    below = Ground.under(grid, surface)
    return [] if window.empty else [below.block(part) for part in window.split(BLOCK_WIDTH, BLOCK_HEIGHT)]


def _thumbnail_over(
    ground: Sequence[BlockGround],
    photo: Photo,
    grid: Grid,
    window: Window,
    resampling: str,
    dtype: str,
    places: Grid | None = None,
) -> Thumbnail:
    """Thumbnail of one photo, as `thumbnail` makes it, over ground from `_ground_below`."""
    piece = _blank(window, photo.source.info.bands, dtype)
    if window.empty or _read_aligned(photo, grid, resampling, piece):
        return piece
    colour = Colour.identity(photo.source.info.bands)
    rectifier = Rectifier(places or grid, resampling, LATTICE_TOLERANCE, MAX_SAMPLES)
    for block in ground:
        here = block.window.slices_in(window)
        rectifier.fill(photo, block, colour, Target(piece.values[here], piece.valid[here]))
    return piece


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
    return image_index(master, photos.scenes, where="`master`", hint=hint)
