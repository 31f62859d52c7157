"""Mosaics: many images to one, of oriented images or of photos placed together by plane transformations."""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from geomosaic.block import OrientedBlock, OrientedImage
from geomosaic.errors import InputError
from geomosaic.execution.units import workers_for
from geomosaic.geo.grid import Bounds, Grid
from geomosaic.inputs.area import note_scattered, plan, plan_mosaic
from geomosaic.inputs.bands import check_same_bands
from geomosaic.inputs.build import build_block, join_blocks, refuse_unused_ground
from geomosaic.inputs.declarations import Block, as_blocks, on_ground
from geomosaic.inputs.orientation_covariance import with_covariances, with_sigmas
from geomosaic.mosaicking.mosaic import mosaic as render_mosaic
from geomosaic.mosaicking.outputs import MosaicFiles
from geomosaic.mosaicking.precedence import with_panchromatic
from geomosaic.mosaicking.records import MosaicResult
from geomosaic.options.inputs import Area, PlanarInputs
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.products.orthos import place_by_control, placement_files, position_target, refuse_ground
from geomosaic.raster.files import check_output, companion
from geomosaic.raster.info import inspect
from geomosaic.render.extent import footprints
from geomosaic.sensor.registry import plane_sensor
from geomosaic.stores.path import to_path
from geomosaic.surface.dem import Dem
from geomosaic.types import PathLike
from geomosaic.whole_files import path_of, write_atomic


def mosaic(
    images: Block | OrientedBlock | Sequence[Block | PathLike] | PathLike,
    output: PathLike,
    *,
    dem: PathLike | Dem | float | None = None,
    dem_heights: str | None = None,
    dst_crs: str | None = None,
    resolution: float | None = None,
    bounds: Bounds | None = None,
    like: PathLike | Grid | None = None,
    **options: Any,
) -> MosaicResult:
    """Mosaic of raw or georeferenced images, each pixel resampled once.

    Parameters
    ----------
    images : Block, sequence of Block or path, path, or OrientedBlock
        A block with its orientation, or several of different sensors over one ground; paths of georeferenced images;
        the block of an adjustment, `AdjustedBlock.block()`.
    output : path
        GeoTIFF to write; labels, vectors and the STAC item go beside it.
    dem, dem_heights, dst_crs, resolution, bounds, like
        See `ortho`.
    **options
        Of `MosaicOptions`, which is composed of `RenderOptions`, `ColourOptions`, `SeamOptions`, `BlendOptions` and
        others: flat, such as `blend="multiband", threads=2`, or whole, such as `blending=BlendOptions("multiband")`.

    Returns
    -------
    MosaicResult
        With gains, accuracies and what was written; `read()` gives the pixels.

    Raises
    ------
    GeomosaicError
        InputError, OutputError, SensorError or SolveError; nothing is left under the output's names.
    """
    place, wanted = Area(dst_crs, resolution, bounds, like=like), MosaicOptions.of(**options)
    with workers_for(wanted.render):
        return _mosaic(images, (dem, dem_heights), place, path_of(output, "output"), wanted)


def _mosaic(
    images: Block | OrientedBlock | Sequence[Block | PathLike] | PathLike,
    ground: tuple[PathLike | Dem | float | None, str | None],
    place: Area,
    output: Path,
    wanted: MosaicOptions,
) -> MosaicResult:
    """Mosaic of whatever images are; `ground` is the DEM, and what its heights refer to."""
    if isinstance(images, OrientedBlock):
        refuse_ground(*ground)
        return _mosaic_oriented(images, place, output, wanted)
    blocks = tuple(on_ground(block, *ground) for block in as_blocks(images))
    planar = next((block.planar for block in blocks if block.planar is not None), None)
    if planar is None:
        return make_mosaic(blocks, place, output, wanted)
    if len(blocks) > 1:
        raise InputError(
            "photos that are placed together make a mosaic by themselves",
            where="`kind`",
            hint="make them alone, and mosaic the result with the others",
        )
    return make_planar_mosaic(blocks[0], planar, place, output, wanted)


