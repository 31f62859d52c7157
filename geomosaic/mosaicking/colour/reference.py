"""Reference raster for the colour of a mosaic: another mosaic, or a satellite image of any resolution and CRS."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from geomosaic.block.block import OrientedImage
from geomosaic.block.footprint import footprint
from geomosaic.errors import InputError
from geomosaic.geo.grid import Grid
from geomosaic.mosaicking.colour.balance import outside_areas, thumbnail
from geomosaic.options.render import RenderOptions
from geomosaic.radiometry.overlap_samples import Overlap, Thumbnail, overlap_of
from geomosaic.render.photo import Photo
from geomosaic.render.photos import Photos
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
    shown = _reference_thumbnail(reference, photos, coarse)
    low, high, whole = value_range(photos.info.dtype)
    clipped = (low, high) if whole else None
    found, number = [], len(photos)
    for index in range(len(photos)):
        window = coarse.window_of(photos.outlines[index].bounds)
        with photos.using(index) as photo:
            piece = thumbnail(photo, photos.block.surface, coarse, window, "average", "float32")
        pair = overlap_of(index, number, outside_areas(piece, coarse, hidden), shown, None)
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
    with_type = Photo.open(reference, None, coarse, outline, options.memory_limit // 8)
    kind = with_type.source.info.dtype
    with_type.source.close()
    if kind != photos.info.dtype:
        ours = np.median(np.concatenate([pair.a for pair in found]))
        theirs = np.median(np.concatenate([pair.b for pair in found]))
        scale = float(ours / theirs) if theirs > 0 else 1.0
        units = f"; its values ({kind}) times {scale:.6g}, so that the medians are equal"
    moved = [
        Overlap(
            pair.first,
            number,
            pair.a,
            pair.b * scale,
            None if pair.cells is None else (pair.cells + 0.5) * factor - 0.5,
        )
        for pair in found
    ]
    cell = coarse.resolution[0]
    return moved, f"reference {reference.name}: {len(moved)} images compared in cells of {cell:g} map units{units}"


def _unclipped(pair: Overlap, clipped: tuple[float, float] | None) -> Overlap:
    """Samples without those where the photo is at an end of its range; the reference has a range of its own."""
    if clipped is None:
        return pair
    good = ((pair.a > clipped[0] + 0.5) & (pair.a < clipped[1] - 0.5)).all(axis=1)
    return Overlap(
        pair.first, pair.second, pair.a[good], pair.b[good], None if pair.cells is None else pair.cells[good]
    )


def _reference_thumbnail(reference: OrientedImage, photos: Photos, coarse: Grid) -> Thumbnail:
    outline = footprint(reference, None, photos.grid.crs)
    photo = Photo.open(reference, None, coarse, outline, 1 << 28)
    try:
        if photo.source.info.bands != photos.info.bands:
            raise InputError(
                f"bands of the reference: {photo.source.info.bands}, of the images: {photos.info.bands}",
                where=reference.path,
                hint="say which of its bands go with those of the images: `reference_bands`",
            )
        window = coarse.window_of(outline.bounds)
        if window.empty:
            raise InputError(
                "the reference shows nothing of the mosaic's area",
                where=reference.path,
                hint="give one that overlaps it",
            )
        return thumbnail(photo, None, coarse, window, "average", "float32")
    finally:
        photo.source.close()
