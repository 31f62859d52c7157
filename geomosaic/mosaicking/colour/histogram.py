"""Histogram matching of a mosaic: all images sampled on one coarse grid and matched to a master or a reference."""

from __future__ import annotations

import warnings

import numpy as np

from geomosaic.block.block import OrientedImage
from geomosaic.block.footprint import Footprint, footprint
from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.geo.grid import Grid
from geomosaic.mosaicking.colour.balance import (
    comparison_grid,
    inside_areas,
    master_index,
    outside_areas,
    thumbnail,
)
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.options.render import RenderOptions
from geomosaic.radiometry.gain_offset import Balance
from geomosaic.radiometry.histogram_matching import (
    ToneCurve,
    common_values,
    match_overlaps,
    match_sequence,
    match_whole,
)
from geomosaic.radiometry.overlap_samples import Thumbnail
from geomosaic.render.areas import read_areas
from geomosaic.render.photo import Photo
from geomosaic.render.photos import Photos
from geomosaic.render.workers import in_order

CELLS = 192
"""Cells across a footprint of which one pixel each is sampled: ranks are then known to about a hundredth."""


def match_histograms(photos: Photos, options: MosaicOptions, reference: OrientedImage | None = None) -> Balance:
    """Curves that match the histograms of all images to one of them, or to a georeferenced raster.

    Parameters
    ----------
    photos : Photos
    options : MosaicOptions
        Their `histogram` is 'overlap', 'whole' or 'sequence'; `master` the name of an image (unless given, the one that
        shares most, or the first of a sequence); only samples in the areas `region` and outside the areas `mask` count.
    reference : OrientedImage, optional
        Georeferenced raster of the same bands and sample type to match to instead.

    Returns
    -------
    Balance
        With curves; its gains and offsets are straight lines through them.

    Raises
    ------
    InputError
        No such master, or a reference of other bands or outside the mosaic.

    Warns
    -----
    GeomosaicWarning
        Images that no overlaps join to the master.
    """
    method, master, render = options.colours.histogram, options.colours.master, options.render
    region = None if options.colours.region is None else read_areas(options.colours.region, photos.grid, must_meet=True)
    hidden = () if options.colours.mask is None else read_areas(options.colours.mask, photos.grid)
    grid = comparison_grid(photos, CELLS)
    master_number = master_index(photos, master)
    pieces: list[Thumbnail] = []

    def in_region(found: Thumbnail) -> Thumbnail:
        return inside_areas(outside_areas(found, grid, hidden), grid, region)

    def piece(index: int) -> Thumbnail:
        return in_region(_piece(photos, index, grid))

    rendered = in_order(piece, range(len(photos)), render.threads, ahead=1)
    for done, (_, found) in enumerate(rendered):
        pieces.append(found)
        render.report(done + 1, len(photos), "histograms")
    if reference is not None:
        target = in_region(_reference(photos, reference, grid, render))
    elif method == "sequence":
        target = pieces[master_number or 0]
    else:
        target = pieces[_most_overlapping(pieces) if master_number is None else master_number]
    alone: list[int] = []
    if method == "whole":
        curves = match_whole(pieces, target)
    elif method == "sequence":
        curves = match_sequence(pieces, target, master_number or 0)
    else:
        curves, alone = match_overlaps(pieces, target)
    if alone:
        names = ", ".join(photos.block.scenes[i].name for i in alone[:5]) + (" ..." if len(alone) > 5 else "")
        warnings.warn(
            f"no overlaps join {names} to the master of the histograms: left as they are",
            GeomosaicWarning,
            stacklevel=2,
        )
    lines = [curve.line() for curve in curves]
    before, after, pairs = _differences(pieces, curves)
    gain, offset = np.array([line[0] for line in lines]), np.array([line[1] for line in lines])
    return Balance(gain, offset, before, after, pairs, tuple(curves))


def _piece(photos: Photos, index: int, grid: Grid) -> Thumbnail:
    window = grid.window_of(photos.outlines[index].bounds)
    with photos.using(index) as photo:
        # Single pixels: means of cells would narrow the distribution.
        return thumbnail(photo, photos.block.surface, grid, window, "nearest", photos.info.dtype)


def _reference(photos: Photos, scene: OrientedImage, grid: Grid, options: RenderOptions) -> Thumbnail:
    outline: Footprint = footprint(scene, None, grid.crs)
    photo = Photo.open(scene, None, grid, outline, options.memory_limit // 4)
    try:
        info = photo.source.info
        if (info.bands, info.dtype) != (photos.info.bands, photos.info.dtype):
            raise InputError(
                f"the reference has {info.bands} bands of {info.dtype}, the images {photos.info.bands} of "
                f"{photos.info.dtype}",
                where=scene.path,
                hint="give one of the same bands and sample type, or choose bands with `bands`",
            )
        window = grid.window_of(outline.bounds)
        if window.empty:
            raise InputError(
                "the reference shows nothing of the mosaic's area", where=scene.path, hint="give one that overlaps it"
            )
        return thumbnail(photo, None, grid, window, "nearest", info.dtype)
    finally:
        photo.source.close()


def _most_overlapping(pieces: list[Thumbnail]) -> int:
    """Image whose window shares most cells with those of the others; of equals, the first."""
    windows = [piece.window for piece in pieces]

    def shares(i: int) -> int:
        common_values = (windows[i].intersection(other) for j, other in enumerate(windows) if j != i)
        return sum(w.width * w.height for w in common_values if not w.empty)

    return max(range(len(pieces)), key=lambda i: (shares(i), -i))


def _differences(pieces: list[Thumbnail], curves: list[ToneCurve]) -> tuple[np.ndarray, np.ndarray, int]:
    """RMS difference (bands,) over all overlaps, before and after; number of overlaps."""
    bands = pieces[0].values.shape[2]
    before, after, count, pairs = np.zeros(bands), np.zeros(bands), 0, 0
    for i, one in enumerate(pieces):
        for j in range(i + 1, len(pieces)):
            found = common_values(one, pieces[j])
            if found is None:
                continue
            a, b = (values.astype(np.float64) for values in found)
            before += ((a - b) ** 2).sum(axis=0)
            after += ((curves[i](a) - curves[j](b)) ** 2).sum(axis=0)
            count, pairs = count + len(a), pairs + 1
    if not count:
        return np.full(bands, np.nan), np.full(bands, np.nan), 0
    return np.sqrt(before / count), np.sqrt(after / count), pairs
