"""Who shows what: shares as the program lays them, and those that a person has drawn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from geomosaic.product.colour.corrections import Correction
from geomosaic.product.mosaic_options import MosaicOptions
from geomosaic.product.photos import Photos
from geomosaic.product.reruns.earlier import Earlier
from geomosaic.product.seams.order import index_of, ordered
from geomosaic.product.seams.ranks import by_rank, under
from geomosaic.seam.partition import canonical
from geomosaic.seam.voronoi import regions

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
    from geomosaic.product.seams.cutlines import note_gap, read_cutlines
    from geomosaic.seam.cutlines import covers, with_cutlines

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
    from geomosaic.product.seams.water import calmest, read_water
    from geomosaic.seam.cutlines import with_cutlines

    return with_cutlines(shares, calmest(photos, read_water(options.water, photos.grid), shapes, colours))


def _laid(photos: Photos, shapes: list[Any], colours: Sequence[Correction], options: MosaicOptions) -> list[Any]:
    """Shares as the program lays them."""
    if options.seams == "alike":
        from geomosaic.product.seams.lay import alike_regions
        from geomosaic.product.seams.layers import read_seam_layers

        layers = read_seam_layers(options.follow, options.avoid, photos.grid)
        return alike_regions(photos, shapes, colours, options.render, options.seam_weights, layers)
    if options.seams == "halve":
        from geomosaic.product.seams.lay import halved_regions

        return halved_regions(photos, shapes)
    if options.seams == "order":
        return by_rank(shapes, ordered(photos.block.scenes, photos.outlines, options.order, options.base))
    centres = photos.centres
    if options.base is None:
        return regions(shapes, centres)
    base = index_of(options.base, photos.block.scenes)
    return under(regions(shapes[:base] + shapes[base + 1 :], centres[:base] + centres[base + 1 :]), shapes, base)
