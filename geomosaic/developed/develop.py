"""Developed images of facades, towers and domes: orthos and mosaics on developable surfaces."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geomosaic.block.block import OrientedBlock, OrientedImage
from geomosaic.developed.outlines import DevelopedFootprint, developed_footprint
from geomosaic.developed.surface_file import SurfaceFile, read_surface
from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.local_frames import is_free
from geomosaic.inputs.build import build_block
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.exterior_orientation import RECONSTRUCTIONS
from geomosaic.products.from_inputs import reference_of, refuse_existing
from geomosaic.render.extent import Area, check_size, output_grid
from geomosaic.sensor.developed import DevelopedModel
from geomosaic.sensor.registry import capabilities
from geomosaic.surface.developed.base import Axes
from geomosaic.surface.developed.placement import Developed
from geomosaic.surface.reference_surfaces import Plane

if TYPE_CHECKING:
    from geomosaic.geo.grid import Grid
    from geomosaic.mosaicking.result import MosaicResult
    from geomosaic.options.mosaic import MosaicOptions
    from geomosaic.render.ortho import OrthoResult


@dataclass(frozen=True)
class DevelopedResult:
    """Developed image, as an ortho of one image or a mosaic of several.

    Attributes
    ----------
    facts : dict
        The surface, see `SurfaceFile.facts`.
    notes : tuple of str
        On the surface and on the images' orientation.
    ortho : OrthoResult or None
        Where there is one image.
    mosaic : MosaicResult or None
        Where there are several.
    """

    facts: dict[str, Any]
    notes: tuple[str, ...]
    ortho: OrthoResult | None = None
    mosaic: MosaicResult | None = None


def make_developed(
    inputs: Block, surface: Path, area: Area, output: Path, options: MosaicOptions, oblique: float
) -> DevelopedResult:
    """Images drawn on a developed surface.

    Parameters
    ----------
    inputs : Block
        Images, sensor and orientation. Without a CRS their positions count in that of the surface file.
    surface : Path
        Surface file.
    area : Area
        Resolution and bounds in metres of the development; it has no other CRS.
    output : Path
    options : MosaicOptions
        The part `render` alone for one image.
    oblique : float
        Largest angle between line of sight and normal that is drawn, degrees.

    Returns
    -------
    DevelopedResult

    Raises
    ------
    InputError
        A camera stands on the wrong side, an image shows nothing of the surface, or an input does not fit it.
    GeomosaicError
        Otherwise as for orthos and mosaics; nothing is left under the final names.
    """
    for file in _outputs(output, len(inputs.images) > 1, options):
        refuse_existing(file, options.render.overwrite, inputs)
    if area.crs is not None:
        raise InputError("a developed surface has no CRS but its own", hint="leave out `dst_crs`")
    found = read_surface(surface)
    for file in found.files:
        if output.exists() and file.exists() and output.samefile(file):
            raise InputError("the output is one of the inputs", where=str(output), hint="give another name")
    block = build_block(_in_frame(inputs, found), ground=False)
    thing, turned = _towards(found, block)
    scenes = tuple(
        replace(scene, model=DevelopedModel(scene.model, thing, scene.sensor, oblique)) for scene in block.scenes
    )
    grid, outlines = _plan(scenes, area)
    notes = (*found.notes, *turned, *(note for scene in block.scenes for note in _said(scene, len(scenes) > 1)))
    facts = {**found.facts, **thing.to_dict()}
    # In the coordinates of the development, (u, v, height above the surface), the surface is a plane: rendering needs
    # no other.
    flat = Plane(thing.crs, 0.0)
    if len(scenes) == 1:
        from geomosaic.render.ortho import ortho

        one = ortho(scenes[0], flat, grid, outlines[0], output, options.render)
        return DevelopedResult(facts, notes, ortho=one)
    from geomosaic.mosaicking.mosaic import mosaic

    several = mosaic(
        OrientedBlock(scenes, flat),
        grid,
        list(outlines),
        output,
        options,
        reference=reference_of(options, inputs.bands),
    )
    return DevelopedResult(facts, notes, mosaic=several)


def _outputs(output: Path, several: bool, options: MosaicOptions) -> list[Path]:
    from geomosaic.mosaicking.outputs import MosaicFiles

    return [output, *MosaicFiles.of(output, options).companions] if several else [output]


def _in_frame(inputs: Block, found: SurfaceFile) -> Block:
    """Inputs with their positions in the surface's CRS, where they name none."""
    if inputs.dem is not None or inputs.height is not None:
        raise InputError("a DEM or a height has no part in a developed surface", hint="leave out `dem` and `height`")
    # Photos of facades and domes look level or up, which sensors refuse as a mistake unless told.
    if "upwards" not in inputs.options and capabilities(inputs.sensor).upwards:
        inputs = replace(inputs, options={**inputs.options, "upwards": True})
    if inputs.crs is not None or (inputs.angles in RECONSTRUCTIONS and is_free(found.crs)):
        return inputs
    return replace(inputs, crs=found.crs.to_wkt())


def _towards(found: SurfaceFile, block: OrientedBlock) -> tuple[Developed, list[str]]:
    """Surface turned to the cameras: a fitted plane without a declared side faces the first one."""
    if found.facing:
        return found.surface, []
    scene = block.scenes[0]
    origin = DevelopedModel(scene.model, found.surface, scene.sensor).origin()
    if origin is None:
        raise InputError(
            "nothing says which side of the plane is looked at", where=str(found.path), hint="give normal, roughly"
        )
    axes = found.surface.axes
    if found.surface.coordinates(origin[None])[0, 2] < 0.0:
        axes = Axes.facing(axes.origin, -axes.rotation[2], axes.rotation[1], str(found.path))
    normal = ", ".join(f"{value:+.4f}" for value in axes.rotation[2])
    return replace(found.surface, axes=axes), [f"the plane is looked at from the side of {scene.name}: normal {normal}"]


def _plan(scenes: tuple[OrientedImage, ...], area: Area) -> tuple[Grid, list[DevelopedFootprint]]:
    """Outlines of the images and the grid of the output, which ends where the development does."""
    outlines, models = [], []
    for scene in scenes:
        model = scene.model
        if isinstance(model, DevelopedModel):
            models.append(model)
            outlines.append(developed_footprint(scene, model))
    crs = horizontal(models[0].crs)
    wide = max(float(np.ptp(outline.ring, axis=0).max()) for outline in outlines)
    if area.resolution is not None and area.resolution > wide:
        raise InputError(
            f"one pixel of {area.resolution:g} m would be larger than all the images show, {wide:.3g} m",
            hint="the resolution counts in metres on the surface",
        )
    grid = output_grid(crs, list(outlines), area.resolution, area.bounds, snap=area.snap)
    check_size(grid)
    return grid, outlines


def _said(scene: OrientedImage, several: bool) -> list[str]:
    """Notes of an image, with its name where there are several."""
    notes = [str(note) for note in getattr(scene.model, "notes", ())]
    return [f"{scene.name}: {note}" for note in notes] if several else notes
