"""Output area and grid: CRS, bounds and pixel size as given, else from the images."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from affine import Affine
from pyproj import CRS

from geomosaic.block import Footprint, OrientedImage
from geomosaic.errors import InputError, warn
from geomosaic.geo.crs import horizontal, parse_map
from geomosaic.geo.grid import Grid
from geomosaic.geo.transform import Transform
from geomosaic.options.inputs import Area
from geomosaic.raster.info import inspect
from geomosaic.render.extent import (
    footprints,
    grid_of,
    note_far_crs,
    output_crs,
    output_grid,
    refuse_torn_crs,
)
from geomosaic.surface.model import Surface

# An output of so many pixels that is so many times finer than the images has its pixel size in a wrong unit.
_MANY_PIXELS, _FINER = 10_000_000_000, 10.0

FindOutlines = Callable[[tuple[OrientedImage, ...], Surface | None, CRS], list[Footprint]]


def plan(
    scenes: Sequence[OrientedImage], surface: Surface | None, area: Area, find: FindOutlines = footprints
) -> tuple[Grid, list[Footprint]]:
    """Output grid, and the outlines of the images in its CRS.

    Parameters
    ----------
    scenes : sequence of OrientedImage
    surface : Surface or None
        Ground; None for images without heights.
    area : Area
        CRS, bounds, pixel size and snapping, or a raster whose grid is taken; the images give what is not given.
    find : callable
        Outlines of images on a surface in a CRS; reruns give stored ones.

    Returns
    -------
    grid : Grid
    outlines : list of Footprint
        In the order of the images.

    Raises
    ------
    InputError
        The CRS has a discontinuity across the images, or the pixel size is implausible.
    """
    several = tuple(scenes)
    if area.like is not None:
        grid = grid_of(area.like)
        return grid, find(several, surface, grid.crs)
    crs: CRS = parse_map(area.dst_crs, "`dst_crs`") if area.dst_crs else output_crs(several, surface)
    refuse_torn_crs(crs, several)
    outlines = find(several, surface, crs)
    _check_unit(crs, outlines, area.resolution)
    grid = output_grid(crs, outlines, area.resolution, area.bounds, snap=area.snap)
    _check_fineness(grid, outlines)
    return grid, outlines


def _check_fineness(grid: Grid, outlines: list[Footprint]) -> None:
    """Check for a pixel size in a wrong unit, with which the work would take days."""
    finest = min(outline.sampling for outline in outlines)
    pixel = grid.resolution[0]
    if grid.width * grid.height > _MANY_PIXELS and finest > _FINER * pixel:
        unit = grid.crs.axis_info[0].unit_name
        raise InputError(
            f"the output would have {grid.width} x {grid.height} pixels of {pixel:g} {unit}; the images resolve no "
            f"more than {finest:.3g}",
            hint=f"a pixel size of about {finest:.2g} {unit}, or smaller bounds",
        )


def _check_unit(crs: CRS, outlines: list[Footprint], resolution: float | None) -> None:
    """Check of the pixel size's unit, and a warning where the output CRS is made for another part of the earth."""
    ring = np.vstack([outline.ring for outline in outlines])
    wide, tall = np.ptp(ring, axis=0)
    if resolution is not None and resolution > max(wide, tall):
        unit = crs.axis_info[0].unit_name
        raise InputError(
            f"one pixel of {resolution:g} {unit} would be larger than all images together, {wide:.3g} x {tall:.3g}",
            hint=f"the resolution counts in units of the output CRS, {crs.name}: {unit}",
        )
    note_far_crs(crs, outlines)


# Pixels. Rounding of geotransforms must not add a row or column to the grid.
_HAIR = 1e-3
# Share of a mosaic's area that disjoint images must cover; with less one of them has a wrong CRS, as a rule.
_SCATTERED = 0.02


