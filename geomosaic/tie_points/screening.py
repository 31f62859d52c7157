"""Matches of pairs without those that are not of the ground, or lie in areas that are left out."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import shapely

from geomosaic.block_adjustment.start import StartBlock
from geomosaic.errors import InputError, counted, listed, warn
from geomosaic.geo.transform import Transform
from geomosaic.matching.features import Features
from geomosaic.matching.fixed_features import stationary
from geomosaic.matching.tracks import PairMatches
from geomosaic.matching.two_view import LEAST_MATCHES
from geomosaic.raster.vector import layer_names
from geomosaic.render.areas import AREAS, read_shapes
from geomosaic.sensor.solve import image_to_ground
from geomosaic.tie_points.footprints import surface_of
from geomosaic.types import BoolArray, FloatArray

# Matches of a pair by their numbers, from some features of both images; None where they show nothing in common.
Rematch = Callable[[int, int, Sequence[Features]], PairMatches | None]


def ground_matches(
    pairs: Sequence[PairMatches | None],
    found: Sequence[Features],
    fixed: Sequence[BoolArray],
    reach: FloatArray,
    rematch: Rematch,
) -> list[PairMatches]:
    """Matches of pairs without those of data strips, clocks, marks and scratches, and of areas that are left out.

    Parameters
    ----------
    pairs : sequence of PairMatches or None
    found : sequence of Features (M,)
    fixed : sequence of bool array (N,)
        Features of each that are not wanted.
    reach : array (M,)
        Pixels within which the place of a feature is found again.
    rematch : callable
        Matches of two images by their numbers, with the features that are left of all: where what stays is most of
        a pair, it has found the geometry of nothing.

    Returns
    -------
    list of PairMatches
        Those of which enough is left.
    """
    free = [each if not out.any() else each.select(~out) for each, out in zip(found, fixed, strict=True)]
    first = [each.first_of_places for each in found]
    kept = []
    for pair in pairs:
        if pair is None:
            continue
        i, j = pair.first, pair.second
        one, other = (first[k][pair.places[:, side]] for side, k in enumerate((i, j)))
        out: BoolArray = fixed[i][one] | fixed[j][other]
        if 2 * out.sum() > len(out):
            again = rematch(i, j, free)
            if again is None:
                continue
            # Numbers of places among those that are left, as numbers among all.
            own = [found[k].place[np.flatnonzero(~fixed[k])][free[k].first_of_places] for k in (i, j)]
            pair = replace(again, places=np.stack([own[s][again.places[:, s]] for s in (0, 1)], axis=1))
            one, other = (first[k][pair.places[:, side]] for side, k in enumerate((i, j)))
            out = np.zeros(len(one), dtype=bool)
        rest = np.flatnonzero(~out)
        apart = found[i].colrow[one[rest]], found[j].colrow[other[rest]]
        out[rest] = stationary(*apart, float(max(reach[i], reach[j])))
        if out.any():
            pair = replace(pair, places=pair.places[~out], cost=pair.cost[~out])
        if len(pair.places) >= LEAST_MATCHES:
            kept.append(pair)
    return kept


def area_test(start: StartBlock, areas: Path) -> Callable[[int, FloatArray], BoolArray]:
    """Test of pixels (N, 2) of an image, by its number, for areas of the ground, after orientation and surface.

    Parameters
    ----------
    start : StartBlock
    areas : Path
        Vector file of polygons.

    Raises
    ------
    InputError
        It cannot be read, or no image has an orientation.
    """
    if not start.oriented.any():
        what = "no image has an orientation, so that nothing tells what of it lies in these areas"
        hint = "give positions and angles (`exterior`), or polygons in the images (`usable`)"
        raise InputError(what, where=f"`leave_out` {areas}", hint=hint)
    shapes = shapely.union_all(read_shapes(areas, layer_names(areas)[0], start.ground, AREAS))
    shapely.prepare(shapes)
    bare = [name for name, oriented in zip(start.names, start.oriented.tolist(), strict=True) if not oriented]
    if bare:
        text = f"{counted(len(bare), 'image')} without an orientation, in which no area is left out: {listed(bare, 6)}"
        warn(text)

    def in_areas(image: int, colrow: FloatArray) -> BoolArray:
        if not start.oriented[image] or not len(colrow):
            return np.zeros(len(colrow), dtype=bool)
        surface = surface_of(start, start.models[image])
        ground = image_to_ground(start.models[image], colrow, surface)
        xy = Transform(surface.crs, start.ground)(ground)[:, :2]
        found: BoolArray = shapely.contains_xy(shapes, xy[:, 0], xy[:, 1])
        return found

    return in_areas
