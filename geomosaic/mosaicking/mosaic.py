"""Many raw images, one mosaic, every pixel resampled once."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geomosaic.block.block import OrientedBlock, OrientedImage
from geomosaic.block.footprint import Footprint
from geomosaic.digests import sha256
from geomosaic.errors import InputError
from geomosaic.geo.grid import Grid, Window
from geomosaic.mosaicking.blending.block import Blender, Seams
from geomosaic.mosaicking.blending.choice import blender_for
from geomosaic.mosaicking.blending.width import transition_px
from geomosaic.mosaicking.colour.corrections import Correction, corrections
from geomosaic.mosaicking.colour.solve import colours
from geomosaic.mosaicking.records.files import gains, write_item, write_vectors
from geomosaic.mosaicking.records.provenance import source_facts, write_views
from geomosaic.mosaicking.reruns.earlier_results import Earlier
from geomosaic.mosaicking.reruns.reuse import KeptUnit, Memory, Reuse, reuse_of
from geomosaic.mosaicking.result import Clock, MosaicResult
from geomosaic.mosaicking.retouch import numbers_of, retouched, steady
from geomosaic.mosaicking.seams.seam_polygons import seam_polygons, valid_outlines
from geomosaic.mosaicking.seams.seamlines import sample_size, seam_segments, worst_places
from geomosaic.mosaicking.unit import MosaicUnit, label_type
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.radiometry.gain_offset import Balance, solve
from geomosaic.raster.output_files import check_geotiff, check_output
from geomosaic.raster.sink import RasterSink
from geomosaic.raster.vector import prepare
from geomosaic.render.dem_gaps import height_notes
from geomosaic.render.occlusion import ground_of, visibility
from geomosaic.render.ortho import GeometryRecord, samples, tiles
from geomosaic.render.photos import Photos
from geomosaic.render.workers import in_order
from geomosaic.resample.engine import engine_for, started
from geomosaic.sensor.lattice import blocks
from geomosaic.sensor.map_to_image import Ground

if TYPE_CHECKING:
    from geomosaic.mosaicking.blending.rules import Ruler
    from geomosaic.mosaicking.water.filling import Pool


SEGMENT = 512
"""Pixels: length of the pieces of seams that are judged."""


def beside(output: Path, what: str, suffix: str) -> Path:
    """Name of a file that goes with the mosaic: mosaic.tif, mosaic-labels.tif, mosaic.gpkg."""
    return output.with_name(f"{output.stem}{what}{suffix}")


def mosaic(
    block: OrientedBlock,
    grid: Grid,
    outlines: list[Footprint],
    output: Path,
    options: MosaicOptions | None = None,
    *,
    reference: OrientedImage | None = None,
    about: Mapping[str, Mapping[str, Any]] | None = None,
    memory: Memory | None = None,
) -> MosaicResult:
    """Balance, seam, rectify and blend all images of a block in one pass.

    Parameters
    ----------
    block : OrientedBlock
    grid : Grid
        The output, see `extent.output_grid`.
    outlines : list of Footprint
        One per scene, in the output map.
    output : Path
        The mosaic; companions are named after it.
    options : MosaicOptions
    reference : OrientedImage, optional
        Georeferenced raster that colours are matched to.
    about : mapping of str to mapping, optional
        Further facts of the images by name, for GeoPackage and STAC: checksums, residuals.
    memory : Memory, optional
        Where what was computed is remembered, so that a later run takes what has not changed.

    Returns
    -------
    MosaicResult
    """
    options = options or MosaicOptions()
    if options.merge.rule is not None:
        from geomosaic.mosaicking.merge import merge

        return merge(block, grid, outlines, output, options, reference=reference, about=about)
    render = options.render
    from shapely import Polygon

    labels = beside(output, "-labels", ".tif") if options.records.labels else None
    views = beside(output, "-views", ".tif") if options.records.views else None
    relief = beside(output, "-displacement", ".tif") if options.records.displacement is not None else None
    vectors = beside(output, "", ".gpkg") if options.records.vectors else None
    # A map of its own lies nowhere on the Earth, which a STAC item would have to say.
    item = beside(output, "", ".stac.json") if options.writes_item and not grid.crs.is_engineering else None
    check_geotiff(output, overwrite=render.overwrite)
    for path in (labels, views, relief, vectors, item):
        if path is not None:  # before an hour's work, not behind it
            check_output(path, overwrite=render.overwrite)
    width = transition_px(options.blending, grid)
    seconds: dict[str, float] = {}
    photos = Photos(block, grid, outlines, render.memory_limit // 2, options.samples, render.resampling)
    beside_it = ThreadPoolExecutor(1)
    earlier = Earlier(photos, options, memory)
    reuse: Reuse | None = None
    facts: dict[str, list[Any]] = {}
    try:
        # What costs time to import gets it where a processor would idle.
        units, work = tiles(grid, render.tile), 2 * samples(grid, outlines)
        again = memory is not None and memory.file.is_file() and not started()
        # What an earlier run has left to do is not known yet, and may not be worth the start of the compiled kernels.
        compiled = beside_it.submit(engine_for, 0 if again else work, render.resampling, render.threads)
        with Clock(seconds, "balance"):
            solved = earlier.balance(lambda: steady(_balanced(photos, options, reference)))
        names, own = [outline.name for outline in outlines], corrections(solved)
        applied, dtype, stretch = retouched(own, names, options.colours.retouch), photos.info.dtype, None
        if options.samples.stretch is not None:
            from geomosaic.mosaicking.colour.stretch import DTYPE, stretch_of, stretched

            with Clock(seconds, "stretch"):  # of what was not touched up: one photo's change is not that of all
                text, dtype = options.samples.stretch, DTYPE
                stretch = earlier.stretch(lambda: stretch_of(photos, render, own, text))
                own, applied = stretched(stretch, own), stretched(stretch, applied)
        out = numbers_of(options.seamlines.exclude, names, "left out")
        photos.leave_out(out)
        with Clock(seconds, "seams"):
            shown = valid_outlines(photos, render)
            shapes = [Polygon() if i in out else shape for i, shape in enumerate(shown)]
            shares = seam_polygons(photos, shapes, own, options, earlier)
        seams = Seams(shares, shapes, width)
        ground = ground_of(grid, block.surface) if render.true_ortho else Ground.under(grid, block.surface)
        engine = compiled.result()
        sight = visibility(grid, ground) if render.true_ortho else None
        blender = blender_for(options.blending, photos, grid, ground, seams, applied, engine, render, dtype, sight)
        if vectors is not None:
            beside_it.submit(prepare)
        water = _pools(photos, shapes, applied, options)
        files = {"mosaic": output, "labels": labels, "views": views}
        at_hand = {name: path for name, path in files.items() if path is not None}
        reuse = reuse_of(options, memory, blender, at_hand, _said_of_water(water))
        if again:
            left = len(units) if reuse is None else reuse.left(units)
            blender = blender.by(engine_for(work * left // len(units), render.resampling, render.threads))
        with Clock(seconds, "mosaic"):
            pixels, hidden, record = _render(blender, output, labels, options, reuse, water)
        digest = sha256 if memory is None else memory.digest
        checksum = None if item is None else beside_it.submit(digest, output)
        photos.again()
        if vectors is not None or item is not None:
            facts = source_facts(photos, about or {})
        if views is not None and labels is not None:
            with Clock(seconds, "views"):
                write_views(views, labels, photos, render, reuse)
        if relief is not None and labels is not None and options.records.displacement is not None:
            from geomosaic.mosaicking.records.relief_displacement import write_displacement

            with Clock(seconds, "displacement"):
                write_displacement(relief, labels, photos, options.records.displacement, render)
        pixel = grid.resolution[0]
        parts, quality, places = seam_segments(shares, pixel, SEGMENT * pixel), [], []
        if options.records.seam_quality:
            with Clock(seconds, "seam quality"):
                # In whole steps, so that a longer seam does not cut all others elsewhere.
                most = sample_size(sum(pixels))
                steps = max(1, math.ceil(sum(p.line.length for p in parts) / (most * SEGMENT * pixel)))
                parts = parts if steps == 1 else seam_segments(shares, pixel, steps * SEGMENT * pixel)
                quality = earlier.judged(blender, parts)
                places = worst_places(blender, parts, quality, output)
    finally:
        photos.close()
        beside_it.shutdown(wait=False)
    with Clock(seconds, "records"):
        if vectors is not None:
            write_vectors(
                vectors, grid, outlines, shares, solved, pixels, parts, quality, facts, overwrite=render.overwrite
            )
        if item is not None and checksum is not None:
            images = [Path(scene.path) for scene in block.scenes]
            sums = {output: checksum.result()}
            sources: dict[str, Sequence[Any]] = {**gains(solved), "pixels": pixels, **facts}
            write_item(
                item, output, labels, vectors, grid, shapes, images, sums, sources, views, overwrite=render.overwrite
            )
        if reuse is not None:
            reuse.save()
    feather = width * grid.resolution[0] if np.isfinite(width) else 0.0
    return MosaicResult(
        path=output,
        labels=labels,
        vectors=vectors,
        item=item,
        grid=grid,
        valid_pixels=sum(pixels),
        pixels=pixels,
        balance=solved,
        feather=feather,
        lattice_error=record.error,
        tolerance=render.tolerance,
        scale=record.scale,
        seconds=seconds,
        reused=0 if reuse is None else len(reuse.taken),
        units=len(units),
        stretch=stretch,
        parts=parts,
        quality=quality,
        places=places,
        hidden_pixels=hidden if render.true_ortho else None,
        recalled=tuple(earlier.recall.recalled),
        notes=height_notes(ground, outlines),
    )


def _balanced(photos: Photos, options: MosaicOptions, reference: OrientedImage | None) -> Balance:
    """What is done to the values of each image."""
    if options.colours.histogram is not None:
        from geomosaic.mosaicking.colour.histogram import match_histograms

        return match_histograms(photos, options, reference)
    return colours(photos, options, reference) if options.balanced else solve(len(photos), photos.info.bands, [])


def _pools(photos: Photos, shapes: list[Any], applied: Sequence[Correction], options: MosaicOptions) -> Sequence[Pool]:
    """Water that is filled with a tone."""
    if options.seamlines.water is None or options.seamlines.water_fill != "tone":
        return ()
    from geomosaic.mosaicking.water.filling import pools, read_water

    return pools(photos, read_water(options.seamlines.water, photos.grid), shapes, applied)


def _said_of_water(water: Sequence[Pool]) -> str:
    if not water:
        return ""
    from geomosaic.mosaicking.water.filling import said

    return said(water)


def _render(
    blender: Blender | Ruler,
    output: Path,
    labels: Path | None,
    options: MosaicOptions,
    reuse: Reuse | None,
    water: Sequence[Pool] = (),
) -> tuple[list[int], int, GeometryRecord]:
    """Pixels of each image, pixels hidden from all, and what is known of the geometry."""
    render, grid, info = options.render, blender.grid, blender.info
    number = len(blender.photos)
    counts, record = np.zeros(number + 2, dtype=np.int64), GeometryRecord()
    units = tiles(grid, render.tile)

    def unit(window: Window) -> MosaicUnit | KeptUnit:
        return computed(window) if reuse is None else reuse.unit(window, computed)

    def computed(window: Window) -> MosaicUnit:
        made = MosaicUnit.empty(window, info.bands, blender.dtype, number)
        for block in blocks(window):
            blender.fill(block.intersection(grid.window), made)
        for pool in water:
            pool.paint(made, grid)
        return made

    with ExitStack() as stack:
        sink = stack.enter_context(
            RasterSink(
                output, grid, info.bands, blender.dtype, nodata=render.nodata, creation=render.creation,
                descriptions=info.descriptions, tags={"GEOMOSAIC_IMAGES": str(number)}, driver=render.driver,
                overwrite=render.overwrite, threads=render.threads,
            )
        )  # fmt: skip
        label_sink = None
        if labels is not None:
            label_sink = stack.enter_context(
                RasterSink(
                    labels, grid, 1, label_type(number), nodata=0, classes=True, descriptions=("source image",),
                    driver=render.driver, overwrite=render.overwrite, threads=render.threads,
                )
            )  # fmt: skip
        copied = sink.copies(output) if reuse is not None else False
        if labels is not None and label_sink is not None:
            copied = copied and label_sink.copies(labels)
        if reuse is not None and not copied:
            reuse.forget()
        for done, (window, made) in enumerate(in_order(unit, units, blender.engine.threads(render.threads))):
            if isinstance(made, KeptUnit):
                sink.keep(window)
                if label_sink is not None:
                    label_sink.keep(window)
            elif not made.counts[1:].any():  # as most of a mosaic of photos far apart
                sink.leave(window)
                if label_sink is not None:
                    label_sink.leave(window)
            else:
                sink.write(window, made.values, made.valid, blank=render.nodata is None)
                if label_sink is not None:
                    known = (made.label > 0).view(np.uint8) if render.true_ortho else made.valid
                    label_sink.write(window, made.label[..., None], known, blank=True)
            counts += made.counts
            for fact in made.facts:
                record.add(*fact)
            blender.photos.passed(window.row)
            render.report(done + 1, len(units), "mosaic")
        if not counts[1:-1].any():
            raise InputError(
                "no image shows anything of the output area",
                hint="check `bounds`, the images' nodata and the DEM's extent",
            )
        render.report(0, 1, "writing")
        sink.finish()
        if label_sink is not None:
            label_sink.finish()
    record.judge(render.tolerance)
    return [int(count) for count in counts[1:-1]], int(counts[-1]), record
