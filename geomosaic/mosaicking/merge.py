"""Mosaic by rule, without seams: what `rio merge` does, for images of any CRS and pixel size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from geomosaic.block.block import OrientedBlock, OrientedImage
from geomosaic.block.footprint import Footprint
from geomosaic.digests import sha256
from geomosaic.geo.grid import Grid
from geomosaic.mosaicking.blending.rules import SINGLE_SOURCE_RULES, RuleBlender, output_info
from geomosaic.mosaicking.colour.corrections import corrections
from geomosaic.mosaicking.colour.solve import colour_balance
from geomosaic.mosaicking.outputs import MosaicFiles
from geomosaic.mosaicking.provenance import source_facts
from geomosaic.mosaicking.records import SourceImages, gains, write_item, write_vectors
from geomosaic.mosaicking.rendering import render_mosaic
from geomosaic.mosaicking.result import MosaicResult, Timer
from geomosaic.mosaicking.seams.voronoi import image_order
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.render.dem_gaps import height_notes
from geomosaic.render.ortho import samples
from geomosaic.render.photo import Rectifier
from geomosaic.render.photos import Photos
from geomosaic.resample.engine import engine_for
from geomosaic.sensor.map_to_image import Ground


def merge(
    block: OrientedBlock,
    grid: Grid,
    outlines: list[Footprint],
    output: Path,
    options: MosaicOptions,
    *,
    reference: OrientedImage | None = None,
    about: Mapping[str, Mapping[str, Any]] | None = None,
) -> MosaicResult:
    """Mosaic in which `options.merge.rule` makes each pixel from all images that show it.

    Parameters
    ----------
    block : OrientedBlock
    grid : Grid
        Of the output.
    outlines : list of Footprint
        One per scene, in the output map.
    output : Path
    options : MosaicOptions
        Its seams and blending play no part.
    reference : OrientedImage, optional
        Georeferenced raster that colours are matched to.
    about : mapping of str to mapping, optional
        Further facts of the images by name.

    Returns
    -------
    MosaicResult
        Under rules other than first and last, `pixels` counts for each image the pixels that no image before it shows.

    Raises
    ------
    InputError
        An unknown order or image, or no image shows anything of the output.
    OutputError
        Writing failed.
    """
    from shapely import Polygon

    rule, render = options.merge.rule or "", options.render
    order = image_order(block.scenes, outlines, options.merge.order, None)
    if options.merge.base is not None:
        # The base lies lowest: last where the first image has precedence, first where the last one has.
        with_base = image_order(block.scenes, outlines, options.merge.order, options.merge.base)
        order = with_base if rule != "last" else [with_base[-1], *with_base[:-1]]
    files = MosaicFiles.of(output, options, grid)
    if rule not in SINGLE_SOURCE_RULES:
        files = replace(files, labels=None)
    files.check(overwrite=render.overwrite)
    seconds: dict[str, float] = {}
    photos = Photos(block, grid, outlines, render.memory_limit // 2, options.samples, render.resampling)
    try:
        with Timer(seconds, "balance"):
            solved = colour_balance(photos, options, reference)
        ground = Ground.under(grid, block.surface)
        engine = engine_for(samples(grid, outlines), render.resampling)
        rectifier = Rectifier(engine, grid, render.resampling, render.tolerance)
        info = output_info(photos.info, rule)
        blender = RuleBlender(photos, ground, corrections(solved), rectifier, rule, order, info)
        with Timer(seconds, "mosaic"):
            pixels = render_mosaic(blender, files, options)
        photos.again()
        facts = source_facts(photos, about or {}) if files.vectors or files.item else {}
    finally:
        photos.close()
    with Timer(seconds, "records"):
        if files.vectors is not None:  # footprints alone: there are no seams
            sources = SourceImages(outlines, [Polygon() for _ in outlines], pixels.by_image, solved, facts)
            write_vectors(files.vectors, grid, sources, [], overwrite=render.overwrite)
        if files.item is not None:
            images, shapes = [Path(scene.path) for scene in block.scenes], [outline.polygon for outline in outlines]
            columns: dict[str, Sequence[Any]] = {**gains(solved), "pixels": pixels.by_image, **facts}
            write_item(files, grid, shapes, images, {output: sha256(output)}, columns, overwrite=render.overwrite)
    return MosaicResult(
        path=output,
        labels=files.labels,
        vectors=files.vectors,
        item=files.item,
        grid=grid,
        valid_pixels=pixels.valid,
        pixels=pixels.by_image,
        balance=solved,
        feather=0.0,
        lattice_error=pixels.geometry.error,
        tolerance=render.tolerance,
        scale=pixels.geometry.scale,
        seconds=seconds,
        notes=height_notes(ground, outlines),
    )
