"""Orthos and mosaics from plain declarations of inputs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from geomosaic.block.block import OrientedImage
from geomosaic.inputs.area import plan
from geomosaic.inputs.build import build_block
from geomosaic.inputs.declarations import Block, PlanarInputs
from geomosaic.raster.output_files import check_output
from geomosaic.render.extent import Area
from geomosaic.sensor.registry import plane_sensor

if TYPE_CHECKING:
    from geomosaic.mosaicking.result import MosaicResult
    from geomosaic.options.mosaic import MosaicOptions
    from geomosaic.options.render import RenderOptions
    from geomosaic.render.ortho import OrthoResult


def refuse_existing(path: Path, overwrite: bool, inputs: Block | None = None) -> None:
    """Check, before any work, that an output may be written.

    Parameters
    ----------
    path : Path
    overwrite : bool
        Whether an existing file may be replaced; an input never is.
    inputs : Block, optional
        Whose files are read.

    Raises
    ------
    OutputExistsError
        The output exists.
    InputError
        The output is one of the inputs.
    """
    read = () if inputs is None else (*inputs.images, *inputs.tables, *inputs.ground)
    check_output(path, overwrite=overwrite, inputs=read)


def make_ortho(inputs: Block, area: Area, output: Path, options: RenderOptions) -> OrthoResult:
    """Ortho of the one image of `inputs`.

    Parameters
    ----------
    inputs : Block
    area : Area
        Its CRS, resolution and bounds, as far as they are given.
    output : Path
        GeoTIFF to write.
    options : RenderOptions

    Returns
    -------
    OrthoResult

    Raises
    ------
    GeomosaicError
        InputError, OutputError, SensorError or SolveError; nothing is left under the final name.
    """
    from geomosaic.render.ortho import ortho

    refuse_existing(output, options.overwrite, inputs)
    block = build_block(inputs)
    grid, outlines = plan(block.scenes, block.surface, area)
    return ortho(block.scenes[0], block.surface, grid, outlines[0], output, options)


def reference_of(options: MosaicOptions, bands: Sequence[int] | None) -> OrientedImage | None:
    """Georeferenced raster that colours are matched to, as a scene.

    Parameters
    ----------
    options : MosaicOptions
        The raster and its bands are `colours.reference` and `colours.reference_bands`.
    bands : sequence of int or None
        Bands of the images, counted from 1; those of the raster unless it has its own.

    Returns
    -------
    OrientedImage or None
        None where there is no reference.
    """
    path, bands = options.colours.reference, options.colours.reference_bands or bands
    if path is None:
        return None
    return build_block(Block((path,), plane_sensor(), bands=None if bands is None else tuple(bands))).scenes[0]


def make_mosaic(inputs: Block, area: Area, output: Path, options: MosaicOptions) -> MosaicResult:
    """Mosaic of all images of `inputs`.

    Parameters
    ----------
    inputs : Block
    area : Area
        Its CRS, resolution and bounds, as far as they are given.
    output : Path
        GeoTIFF to write; labels, vectors and the STAC item go beside it.
    options : MosaicOptions

    Returns
    -------
    MosaicResult

    Raises
    ------
    GeomosaicError
        InputError, OutputError, SensorError or SolveError; nothing is left under the final names.
    """
    from geomosaic.inputs.area import note_scattered, plan_mosaic
    from geomosaic.inputs.rasters import check_same_bands, with_named_bands
    from geomosaic.mosaicking.mosaic import mosaic
    from geomosaic.mosaicking.outputs import MosaicFiles

    # All files at once, before any is made: half a set of outputs would be left otherwise.
    for file in (output, *MosaicFiles.of(output, options).companions):
        refuse_existing(file, options.render.overwrite, inputs)
    block = build_block(inputs)
    if inputs.band_names is not None:
        block = replace(block, scenes=with_named_bands(block.scenes, inputs.band_names))
    check_same_bands(block.scenes)
    grid, outlines = plan_mosaic(block.scenes, block.surface, area)
    note_scattered(grid, outlines)
    return mosaic(block, grid, outlines, output, options, reference=reference_of(options, inputs.bands))


def make_planar_mosaic(
    inputs: Block, wanted: PlanarInputs, area: Area, output: Path, options: MosaicOptions
) -> tuple[MosaicResult, dict[str, Any], Path]:
    """Place photos of flat ground together and make their mosaic.

    Parameters
    ----------
    inputs : Block
    wanted : PlanarInputs
        How they are placed.
    area : Area
    output : Path
        GeoTIFF to write; labels, vectors, the STAC item and the facts go beside it.
    options : MosaicOptions

    Returns
    -------
    result : MosaicResult
    facts : dict
        How the photos were placed, see `planar_facts`.
    path : Path
        Where the facts were written, beside the mosaic.
    """
    from geomosaic.accuracy.product_check import check_control
    from geomosaic.inputs.planar.build import build_planar
    from geomosaic.inputs.planar.facts import control_facts
    from geomosaic.mosaicking.mosaic import mosaic
    from geomosaic.mosaicking.outputs import MosaicFiles, companion
    from geomosaic.whole_files import write_atomic

    facts_path = companion(output, "-placement", ".json")
    for file in (facts_path, output, *MosaicFiles.of(output, options).companions):
        refuse_existing(file, options.render.overwrite, inputs)
    block, placed = build_planar(inputs, wanted)
    facts = {**placed, **control_facts(check_control(block))}
    grid, outlines = plan(block.scenes, block.surface, area)
    result = mosaic(block, grid, outlines, output, options, reference=reference_of(options, inputs.bands))
    write_atomic(facts_path, json.dumps(facts, indent=1) + "\n")
    return result, facts, facts_path
