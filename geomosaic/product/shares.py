"""Which image shows which ground."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from geomosaic.product.corrections import Correction
from geomosaic.product.layers import by_rank, under
from geomosaic.product.options import MosaicOptions
from geomosaic.product.order import index_of, ordered
from geomosaic.product.photos import Photos
from geomosaic.seam.voronoi import regions


def shares_of(photos: Photos, shapes: list[Any], colours: Sequence[Correction], options: MosaicOptions) -> list[Any]:
    """Share of the ground of each image, as the options have it; shares are disjoint."""
    if options.seams == "alike":
        from geomosaic.product.seam_layers import read_seam_layers
        from geomosaic.product.seams import alike_regions

        layers = read_seam_layers(options.follow, options.avoid, photos.grid.crs)
        shares = alike_regions(photos, shapes, colours, options.render, options.seam_weights, layers)
    elif options.seams == "halve":
        from geomosaic.product.seams import halved_regions

        shares = halved_regions(photos, shapes)
    elif options.seams == "order":
        shares = by_rank(shapes, ordered(photos.block.scenes, photos.outlines, options.order, options.base))
    elif options.base is not None:
        base = index_of(options.base, photos.block.scenes)
        centres = [outline.centre for outline in photos.outlines]
        shares = under(regions(shapes[:base] + shapes[base + 1 :], centres[:base] + centres[base + 1 :]), shapes, base)
    else:
        shares = regions(shapes, [outline.centre for outline in photos.outlines])
    if options.cutlines is None:
        return shares
    from geomosaic.product.cutlines import read_cutlines
    from geomosaic.seam.cutlines import with_cutlines

    names = [outline.name for outline in photos.outlines]
    return with_cutlines(shares, read_cutlines(options.cutlines, names, shapes, photos.grid.crs))
