"""One ortho or one mosaic from plain declarations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from pyproj import CRS

from geomosaic.block.footprint import Footprint
from geomosaic.block.scene import Scene
from geomosaic.errors import InputError, OutputExistsError
from geomosaic.geo.crs import parse_map
from geomosaic.geo.grid import Bounds, Grid
from geomosaic.product.extent import check_size, footprints, output_crs, output_grid
from geomosaic.project.build import build_block
from geomosaic.project.inputs import BlockInputs
from geomosaic.surface.model import Surface

if TYPE_CHECKING:
    from geomosaic.product.mosaic import MosaicResult
    from geomosaic.product.options import MosaicOptions, RenderOptions
    from geomosaic.product.ortho import OrthoResult


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
    check_size(grid)
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
