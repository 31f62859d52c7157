"""One ortho or one mosaic from plain declarations."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pyproj import CRS

from geomosaic.block.footprint import Footprint
from geomosaic.block.scene import Scene
from geomosaic.errors import InputError, OutputExistsError
from geomosaic.geo.crs import parse_map
from geomosaic.geo.grid import Bounds, Grid
from geomosaic.product.extent import footprints, output_crs, output_grid
from geomosaic.project.build import build_block
from geomosaic.project.inputs import BlockInputs, PlanarInputs
from geomosaic.surface.model import Surface

if TYPE_CHECKING:
    from geomosaic.product.mosaic import MosaicResult
    from geomosaic.product.options import MosaicOptions, RenderOptions
    from geomosaic.product.ortho import OrthoResult

# Rows, columns and tiles of a GeoTIFF are counted in 31 bits.
_MOST, _TILE = 1 << 31, 512 * 512


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
    """

    crs: str | None = None
    resolution: float | None = None
    bounds: Bounds | None = None


def plan(scenes: Sequence[Scene], surface: Surface | None, area: Area) -> tuple[Grid, list[Footprint]]:
    """Outlines of the images and the grid of the output."""
    several = tuple(scenes)
    crs: CRS = parse_map(area.crs, "output CRS") if area.crs else output_crs(several, surface)
    outlines = footprints(several, surface, crs)
    grid = output_grid(crs, outlines, area.resolution, area.bounds)
    if max(grid.width, grid.height) >= _MOST or grid.width * grid.height / _TILE >= _MOST:
        raise InputError(
            f"the output would have {grid.width:.3g} x {grid.height:.3g} pixels, more than a GeoTIFF can hold",
            mend=f"a coarser resolution or smaller bounds; one pixel is {grid.resolution[0]:g} map units now",
        )
    return grid, outlines


def refuse_existing(path: Path, overwrite: bool, inputs: BlockInputs | None = None) -> None:
    """Stop before any work where the output exists; an input is never written over, asked for or not."""
    read = () if inputs is None else (*inputs.images, *inputs.tables, *inputs.ground)
    if path.exists() and any(file.exists() and path.samefile(file) for file in read):
        raise InputError("the output is one of the inputs", where=str(path), mend="give another name for the output")
    if path.exists() and not overwrite:
        raise OutputExistsError("the output exists", where=str(path), mend="give another name, or --overwrite")
    if not path.absolute().parent.is_dir():
        raise InputError(
            "the folder of the output does not exist", where=str(path), mend="make it, or give another path"
        )


def make_ortho(inputs: BlockInputs, area: Area, output: Path, options: RenderOptions) -> OrthoResult:
    """Rectify the one image of `inputs`."""
    from geomosaic.product.ortho import ortho

    refuse_existing(output, options.overwrite, inputs)
    block = build_block(inputs)
    grid, outlines = plan(block.scenes, block.surface, area)
    return ortho(block.scenes[0], block.surface, grid, outlines[0], output, options)


def make_mosaic(inputs: BlockInputs, area: Area, output: Path, options: MosaicOptions) -> MosaicResult:
    """Make a mosaic of all images of `inputs`."""
    from geomosaic.product.mosaic import beside, mosaic

    named = (("-labels", ".tif", options.labels), ("", ".gpkg", options.vectors), ("", ".stac.json", options.stac))
    for file in (output, *(beside(output, mark, suffix) for mark, suffix, wanted in named if wanted)):
        refuse_existing(file, options.render.overwrite, inputs)
    block = build_block(inputs)
    grid, outlines = plan(block.scenes, block.surface, area)
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
    from geomosaic.product.check import check_control
    from geomosaic.product.mosaic import beside, mosaic
    from geomosaic.project.atomic import write_atomic
    from geomosaic.project.planar import build_planar
    from geomosaic.project.planar_facts import control_facts

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
