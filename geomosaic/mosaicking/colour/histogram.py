"""Histogram matching of a mosaic, among its images and to a reference raster."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from affine import Affine

from geomosaic.block import OrientedImage, footprint
from geomosaic.errors import InputError, counted, warn
from geomosaic.geo.grid import Grid
from geomosaic.mosaicking.colour.acceptance import balance_change
from geomosaic.mosaicking.colour.balance import (
    ThumbnailOfImage,
    comparison_grid,
    master_index,
    restricted,
    thumbnail,
)
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.options.render import RenderOptions
from geomosaic.radiometry.corrections import ToneCurve
from geomosaic.radiometry.gain_offset import Balance
from geomosaic.radiometry.histogram_matching import common_values, match_overlaps, match_sequence, match_whole
from geomosaic.radiometry.overlaps import Overlap, Thumbnail, overlap_of, partners_of_pieces
from geomosaic.render.areas import read_areas
from geomosaic.render.photo import Photo
from geomosaic.render.photos import Photos
from geomosaic.render.regions import map_images
from geomosaic.resample.warp import value_range


def reference_samples(
    photos: Photos, options: RenderOptions, grid: Grid, reference: OrientedImage, hidden: Sequence[Any] = ()
) -> tuple[list[Overlap], str]:
    """Samples of each photo and a reference raster, which has the number after the last photo.

    Both are compared at the coarser of the grid's cells and the reference's pixels. A reference of another sample type
    is scaled by one factor for all bands, so that its median is that of the photos: its colours and contrast count, not
    its units.

    Parameters
    ----------
    photos : Photos
    options : RenderOptions
    grid : Grid
        Coarse grid of the samples.
    reference : OrientedImage
    hidden : sequence of Polygon or MultiPolygon
        Areas to leave out, in the output map.

    Returns
    -------
    overlaps : list of Overlap
    note : str
        How the reference was compared.

    Raises
    ------
    InputError
        It shows nothing of the mosaic, or has other bands.
    """
    outline = footprint(reference, None, photos.grid.crs)
    factor = max(1, round(outline.sampling / grid.resolution[0]))
    coarse = grid.coarser(factor) if factor > 1 else grid
    shown, dtype = _reference_thumbnail(reference, photos, coarse, options, "average")
    low, high, whole = value_range(photos.info.dtype)
    clipped = (low, high) if whole else None
    found, number = [], len(photos)
    for index, piece in map_images(lambda some: ThumbnailOfImage(some, coarse, hidden=hidden), photos, options):
        pair = overlap_of(index, number, piece, shown, None)
        if pair is not None:
            found.append(_unclipped(pair, clipped))
        options.report(index + 1, len(photos), "reference")
    found = [pair for pair in found if len(pair.a)]
    if not found:
        raise InputError(
            "the reference shows nothing of what the images show", where=reference.path, hint="give one that overlaps"
        )
    # Grey values of another sample type have another unit; the medians of the same ground give its size.
    scale, units = 1.0, ""
    if dtype != photos.info.dtype:
        ours = np.median(np.concatenate([pair.a for pair in found]))
        theirs = np.median(np.concatenate([pair.b for pair in found]))
        scale = float(ours / theirs) if theirs > 0 else 1.0
        units = f"; its values ({dtype}) times {scale:.6g}, so that the medians are equal"
    moved = [
        replace(pair, b=pair.b * scale, cells=None if pair.cells is None else (pair.cells + 0.5) * factor - 0.5)
        for pair in found
    ]
    cell = coarse.resolution[0]
    compared = counted(len(moved), "image")
    return moved, f"reference {reference.name}: {compared} compared in cells of {cell:g} map units{units}"


def _unclipped(pair: Overlap, clipped: tuple[float, float] | None) -> Overlap:
    """Samples without those where the photo is at an end of its range; the reference has a range of its own."""
    if clipped is None:
        return pair
    good = ((pair.a > clipped[0] + 0.5) & (pair.a < clipped[1] - 0.5)).all(axis=1)
    return replace(pair, a=pair.a[good], b=pair.b[good], cells=None if pair.cells is None else pair.cells[good])


def _reference_thumbnail(
    reference: OrientedImage, photos: Photos, grid: Grid, options: RenderOptions, resampling: str
) -> tuple[Thumbnail, str]:
    """Thumbnail of the reference and its sample type, which for single pixels is that of the images."""
    outline = footprint(reference, None, grid.crs)
    photo = Photo.open(reference, None, grid, outline, options.spare_memory // 4)
    try:
        info, wanted = photo.source.info, photos.info
        if info.bands != wanted.bands or (resampling == "nearest" and info.dtype != wanted.dtype):
            raise InputError(
                f"the reference has {counted(info.bands, 'band')} of {info.dtype}, the images {wanted.bands} of "
                f"{wanted.dtype}",
                where=reference.path,
                hint="give one of the same bands and sample type, or choose its bands: `reference_bands`",
            )
        window = grid.window_of(outline.bounds)
        if window.empty:
            raise InputError(
                "the reference shows nothing of the mosaic's area", where=reference.path,
                hint="give one that overlaps it",
            )  # fmt: skip
        dtype = info.dtype if resampling == "nearest" else "float32"
        places = _places(grid, photos.grid) if resampling == "nearest" else None
        return thumbnail(photo, None, grid, window, resampling, dtype, places=places), info.dtype
    finally:
        photo.source.close()


# Cells across a footprint of which one pixel each is sampled: ranks are then known to about a hundredth.
CELLS = 192
# Output pixels from the centre of a pixel to where images are looked up: no simple ratio of pixel sizes puts it on a
# corner of their pixels.
OFF_CENTRE = 0.137


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

    # Single pixels: means of cells would narrow the distribution.
    places = _places(grid, photos.grid)
    single = photos.info.dtype, places, hidden, region
    thumbnails = map_images(lambda some: ThumbnailOfImage(some, grid, "nearest", *single), photos, render)
    for done, (_, found) in enumerate(thumbnails):
        pieces.append(found)
        render.report(done + 1, len(photos), "histograms")
    if reference is not None:
        shown, _ = _reference_thumbnail(reference, photos, grid, render, "nearest")
        target = restricted(shown, grid, hidden, region)
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
        names = ", ".join(photos.scenes[i].name for i in alone[:5]) + (" ..." if len(alone) > 5 else "")
        warn(f"no overlaps join {names} to the master of the histograms: left as they are")
    lines = [curve.line() for curve in curves]
    before, after, pairs = _differences(pieces, curves)
    gain, offset = np.array([line[0] for line in lines]), np.array([line[1] for line in lines])
    solved = Balance(gain, offset, before, after, pairs, tuple(curves))
    return replace(solved, change=balance_change(dict(enumerate(pieces)), solved, grid, photos))


def _places(grid: Grid, output: Grid) -> Grid:
    """Grid whose cells have their centres within the pixels of the output that `render.aligned.picked` takes."""
    # Centres of cells of 2, 4, 6 … output pixels lie on corners of pixels, and so do centres of output pixels in images
    # of half their size: rounding would decide what each image shows there, and views of one place would differ.
    step = round(grid.resolution[0] / output.resolution[0])
    off = (0.0 if step % 2 else 0.5) + OFF_CENTRE
    return replace(grid, transform=grid.transform @ Affine.translation(off / step, off / step))


def _most_overlapping(pieces: list[Thumbnail]) -> int:
    """Image whose window shares most cells with those of the others; of equals, the first."""
    partners = partners_of_pieces(pieces)

    def shares(i: int) -> int:
        common = (pieces[i].window.intersection(pieces[j].window) for j in partners[i].tolist())
        return sum(window.width * window.height for window in common)

    return max(range(len(pieces)), key=lambda i: (shares(i), -i))


def _differences(pieces: list[Thumbnail], curves: list[ToneCurve]) -> tuple[np.ndarray, np.ndarray, int]:
    """RMS difference (bands,) over all overlaps, before and after; number of overlaps."""
    bands = pieces[0].values.shape[2]
    before, after, count, pairs = np.zeros(bands), np.zeros(bands), 0, 0
    for i, partners in enumerate(partners_of_pieces(pieces)):
        for j in partners[partners > i].tolist():
            found = common_values(pieces[i], pieces[j])
            if found is None:
                continue
            a, b = (values.astype(np.float64) for values in found)
            before += ((a - b) ** 2).sum(axis=0)
            after += ((curves[i](a) - curves[j](b)) ** 2).sum(axis=0)
            count, pairs = count + len(a), pairs + 1
    if not count:
        return np.full(bands, np.nan), np.full(bands, np.nan), 0
    return np.sqrt(before / count), np.sqrt(after / count), pairs
