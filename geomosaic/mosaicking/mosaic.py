"""Mosaic of a block from colours to records, rendered in units computed in parallel or kept from an earlier run."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geomosaic.block import Footprint, OrientedBlock, OrientedImage
from geomosaic.digests import sha256
from geomosaic.errors import InputError
from geomosaic.execution.units import workers_for
from geomosaic.geo.grid import Grid
from geomosaic.mosaicking.blending.block import Blender, Seams
from geomosaic.mosaicking.blending.choice import transition_px, with_blending
from geomosaic.mosaicking.colour.corrections import Correction, corrections, image_numbers, retouched, rounded
from geomosaic.mosaicking.colour.solve import colour_balance, keeping_calibration
from geomosaic.mosaicking.kept_tiles import earlier_run_in
from geomosaic.mosaicking.outputs import MosaicFiles
from geomosaic.mosaicking.precedence import filling_images, filling_ranks, image_order
from geomosaic.mosaicking.provenance import source_facts, write_views
from geomosaic.mosaicking.records import MosaicResult, SourceImages, Timer, gains, write_vectors
from geomosaic.mosaicking.rendering import RenderedPixels, render_mosaic
from geomosaic.mosaicking.reruns import EarlierResults, Reuse, UnitKeys, reuse_of
from geomosaic.mosaicking.result_cache import EarlierRun
from geomosaic.mosaicking.seams.seam_polygons import seam_polygons, valid_outlines, without_covered
from geomosaic.mosaicking.seams.seamlines import (
    SeamPlace,
    SeamQuality,
    Segment,
    sample_size,
    seam_segments,
    worst_places,
)
from geomosaic.mosaicking.stac import write_collection, write_item
from geomosaic.options.mosaic import MosaicOptions, SeamWeights
from geomosaic.radiometry.gain_offset import Balance
from geomosaic.raster.vector import prepare
from geomosaic.render.accuracy import AccuracyRaster, Uncertainties, write_accuracy
from geomosaic.render.occlusion import ground_of, visibility
from geomosaic.render.ortho import height_notes
from geomosaic.render.photo import Rectifier
from geomosaic.render.photos import Photos
from geomosaic.sensor.map_to_image import Ground
from geomosaic.stores.path import to_path
from geomosaic.surface.model import Plane

if TYPE_CHECKING:
    from geomosaic.mosaicking.blending.rules import RuleBlender
    from geomosaic.mosaicking.water_filling import WaterBody

# Length in pixels of the seam segments whose quality is measured.
SEGMENT = 512


def mosaic(
    block: OrientedBlock,
    grid: Grid,
    outlines: list[Footprint],
    output: Path,
    options: MosaicOptions | None = None,
    *,
    reference: OrientedImage | None = None,
    about: Mapping[str, Mapping[str, Any]] | None = None,
    earlier_run: EarlierRun | None = None,
) -> MosaicResult:
    """Mosaic of all images of a block, in one pass: balanced, cut along seams, rectified and blended.

    Parameters
    ----------
    block : OrientedBlock
    grid : Grid
        Of the output, see `extent.output_grid`.
    outlines : list of Footprint
        One per scene, in the output map.
    output : Path
        The mosaic; companions are named after it.
    options : MosaicOptions, optional
    reference : OrientedImage, optional
        Georeferenced raster that colours are matched to.
    about : mapping of str to mapping, optional
        Further facts of the images by name, for GeoPackage and STAC: checksums, residuals.
    earlier_run : EarlierRun, optional
        Results of an earlier run, of which a rerun uses all that has not changed.

    Returns
    -------
    MosaicResult

    Raises
    ------
    InputError
        Options that name an unknown image, areas or cutlines that do not fit, or no image shows anything of the output.
    OutputError
        Writing failed.
    """
    options = keeping_calibration(options or MosaicOptions(), block.scenes)
    make = _along_seams if options.merge.rule is None else _by_rule
    files = MosaicFiles.of(output, options, grid)
    given = _Given(block, grid, outlines, reference, about or {}, earlier_run)
    options = files.going_on(options)
    files.check(block, grid, options)
    with workers_for(options.render) as run, files.unfinished() if files.tiled else nullcontext():
        if files.tiled and earlier_run is None:
            given = replace(given, earlier_run=earlier_run_in(files, block, options))
        return replace(make(given, files, options), run=run)


@dataclass(frozen=True)
class _Given:
    """What a mosaic is made of, see `mosaic`."""

    block: OrientedBlock
    grid: Grid
    outlines: list[Footprint]
    reference: OrientedImage | None
    about: Mapping[str, Mapping[str, Any]]
    earlier_run: EarlierRun | None


def _along_seams(given: _Given, files: MosaicFiles, options: MosaicOptions) -> MosaicResult:
    """Mosaic whose images are cut along seams and blended across them."""
    from shapely import Polygon

    block, grid, outlines, earlier_run = given.block, given.grid, given.outlines, given.earlier_run
    _refuse_weight_of_heights(block, options)
    render = options.render
    known = None if files.accuracy is None else Uncertainties.of(block, options.uncertainty, options.render)
    accuracy: AccuracyRaster | None = None
    width = transition_px(options.blending, grid)
    seconds: dict[str, float] = {}
    photos = Photos(block, grid, outlines, render.spare_memory * 3 // 5, options.samples, render.resampling)
    background = ThreadPoolExecutor(1)
    earlier = EarlierResults(photos, options, earlier_run)
    reuse: Reuse | None = None
    facts: dict[str, list[Any]] = {}
    try:
        with Timer(seconds, "balance"):
            # Rounded: threaded linear algebra differs in the last digits from run to run, and reruns compare keys.
            solved = earlier.balance(lambda: rounded(colour_balance(photos, options, given.reference)))
        names, balanced = [outline.name for outline in outlines], corrections(solved)
        applied, dtype, stretch = retouched(balanced, names, options.colours.retouch), photos.info.dtype, None
        if options.samples.stretch is not None:
            from geomosaic.mosaicking.colour.stretch import DTYPE, stretch_of, stretched

            with Timer(seconds, "stretch"):
                # Of the balanced colours without retouches: a change of one photo must not change all others.
                text, dtype = options.samples.stretch, DTYPE
                stretch = earlier.stretch(lambda: stretch_of(photos, render, balanced, text))
                balanced, applied = stretched(stretch, balanced), stretched(stretch, applied)
        excluded = image_numbers(options.seamlines.exclude, names, "`exclude`")
        photos.leave_out(excluded)
        with Timer(seconds, "seams"):
            valid = valid_outlines(photos, render)
            shapes = [Polygon() if i in excluded else shape for i, shape in enumerate(valid)]
            shapes = without_covered(photos, shapes, filling_images(block.scenes, options.merge))
            shares = seam_polygons(photos, shapes, balanced, options, earlier)
        ground = ground_of(grid, block.surface) if render.true_ortho else Ground.under(grid, block.surface)
        on_top = options.blending.blend == "edge"
        blender = with_blending(
            Blender(
                photos,
                ground,
                Seams(shares, shapes, width),
                applied,
                Rectifier(grid, render.resampling, render.tolerance),
                dtype=dtype,
                blending=options.blending,
                visibility=visibility(grid, ground) if render.true_ortho else None,
                ranks=filling_ranks(block.scenes, outlines, options),
            ),
            render.spare_memory * 2 // 5,
            image_order(block.scenes, outlines, options.merge) if on_top else (),
        )
        if files.vectors is not None:
            background.submit(prepare)
        water = _water_bodies(photos, shapes, applied, options)
        keys = None if earlier_run is None else UnitKeys(earlier_run, blender, options, _water_fingerprint(water))
        if not files.tiled:
            rasters = {"mosaic": files.mosaic, "labels": files.labels, "views": files.views}
            earlier_files = {name: path for name, path in rasters.items() if path is not None}
            reuse = reuse_of(options, earlier_run, keys, earlier_files)
        with Timer(seconds, "mosaic"):
            pixels = render_mosaic(blender, files, options, reuse, water, keys if files.tiled else None)
        digest = sha256 if earlier_run is None else earlier_run.digest
        checksum = None if files.item is None else background.submit(digest, files.mosaic)
        # Records look at every image once more, from the first row on.
        photos.again()
        if files.vectors is not None or files.item is not None:
            facts = source_facts(photos, given.about, render)
        if files.views is not None and files.labels is not None:
            with Timer(seconds, "views"):
                write_views(files.views, files.labels, photos, render, reuse)
        if files.displacement is not None and files.labels is not None and options.records.displacement is not None:
            from geomosaic.mosaicking.provenance import write_displacement

            with Timer(seconds, "displacement"):
                write_displacement(files.displacement, files.labels, photos, options.records.displacement, render)
        if files.accuracy is not None and files.labels is not None and known is not None:
            with Timer(seconds, "accuracy"):
                accuracy = write_accuracy(files.accuracy, files.labels, block, grid, known, render)
        parts = seam_segments(shares, grid.resolution[0], SEGMENT * grid.resolution[0])
        quality: list[SeamQuality] = []
        places: list[SeamPlace] = []
        if options.records.seam_quality:
            with Timer(seconds, "seam quality"):
                parts = _sampled_segments(parts, shares, grid, pixels.valid)
                quality = earlier.judged(blender, parts)
                places = worst_places(blender, parts, quality, files.mosaic)
    finally:
        photos.close()
        background.shutdown(wait=False)
    with Timer(seconds, "records"):
        if files.vectors is not None:
            sources = SourceImages(outlines, shares, pixels.by_image, solved, facts)
            write_vectors(files.vectors, grid, sources, parts, quality, overwrite=render.overwrite)
        if files.item is not None and checksum is not None:
            images, sums = [to_path(scene.path) for scene in block.scenes], {files.mosaic: checksum.result()}
            columns: dict[str, Sequence[Any]] = {**gains(solved), "pixels": pixels.by_image, **facts}
            if files.tiled:
                write_collection(files, grid, shapes, images, pixels.tiles, columns, overwrite=render.overwrite)
            else:
                write_item(files, grid, shapes, images, sums, columns, overwrite=render.overwrite)
        if reuse is not None:
            reuse.save()
    return replace(
        _result(files, blender, pixels, render.tolerance, solved, seconds),
        feather=width * grid.resolution[0] if np.isfinite(width) else 0.0,
        reused=pixels.kept if reuse is None else len(reuse.taken),
        units=pixels.units,
        stretch=stretch,
        parts=parts,
        quality=quality,
        places=places,
        hidden_pixels=pixels.hidden if render.true_ortho else None,
        from_cache=tuple(earlier.recall.from_cache),
        accuracy=accuracy,
    )


def _result(
    files: MosaicFiles,
    blender: Blender | RuleBlender,
    pixels: RenderedPixels,
    tolerance: float,
    balance: Balance,
    seconds: dict[str, float],
) -> MosaicResult:
    """What every mosaic tells of itself; one without seams has no more."""
    return MosaicResult(
        path=files.mosaic,
        tiles=tuple(own.mosaic for own, _ in pixels.tiles.values()),
        labels=files.labels,
        vectors=files.vectors,
        item=files.item,
        grid=blender.grid,
        valid_pixels=pixels.valid,
        pixels=pixels.by_image,
        balance=balance,
        feather=0.0,
        lattice_error=pixels.geometry.error,
        tolerance=tolerance,
        scale=pixels.geometry.scale,
        seconds=seconds,
        notes=height_notes(blender.ground, blender.photos.outlines),
    )


def _by_rule(given: _Given, files: MosaicFiles, options: MosaicOptions) -> MosaicResult:
    """Mosaic in which `options.merge.rule` makes each pixel from all images that show it."""
    from shapely import Polygon

    from geomosaic.mosaicking.blending.rules import RuleBlender, output_info

    block, grid, outlines = given.block, given.grid, given.outlines
    rule, render = options.merge.rule or "", options.render
    order = image_order(block.scenes, outlines, options.merge)
    seconds: dict[str, float] = {}
    photos = Photos(block, grid, outlines, render.spare_memory * 3 // 5, options.samples, render.resampling)
    try:
        with Timer(seconds, "balance"):
            earlier = EarlierResults(photos, options, given.earlier_run if files.tiled else None)
            solved = earlier.balance(lambda: colour_balance(photos, options, given.reference))
        ground = Ground.under(grid, block.surface)
        rectifier = Rectifier(grid, render.resampling, render.tolerance)
        info = output_info(photos.info, rule)
        blender = RuleBlender(photos, ground, corrections(solved), rectifier, rule, order, info)
        with Timer(seconds, "mosaic"):
            keys = UnitKeys(given.earlier_run, blender, options) if files.tiled and given.earlier_run else None
            pixels = render_mosaic(blender, files, options, keys=keys)
        photos.again()
        facts = source_facts(photos, given.about, render) if files.vectors or files.item else {}
    finally:
        photos.close()
    with Timer(seconds, "records"):
        if files.vectors is not None:  # footprints alone: there are no seams
            sources = SourceImages(outlines, [Polygon() for _ in outlines], pixels.by_image, solved, facts)
            write_vectors(files.vectors, grid, sources, [], overwrite=render.overwrite)
        if files.item is not None:
            images, shapes = [to_path(scene.path) for scene in block.scenes], [outline.polygon for outline in outlines]
            columns: dict[str, Sequence[Any]] = {**gains(solved), "pixels": pixels.by_image, **facts}
            if files.tiled:
                write_collection(files, grid, shapes, images, pixels.tiles, columns, overwrite=render.overwrite)
            else:
                sums = {files.mosaic: sha256(files.mosaic)}
                write_item(files, grid, shapes, images, sums, columns, overwrite=render.overwrite)
    result = _result(files, blender, pixels, render.tolerance, solved, seconds)
    return replace(result, reused=pixels.kept, units=pixels.units)


def _refuse_weight_of_heights(block: OrientedBlock, options: MosaicOptions) -> None:
    """Check that a weight of raised objects has a surface on which some can stand."""
    changed = options.seamlines.seam_weights.heights != SeamWeights().heights
    if changed and (block.surface is None or isinstance(block.surface, Plane)):
        what = "`seam_weights` would do nothing with 'heights': the ground has none"
        raise InputError(what, hint="give `dem`, a surface with roofs and trees, or leave out that weight")


def _water_bodies(
    photos: Photos, shapes: list[Any], applied: Sequence[Correction], options: MosaicOptions
) -> Sequence[WaterBody]:
    """Water to be filled with a continuous tone."""
    if options.seamlines.water is None or options.seamlines.water_fill != "tone":
        return ()
    from geomosaic.mosaicking.water_filling import read_water, water_bodies

    return water_bodies(photos, read_water(options.seamlines.water, photos.grid), shapes, applied, options.render)


def _water_fingerprint(water: Sequence[WaterBody]) -> str:
    if not water:
        return ""
    from geomosaic.mosaicking.water_filling import fingerprint

    return fingerprint(water)


def _sampled_segments(parts: list[Segment], shares: list[Any], grid: Grid, pixels: int) -> list[Segment]:
    """Seam segments few enough to be measured; longer by whole steps, so that one longer seam moves no others."""
    pixel = grid.resolution[0]
    length = sum(part.line.length for part in parts)
    steps = max(1, math.ceil(length / (sample_size(pixels) * SEGMENT * pixel)))
    return parts if steps == 1 else seam_segments(shares, pixel, steps * SEGMENT * pixel)