def plan_mosaic(
    scenes: Sequence[OrientedImage], surface: Surface | None, area: Area, find: FindOutlines = footprints
) -> tuple[Grid, list[Footprint]]:
    """Output grid of a mosaic, and the outlines of the images in its CRS.

    Parameters
    ----------
    scenes, surface, area, find
        As `plan`.

    Returns
    -------
    grid : Grid
    outlines : list of Footprint
        In the order of the images.

    Raises
    ------
    InputError
        As `plan`.
    """
    # Where the first image is georeferenced in the output CRS, north up, and neither bounds nor another pixel size are
    # given, the grid is that of the first image, extended over all images, so that its pixels need no resampling. The
    # mosaic of images in degrees is in degrees unless a CRS is given.
    if surface is None and area == Area():
        first = inspect(scenes[0].path).crs
        if first is not None and first.is_geographic and _own_grid(scenes[0], horizontal(first)) is not None:
            area = replace(area, dst_crs=horizontal(first).to_wkt())
    grid, outlines = plan(scenes, surface, area, find)
    own = _own_grid(scenes[0], grid.crs) if surface is None and area.bounds is None and area.like is None else None
    if own is None or not (area.resolution is None or _same_size(own, area.resolution)):
        return grid, outlines
    return _extended(own, outlines), outlines


def _own_grid(scene: OrientedImage, output: CRS) -> Grid | None:
    """Grid of an image that lies as its file says, in the output's CRS and north up."""
    info = inspect(scene.path)
    t = info.transform
    if len(scene.model.crs.axis_info) != 2 or t is None or info.crs is None or t.b or t.d or t.a <= 0 or t.e >= 0:
        return None
    # Equal coordinates, not equal definitions: one CRS may be written in several ways.
    crs = horizontal(info.crs)
    grid = Grid(crs, t, info.width, info.height)
    corners = np.array([[0.0, 0.0], [info.width, info.height]])
    place = grid.xy(corners)
    with np.errstate(invalid="ignore"):
        elsewhere = not np.array_equal(Transform(crs, output)(place), place)
    if elsewhere:
        return None
    image = scene.model.ground_to_image(np.column_stack([place, np.zeros(2)]))
    return grid if np.abs(image - corners).max() < _HAIR else None


def _same_size(grid: Grid, resolution: float) -> bool:
    return all(math.isclose(size, resolution, rel_tol=1e-9) for size in grid.resolution)


def _extended(grid: Grid, outlines: Sequence[Footprint]) -> Grid:
    """Grid of the same pixels, extended over all outlines."""
    ends = []
    for outline in outlines:
        left, bottom, right, top = outline.bounds
        ends.append(grid.colrow(np.array([[left, top], [right, bottom]])))
    each = np.array(ends)
    col, row = (int(v) for v in np.floor(each[:, 0].min(axis=0) + _HAIR))
    stop_col, stop_row = (int(v) for v in np.ceil(each[:, 1].max(axis=0) - _HAIR))
    t = grid.transform
    corner = Affine(t.a, 0.0, t.c + col * t.a, 0.0, t.e, t.f + row * t.e)
    return Grid(grid.crs, corner, max(1, stop_col - col), max(1, stop_row - row))


def note_scattered(grid: Grid, outlines: Sequence[Footprint]) -> None:
    """Warning about images so far apart that the mosaic is nearly empty.

    Parameters
    ----------
    grid : Grid
        Grid of the mosaic.
    outlines : sequence of Footprint
        Outlines in the CRS of the grid.
    """
    left, bottom, right, top = grid.bounds
    area = sum((b[2] - b[0]) * (b[3] - b[1]) for b in (outline.bounds for outline in outlines))
    if len(outlines) < 2 or area >= _SCATTERED * (right - left) * (top - bottom):
        return
    middle = np.median([outline.centre for outline in outlines[:-1] or outlines], axis=0)
    far = max(outlines, key=lambda outline: float(np.hypot(*(np.array(outline.centre) - middle))))
    warn(
        f"the images share no ground and cover {100 * area / ((right - left) * (top - bottom)):.1g} % of the mosaic: "
        f"'{far.name}' lies {float(np.hypot(*(np.array(far.centre) - middle))):.6g} map units from the others; "
        "check its CRS and geotransform, or give `bounds`"
    )
