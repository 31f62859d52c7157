"""How much images of the same ground differ as a rule: what is much more than that is not the same ground."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from geomosaic.geo.grid import Window
from geomosaic.mosaicking.blending.block import Blender
from geomosaic.mosaicking.seams.voronoi import voronoi_regions
from geomosaic.render.photo import pull
from geomosaic.resample.pyramid import reduce
from geomosaic.types import FloatArray

SIDE = 128
"""Pixels of a place at which two images are compared."""
MOST = 48
"""Places."""
_DIGITS = 2


def usual_difference(blender: Blender) -> float:
    """Standard deviation of the difference of two corrected images of the same ground, at half the resolution.

    Where neighbours meet, up to three places of 128 × 128 pixels are compared for each pair, 48 for all. In each, the
    median difference is colour; the median distance from it, times 1.4826 (Huber, 1981), is noise. The median over
    places is given, to two digits, so that the change of one image does not change it; but not less than rounding
    makes: half of 1 for whole numbers, 1e-4 of the values for others. Infinite where nothing could be compared.
    """
    found = []
    # Not where seams are now: an edited seam is not to change what is blended elsewhere.
    places = _places(voronoi_regions(blender.seams.outlines, blender.photos.centres), blender.seams.outlines)
    step = max(1, -(-len(places) // MOST))
    for i, j, x, y in places[::step]:
        spread = _spread(blender, i, j, np.array([[x, y]]))
        if spread is not None:
            found.append(spread)
    return float(f"{np.median(found):.{_DIGITS}g}") if found else math.inf


def _places(regions: Sequence[Any], outlines: Sequence[Any]) -> list[tuple[int, int, float, float]]:
    """Pairs of images that share ground, and places along the middle of it."""
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


def _spread(blender: Blender, i: int, j: int, xy: FloatArray) -> float | None:
    col, row = np.floor(blender.grid.colrow(xy)[0]).astype(int)
    window = Window(int(col) - SIDE // 2, int(row) - SIDE // 2, SIDE, SIDE)
    ground = blender.below.block(window)
    views = []
    for index in (i, j):
        values = np.zeros((SIDE, SIDE, blender.photos.info.bands), dtype=np.float32)
        valid = np.zeros((SIDE, SIDE), dtype=np.uint8)
        with blender.photos.using(index) as photo:
            pull(
                blender.engine, photo, blender.grid, ground, blender.resampling, blender.tolerance,
                blender.colours[index], values, valid,
            )  # fmt: skip
        views.append((values, valid > 0))
    both = (views[0][1] & views[1][1])[None].astype(np.float32)
    weight = reduce(both)[0]
    known = weight == 1.0
    if known.sum() < SIDE:
        return None
    apart = reduce(np.moveaxis(views[0][0] - views[1][0], 2, 0) * both)[:, known].T
    apart = apart - np.median(apart, axis=0)
    whole = np.issubdtype(np.dtype(blender.photos.info.dtype), np.integer)
    least = 0.5 if whole else 1e-4 * float(np.abs(views[0][0][views[0][1]]).mean())
    return max(least, float(1.4826 * np.median(np.abs(apart))))
