"""Where the output lies, as a user says it, and the grid that follows."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pyproj import CRS

from geomosaic.block.footprint import Footprint
from geomosaic.block.scene import Scene
from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal, parse_map
from geomosaic.geo.grid import Bounds, Grid
from geomosaic.product.extent import (
    check_size,
    footprints,
    note_far_crs,
    output_crs,
    output_grid,
    refuse_torn_crs,
)
from geomosaic.raster.info import inspect
from geomosaic.surface.model import Surface

MANY_PIXELS, FINER = 10_000_000_000, 10.0
"""Pixels of an output, and how many times finer than the images they are, that together nobody can mean."""

FindOutlines = Callable[[tuple[Scene, ...], Surface | None, CRS], list[Footprint]]


@dataclass(frozen=True)
class Area:
    """Where the output lies; what is not given follows from the images.

    Attributes
    ----------
    crs : str, optional
        CRS of the output.
    resolution : float, optional
        Pixel size in its units.
    bounds : tuple of float, optional
        Left, bottom, right, top in it.
    snap : bool
        Widen the bounds to whole multiples of the pixel size; without bounds that is always done.
    like : Path, optional
        Raster whose CRS, pixels and extent the output takes; nothing else is given then.
    """

    crs: str | None = None
    resolution: float | None = None
    bounds: Bounds | None = None
    snap: bool = False
    like: Path | None = None


def plan(
    scenes: Sequence[Scene], surface: Surface | None, area: Area, find: FindOutlines = footprints
) -> tuple[Grid, list[Footprint]]:
    """Outlines of the images, which `find` finds or remembers, and the grid of the output."""
    several = tuple(scenes)
    if area.like is not None:
        grid = grid_of(area.like)
        return grid, find(several, surface, grid.crs)
    crs: CRS = parse_map(area.crs, "output CRS") if area.crs else output_crs(several, surface)
    refuse_torn_crs(crs, several)
    outlines = find(several, surface, crs)
    _judge(crs, outlines, area.resolution)
    grid = output_grid(crs, outlines, area.resolution, area.bounds, snap=area.snap)
    check_size(grid)
    _check_fineness(grid, outlines)
    return grid, outlines


def grid_of(path: Path) -> Grid:
    """Grid of a georeferenced raster."""
    info = inspect(path)
    if info.crs is None or info.transform is None:
        raise InputError("the raster is not georeferenced", where=str(path), mend="name one that is")
    return Grid(horizontal(info.crs), info.transform, info.width, info.height)


def _check_fineness(grid: Grid, outlines: list[Footprint]) -> None:
    """Refuse what would take days and show nothing more than the images do: a pixel size in a wrong unit."""
    finest = min(outline.sampling for outline in outlines)
    pixel = grid.resolution[0]
    if grid.width * grid.height > MANY_PIXELS and finest > FINER * pixel:
        unit = grid.crs.axis_info[0].unit_name
        raise InputError(
            f"the output would have {grid.width} x {grid.height} pixels of {pixel:g} {unit}; the images show no more "
            f"than {finest:.3g}",
            mend=f"a pixel size of about {finest:.2g} {unit}, or smaller bounds",
        )


def _judge(crs: CRS, outlines: list[Footprint], resolution: float | None) -> None:
    """Refuse a pixel size in a wrong unit; say so where the output CRS is made for another part of the earth."""
    ring = np.vstack([outline.ring for outline in outlines])
    wide, tall = np.ptp(ring, axis=0)
    if resolution is not None and resolution > max(wide, tall):
        unit = crs.axis_info[0].unit_name
        raise InputError(
            f"one pixel of {resolution:g} {unit} would be larger than all the images show, {wide:.3g} x {tall:.3g}",
            mend=f"the resolution counts in units of the output CRS, {crs.name}: {unit}",
        )
    note_far_crs(crs, outlines)
