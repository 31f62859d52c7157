"""Who shows what: shares as the program lays them, and those that a person has drawn."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from geomosaic.product.options import MosaicOptions
from geomosaic.product.photos import Photos
from geomosaic.radiometry.curve import Curve
from geomosaic.resample.warp import Colour
from geomosaic.seam.partition import canonical
from geomosaic.seam.voronoi import regions

_STEP = 1e-6
"""Pixels."""


def shares_of(
    photos: Photos, shapes: list[Any], colours: Sequence[Colour | Curve], options: MosaicOptions
) -> list[Any]:
    """Shares of all images, in the output map."""
    step = _STEP * photos.grid.resolution[0]
    return [canonical(share, step) for share in _shares(photos, shapes, colours, options)]


def _shares(photos: Photos, shapes: list[Any], colours: Sequence[Colour | Curve], options: MosaicOptions) -> list[Any]:
    if options.cutlines is None:
        return _laid(photos, shapes, colours, options)
    from geomosaic.product.cutlines import read_cutlines
    from geomosaic.seam.cutlines import covers, with_cutlines

    names = [outline.name for outline in photos.outlines]
    drawn = read_cutlines(options.cutlines, names, shapes, photos.grid.crs)
    if covers(drawn, shapes):  # an edited layer has all shares: no others need to be laid
        return with_cutlines(regions(shapes, photos.centres), drawn)
    return with_cutlines(_laid(photos, shapes, colours, options), drawn)


def _laid(photos: Photos, shapes: list[Any], colours: Sequence[Colour | Curve], options: MosaicOptions) -> list[Any]:
    """Shares as the program lays them."""
    if options.seams == "alike":
        from geomosaic.product.seam_layers import read_seam_layers
        from geomosaic.product.seams import alike_regions

        layers = read_seam_layers(options.follow, options.avoid, photos.grid.crs)
        return alike_regions(photos, shapes, colours, options.render, options.seam_weights, layers)
    if options.seams == "halve":
        from geomosaic.product.seams import halved_regions

        return halved_regions(photos, shapes)
    return regions(shapes, photos.centres)