def check_outputs(output: Path, options: MosaicOptions, inputs: Iterable[Path], more: Iterable[Path] = ()) -> None:
    """Check of the names of a mosaic and its companions.

    Parameters
    ----------
    output : Path
    options : MosaicOptions
    inputs : iterable of Path
        Files that are read.
    more : iterable of Path
        Other files that are written.

    Raises
    ------
    OutputExistsError, InputError
        See `check_output`.
    """
    read = tuple(inputs)
    # All files at once, before any is made: half a set of outputs would be left otherwise.
    files = MosaicFiles.of(output, options)
    options = files.going_on(options)
    files.check_name(options, read)
    for file in (*files.companions, *more):
        check_output(file, overwrite=options.render.overwrite, inputs=read)


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


def make_mosaic(inputs: Block | Sequence[Block], area: Area, output: Path, options: MosaicOptions) -> MosaicResult:
    """Mosaic of all images of `inputs`.

    Parameters
    ----------
    inputs : Block or sequence of Block
        Several for images of different sensors or cameras; they share one ground.
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
    parts = (inputs,) if isinstance(inputs, Block) else tuple(inputs)
    placement = placement_files(parts[0], output) if len(parts) == 1 else ()
    check_outputs(output, options, [file for part in parts for file in part.files], placement)
    wanted = options.uncertainty
    refuse_unused_ground(parts, uses_surface=options.uses_surface)
    built = [build_block(part, dem_memory=options.render.dem_memory) for part in parts]
    if wanted.accuracy:
        built = [with_covariances(part, each, wanted.sigmas) for part, each in zip(parts, built, strict=True)]
    block = join_blocks(parts, built)
    made = _rendered(block, area, output, options, parts[0].bands)
    facts = place_by_control(parts[0], block, output) if placement else None
    return made if facts is None else replace(made, placement=facts, placement_file=placement[0])


def _mosaic_oriented(block: OrientedBlock, area: Area, output: Path, options: MosaicOptions) -> MosaicResult:
    """Mosaic of images whose models are known, those of an adjustment for example; see `make_mosaic`."""
    check_outputs(output, options, [to_path(scene.path) for scene in block.scenes])
    if options.uncertainty.accuracy and options.uncertainty.sigmas:
        scenes = tuple(with_sigmas(scene, options.uncertainty.sigmas) for scene in block.scenes)
        block = replace(block, scenes=scenes)
    return _rendered(block, area, output, options, block.scenes[0].bands)


def _rendered(
    block: OrientedBlock, area: Area, output: Path, options: MosaicOptions, bands: Sequence[int] | None
) -> MosaicResult:
    target = position_target(options.uncertainty)
    block = with_common_bands(block, options)
    grid, outlines = plan_mosaic(block.scenes, block.surface, area, partial(footprints, running=options.render))
    note_scattered(grid, outlines)
    made = render_mosaic(block, grid, outlines, output, options, reference=reference_of(options, bands))
    return made if made.accuracy is None else replace(made, accuracy=replace(made.accuracy, target=target))


def with_common_bands(block: OrientedBlock, options: MosaicOptions) -> OrientedBlock:
    """Block whose images have the same bands, those of a panchromatic image among several bands being one.

    Parameters
    ----------
    block : OrientedBlock
    options : MosaicOptions

    Returns
    -------
    OrientedBlock

    Raises
    ------
    InputError
        Their bands differ otherwise.
    """
    infos = [inspect(scene.path, scene.bands) for scene in block.scenes]
    same = with_panchromatic(block, infos, options)
    if same is not block:
        infos = [inspect(scene.path, scene.bands) for scene in same.scenes]
    check_same_bands(same.scenes, infos)
    return same


def make_planar_mosaic(
    inputs: Block, wanted: PlanarInputs, area: Area, output: Path, options: MosaicOptions
) -> MosaicResult:
    """Mosaic of photos of flat ground, placed together by plane transformations.

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
    MosaicResult
        With `placement`; the same facts stand in NAME-placement.json beside the mosaic.
    """
    from geomosaic.accuracy.check_points import control_residuals
    from geomosaic.inputs.planar_block import build_planar
    from geomosaic.inputs.planar_facts import control_facts

    facts_path = companion(output, "-placement", ".json")
    check_outputs(output, options, inputs.files, [facts_path])
    block, placed = build_planar(inputs, wanted)
    facts = {**placed, **control_facts(control_residuals(block))}
    grid, outlines = plan(block.scenes, block.surface, area)
    result = render_mosaic(block, grid, outlines, output, options, reference=reference_of(options, inputs.bands))
    write_atomic(facts_path, json.dumps(facts, indent=1) + "\n")
    return replace(result, placement=facts, placement_file=facts_path)
