"""One ortho or one mosaic from plain declarations."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
from geomosaic.project.build import build_block
from geomosaic.project.inputs import BlockInputs, PlanarInputs
from geomosaic.raster.info import inspect
from geomosaic.raster.output import check_output
from geomosaic.surface.model import Surface

if TYPE_CHECKING:
    from geomosaic.product.mosaic_options import MosaicOptions
    from geomosaic.product.mosaic_result import MosaicResult
    from geomosaic.product.options import RenderOptions
    from geomosaic.product.ortho import OrthoResult


MANY_PIXELS, FINER = 10_000_000_000, 10.0
"""Pixels of an output, and how many times finer than the images they are, that together nobody can mean."""


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


def plan(scenes: Sequence[Scene], surface: Surface | None, area: Area) -> tuple[Grid, list[Footprint]]:
    """Outlines of the images and the grid of the output."""
    several = tuple(scenes)
    if area.like is not None:
        grid = grid_of(area.like)
        return grid, footprints(several, surface, grid.crs)
    crs: CRS = parse_map(area.crs, "output CRS") if area.crs else output_crs(several, surface)
    refuse_torn_crs(crs, several)
    outlines = footprints(several, surface, crs)
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


def refuse_existing(path: Path, overwrite: bool, inputs: BlockInputs | None = None) -> None:
    """Stop before any work where the output exists; an input is never written over, asked for or not."""
    read = () if inputs is None else (*inputs.images, *inputs.tables, *inputs.ground)
    if path.exists() and any(file.exists() and path.samefile(file) for file in read):
        raise InputError("the output is one of the inputs", where=str(path), mend="give another name for the output")
    check_output(path, overwrite=overwrite)


def make_ortho(inputs: BlockInputs, area: Area, output: Path, options: RenderOptions) -> OrthoResult:
    """Rectify the one image of `inputs`."""
    from geomosaic.product.ortho import ortho

    refuse_existing(output, options.overwrite, inputs)
    block = build_block(inputs)
    grid, outlines = plan(block.scenes, block.surface, area)
    return ortho(block.scenes[0], block.surface, grid, outlines[0], output, options)


def reference_scene(path: Path, bands: Sequence[int] | None) -> Scene:
    """Open a georeferenced raster as a scene, to match histograms to."""
    return build_block(BlockInputs((path,), "planar", bands=None if bands is None else tuple(bands))).scenes[0]


def make_mosaic(inputs: BlockInputs, area: Area, output: Path, options: MosaicOptions) -> MosaicResult:
    """Make a mosaic of all images of `inputs`."""
    from geomosaic.product.mosaic import beside, mosaic
    from geomosaic.project.bands import check_same_bands, with_named_bands
    from geomosaic.project.mosaic_grid import note_scattered, plan_mosaic

    named = (("-labels", ".tif", options.labels), ("", ".gpkg", options.vectors), ("", ".stac.json", options.stac))
    for file in (output, *(beside(output, mark, suffix) for mark, suffix, wanted in named if wanted)):
        refuse_existing(file, options.render.overwrite, inputs)
    block = build_block(inputs)
    if inputs.band_names is not None:
        block = replace(block, scenes=with_named_bands(block.scenes, inputs.band_names))
    check_same_bands(block.scenes)
    grid, outlines = plan_mosaic(block.scenes, block.surface, area)
    note_scattered(grid, outlines)
    return mosaic(block, grid, outlines, output, options)


def make_planar_mosaic(
    inputs: BlockInputs, wanted: PlanarInputs, area: Area, output: Path, options: MosaicOptions
) -> tuple[MosaicResult, dict[str, Any], Path]:
    """Place photos of flat ground together and make their mosaic.

    Returns
    -------
    result : MosaicResult
    facts : dict
        How the photos were placed, see `planar_facts`.
    path : Path
        Where the facts were written, beside the mosaic.
    """
    from geomosaic.product.checks.check import check_control
    from geomosaic.product.mosaic import beside, mosaic
    from geomosaic.project.atomic import write_atomic
    from geomosaic.project.planar.build import build_planar
    from geomosaic.project.planar.facts import control_facts

    facts_path = beside(output, "-placement", ".json")
    named = (("-labels", ".tif", options.labels), ("", ".gpkg", options.vectors), ("", ".stac.json", options.stac))
    companions = (beside(output, mark, suffix) for mark, suffix, wanted_too in named if wanted_too)
    for file in (output, facts_path, *companions):
        refuse_existing(file, options.render.overwrite, inputs)
    block, placed = build_planar(inputs, wanted)
    facts = {**placed, **control_facts(check_control(block))}
    grid, outlines = plan(block.scenes, block.surface, area)
    result = mosaic(block, grid, outlines, output, options)
    write_atomic(facts_path, json.dumps(facts, indent=1) + "\n")
    return result, facts, facts_path
