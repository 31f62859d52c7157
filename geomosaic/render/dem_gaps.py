"""DEM gaps: places where a product stays empty because the surface has no heights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from geomosaic.block.footprint import Footprint
from geomosaic.geo.grid import Grid, Window
from geomosaic.interpolation import bilinear
from geomosaic.sensor.lattice import blocks
from geomosaic.sensor.map_to_image import BlockGround, Ground
from geomosaic.types import BoolArray, FloatArray

if TYPE_CHECKING:
    from shapely import Polygon


# Pixels of a grid up to which every one is looked at; of larger ones every second, fourth ... along either axis.
SAMPLES = 4_000_000
# Part of the side of what the images cover that is left out along its outline, as true as its corners only.
RIM = 0.004
NAMES = 3


def height_notes(ground: Ground, outlines: Sequence[Footprint]) -> tuple[str, ...]:
    """Notes on the parts of the output that stay empty for want of heights.

    Parameters
    ----------
    ground : Ground
        The surface under the output.
    outlines : sequence of Footprint
        Of the images, in the output map.

    Returns
    -------
    tuple of str
        One note on images that reach past the DEM, one on its holes, with places and a way to correct them.
    """
    surface: Any = ground.surface
    if surface is None or getattr(surface, "gaps", None) is None:
        return ()
    cut = [outline.name for outline in outlines if not outline.complete]
    notes = []
    if cut:
        rest = f" and {len(cut) - NAMES} more" if len(cut) > NAMES else ""
        what = "the image reaches" if len(outlines) == 1 else f"{len(cut)} of {len(outlines)} images reach"
        which = "" if len(outlines) == 1 else f" ({', '.join(cut[:NAMES])}{rest})"
        notes.append(
            f"{what} past the heights of the DEM{which}: what lies beyond is left out; give a DEM that covers it"
        )
    if surface.gaps:
        notes += _holes(ground, outlines)
    return tuple(notes)


def _holes(ground: Ground, outlines: Sequence[Footprint]) -> list[str]:
    import shapely

    grid = ground.grid
    covered = shapely.union_all([outline.polygon for outline in outlines]).intersection(shapely.box(*grid.bounds))
    inner = covered.buffer(-max(2 * max(grid.resolution), RIM * math.sqrt(covered.area)))
    shapely.prepare(inner)
    step = 2 ** max(0, math.ceil(math.log2(grid.width * grid.height / SAMPLES) / 2))
    found = [xy for block in blocks(grid.window) if len(xy := _without(ground, grid, block, inner, step))]
    pixels = sum(map(len, found)) * step**2
    if not pixels:
        return []
    x, y = max(found, key=len).mean(axis=0)
    share = 100 * pixels * grid.resolution[0] * grid.resolution[1] / covered.area
    digits = 2 if grid.crs.is_projected or grid.crs.is_engineering else 6
    about = "" if step == 1 else "about "
    return [
        f"the DEM has holes: {about}{pixels} pixels, {share:.2g} % of what the images cover, have no height and stay "
        f"empty, most of them about x {x:.{digits}f}, y {y:.{digits}f}; fill the DEM, for example with gdal_fillnodata"
    ]


def _without(ground: Ground, grid: Grid, block: Window, inner: Polygon, step: int) -> FloatArray:
    """Map places (N, 2) of the pixels of a block, within the outline, that have no height."""
    import shapely

    part = block.intersection(grid.window)
    corners = grid.crop(part).bounds
    if not inner.intersects(shapely.box(*corners)):
        return np.empty((0, 2))
    here = ground.block(part)
    if here.patch is not None and not np.isnan(here.patch.heights).any():
        return np.empty((0, 2))
    c, r = np.meshgrid(np.arange(part.col, part.stop_col, step), np.arange(part.row, part.stop_row, step))
    xy = grid.xy(np.column_stack([c.ravel() + 0.5, r.ravel() + 0.5]))
    xy = xy[_unknown(ground, here, xy)]
    places: FloatArray = xy[shapely.contains_xy(inner, xy[:, 0], xy[:, 1])]
    return places


def _unknown(ground: Ground, here: BlockGround, xy: FloatArray) -> BoolArray:
    """Whether the kernels find no height at map places (N, 2)."""
    if here.patch is None or ground.to_surface is None:
        return np.ones(len(xy), dtype=bool)
    rows, cols = here.patch.heights.shape
    t, (x, y) = here.patch.transform, ground.to_surface(xy).T
    node = np.column_stack([t.a * x + t.b * y + t.c, t.d * x + t.e * y + t.f]) - 0.5
    inside: BoolArray = np.all((node >= -0.5) & (node <= (cols - 0.5, rows - 0.5)), axis=1)
    node = np.clip(np.where(inside[:, None], node, 0.0), 0.0, (cols - 1.0, rows - 1.0))
    first = np.floor(node).astype(np.int64)
    unknown: BoolArray = ~inside | np.isnan(bilinear(here.patch.heights, first, node - first))
    return unknown
