"""Choice of the blender, and the width of the transition across seams, from the noise of the images."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from geomosaic.estimation.statistics import MAD_TO_SIGMA
from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.units import linear_unit
from geomosaic.mosaicking.blending.block import Blender
from geomosaic.mosaicking.seams.voronoi import inner_edges, shared_edges, voronoi_regions
from geomosaic.options.mosaic import BlendOptions, Width
from geomosaic.render.photos import MemoryBudget
from geomosaic.resample.pyramid import reduce
from geomosaic.resample.warp import Target
from geomosaic.types import FloatArray

# Side in pixels of a place at which two images are compared.
SIDE = 128
# Largest number of places: enough for a median.
MAX_PLACES = 48
# Few digits, so that a small change of one image leaves the noise, and with it all pixels of other images, the same.
_DIGITS = 2


def image_noise(blender: Blender) -> float:
    """Noise of a block: standard deviation of the difference of two corrected images of the same ground.

    Parameters
    ----------
    blender : Blender

    Returns
    -------
    float
        Grey values; the median over places, but at least rounding: half of 1 for integers, 1e-4 of the values for
        others. Infinite where nothing could be compared.
    """
    # At half the resolution. Where neighbours meet, up to three places of 128 × 128 pixels are compared for each pair,
    # 48 for all. In each, the median difference is colour; the median distance from it, as a standard
    # deviation, is noise.
    found = []
    # Along Voronoi borders, not along the seams: an edited seam must not change what is blended elsewhere.
    places = _places(voronoi_regions(blender.seams.outlines, blender.photos.centres), blender.seams.outlines)
    step = max(1, -(-len(places) // MAX_PLACES))
    for i, j, x, y in places[::step]:
        spread = _difference_noise(blender, i, j, np.array([[x, y]]))
        if spread is not None:
            found.append(spread)
    return float(f"{np.median(found):.{_DIGITS}g}") if found else math.inf


def _places(regions: Sequence[Any], outlines: Sequence[Any]) -> list[tuple[int, int, float, float]]:
    """Pairs of images that share ground, and places along the middle of it in the output map."""
    import shapely

    tree = shapely.STRtree(list(outlines))
    places = []
    for i, outline in enumerate(outlines):
        for j in sorted(int(k) for k in tree.query(outline, predicate="intersects")):
            if j <= i or regions[i].is_empty or regions[j].is_empty:
                continue
            line = shapely.intersection(regions[i], regions[j]).intersection(outline)
            shared = shapely.intersection(outline, outlines[j])
            if line.length > 0:
                points = (
                    [line.interpolate(t, normalized=True) for t in (0.25, 0.5, 0.75)]
                    if hasattr(line, "interpolate") and line.geom_type == "LineString"
                    else [line.representative_point()]
                )
            elif shared.area > 0:
                points = [shared.representative_point()]
            else:
                continue
            places += [(i, j, float(point.x), float(point.y)) for point in points]
    return places


def _difference_noise(blender: Blender, i: int, j: int, xy: FloatArray) -> float | None:
    """Robust standard deviation of the difference of two images at a place; None where they share too little."""
    col, row = np.floor(blender.grid.colrow(xy)[0]).astype(int)
    window = Window(int(col) - SIDE // 2, int(row) - SIDE // 2, SIDE, SIDE)
    ground = blender.ground.block(window)
    views = []
    for index in (i, j):
        values = np.zeros((SIDE, SIDE, blender.photos.info.bands), dtype=np.float32)
        valid = np.zeros((SIDE, SIDE), dtype=np.uint8)
        with blender.photos.using(index) as photo:
            blender.rectifier.fill(photo, ground, blender.colours[index], Target(values, valid))
        views.append((values, valid > 0))
    both = (views[0][1] & views[1][1])[None].astype(np.float32)
    weight = reduce(both)[0]
    known = weight == 1.0
    if known.sum() < SIDE:
        return None
    apart = reduce(np.moveaxis(views[0][0] - views[1][0], 2, 0) * both)[:, known].T
    apart = apart - np.median(apart, axis=0)
    # Rounding is noise as well: two flat images differ by nothing, and any difference would count as moved.
    whole = np.issubdtype(np.dtype(blender.photos.info.dtype), np.integer)
    least = 0.5 if whole else 1e-4 * float(np.abs(views[0][0][views[0][1]]).mean())
    return max(least, float(MAD_TO_SIGMA * np.median(np.abs(apart))))


def with_blending(blender: Blender, memory: int, order: Sequence[int] = ()) -> Blender:
    """Blender of the kind that its blending options ask for.

    Parameters
    ----------
    blender : Blender
        Plain; `seams.feather` is the width of the transition in output pixels.
    memory : int
        Bytes that a multiband blender may hold for what images show of a block.
    order : sequence of int
        Numbers of the images, the uppermost first, where their edges are feathered.

    Returns
    -------
    Blender
        The same one for feathers and hard seams, else a `MultibandBlender`.
    """
    if blender.blending.plain:
        return blender
    # Imported where needed: few mosaics are blended in bands.
    from geomosaic.mosaicking.blending.multiband import MultibandBlender

    kind = blender.blending.blend
    return MultibandBlender(
        **{**vars(blender), "seams": replace(blender.seams, feather=0.0)},
        width=blender.seams.feather,
        noise=image_noise(blender) if blender.blending.limits else None,
        budget=MemoryBudget(memory),
        edges=inner_edges(blender.seams.outlines) if kind in ("edge", "cutline") else (),
        lines=shared_edges(blender.seams.polygons) if kind == "cutline" else (),
        order=order if kind == "edge" else (),
    )


# Width unless one is given.
PIXELS = 32.0


def width_px(width: Width, grid: Grid) -> float:
    """Width of a transition in pixels of a grid.

    Parameters
    ----------
    width : Width
        Value with its unit: pixels, metres, or map units.
    grid : Grid
        Of the output. In a geographic CRS a metre is converted at the grid's middle latitude.

    Returns
    -------
    float
        Pixels, by the geometric mean of both sides of a pixel.
    """
    if width.unit == "px":
        return width.value
    x, y = grid.resolution
    size = x if x == y else math.sqrt(x * y)
    return width.value * (_units_per_metre(grid) if width.unit == "m" else 1.0) / size


def transition_px(options: BlendOptions, grid: Grid) -> float:
    """Width of the transition across seams in output pixels.

    Parameters
    ----------
    options : BlendOptions
    grid : Grid
        Of the output.

    Returns
    -------
    float
        0 for hard seams; infinite where images are blended over all that they share; `PIXELS` unless a width is given.
    """
    if options.blend == "none":
        return 0.0
    if options.feather is None:
        return math.inf if options.blend == "overlap" else PIXELS
    return width_px(options.feather, grid)


def _units_per_metre(grid: Grid) -> float:
    metres = linear_unit(grid.crs)
    if grid.crs.is_geographic:  # the mean of both axes
        bottom, top = grid.bounds[1::2]
        metres *= math.sqrt(max(0.01, float(np.cos(np.radians((bottom + top) / 2)))))
    return 1.0 / (metres or 1.0)
