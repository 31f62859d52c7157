"""Mosaic of a block from colours to records, rendered in units computed in parallel or kept from an earlier run."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geomosaic.block import Footprint, OrientedBlock, OrientedImage
from geomosaic.digests import sha256
from geomosaic.errors import InputError
from geomosaic.execution.units import map_units
from geomosaic.geo.grid import Grid, Window
from geomosaic.mosaicking.blending.block import Blender, Seams
from geomosaic.mosaicking.blending.choice import transition_px, with_blending
from geomosaic.mosaicking.colour.corrections import Correction, corrections, image_numbers, retouched, rounded
from geomosaic.mosaicking.colour.solve import colour_balance, keeping_calibration
from geomosaic.mosaicking.outputs import MosaicFiles, MosaicUnit, label_type
from geomosaic.mosaicking.precedence import filling_images, filling_ranks, image_order
from geomosaic.mosaicking.provenance import source_facts, write_views
from geomosaic.mosaicking.records import MosaicResult, SourceImages, Timer, gains, write_vectors
from geomosaic.mosaicking.reruns import EarlierResults, Fact, KeptUnit, Reuse, reuse_of
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
from geomosaic.mosaicking.tiled_files import write_virtual
from geomosaic.options.mosaic import MosaicOptions, SeamWeights
from geomosaic.options.render import BLOCK_HEIGHT
from geomosaic.radiometry.gain_offset import Balance
from geomosaic.raster.cog.codec import RasterMetadata, Samples
from geomosaic.raster.cog.tiles import WindowTiler, WindowTiles
from geomosaic.raster.sink import RasterSink
from geomosaic.raster.vector import prepare
from geomosaic.render.accuracy import AccuracyRaster, Uncertainties, write_accuracy
from geomosaic.render.calibrated import overview_mean
from geomosaic.render.occlusion import ground_of, visibility
from geomosaic.render.ortho import GeometryRecord, height_notes, tiles
from geomosaic.render.photo import Rectifier
from geomosaic.render.photos import Photos
from geomosaic.sensor.lattice import blocks
from geomosaic.sensor.map_to_image import Ground
from geomosaic.stores.path import to_path
from geomosaic.surface.model import Plane
from geomosaic.types import IntArray

if TYPE_CHECKING:
    from geomosaic.mosaicking.blending.rules import RuleBlender
    from geomosaic.mosaicking.water_filling import WaterBody


@dataclass(frozen=True)
class RenderedPixels:
    """Pixel counts of a rendered mosaic, and the quality of its geometry.

    Attributes
    ----------
    by_image : list of int
        Pixels whose main source each image is.
    hidden : int
        Pixels that images cover and the surface hides from them all.
    geometry : GeometryRecord
        Largest error of the interpolated geometry, and the scale.
    files : dict of Window to MosaicFiles
        Rasters that were written, by their place: one, or tiles.
    """

    by_image: list[int]
    hidden: int
    geometry: GeometryRecord
    files: dict[Window, MosaicFiles]

    @property
    def valid(self) -> int:
        """Pixels with a value."""
        return sum(self.by_image)


@dataclass(frozen=True)
class RenderUnit:
    """Unit of work: a window of the mosaic, in the raster file that it belongs to.

    Attributes
    ----------
    window : Window
    raster : Window
        The file's; all of the mosaic, or one of its tiles.
    """

    window: Window
    raster: Window

    @property
    def place(self) -> Window:
        """Window in pixels of the file."""
        return replace(self.window, col=self.window.col - self.raster.col, row=self.window.row - self.raster.row)


@dataclass(frozen=True)
class RenderedUnits:
    """Rendering of a mosaic's units, each to the tiles of its rasters; for any thread or process.

    Attributes
    ----------
    blender : Blender or RuleBlender
    tilers : tuple of WindowTiler
        Of the mosaic, and of the label raster where there is one.
    water : tuple of WaterBody
        Water to be filled with a tone.
    nodata : float, optional
    hides : bool
        Whether the surface hides ground: labels tell then what is known, not the values.
    """

    blender: Blender | RuleBlender
    tilers: tuple[WindowTiler, ...]
    water: tuple[WaterBody, ...] = ()
    nodata: float | None = None
    hides: bool = False

    def __call__(self, unit: RenderUnit) -> tuple[IntArray, list[Fact], list[WindowTiles]]:
        """Pixels by label, errors and scales of the lattices, and the tiles of each raster."""
        blender, raster = self.blender, unit.raster
        made = MosaicUnit.empty(unit.window, blender.info.bands, blender.dtype, len(blender.photos))
        for block in blocks(unit.window):
            blender.fill(block.intersection(blender.grid.window), made)
        for pool in self.water:
            pool.paint(made, blender.grid)
        tilers = [one.of_size(raster.width, raster.height) for one in self.tilers]
        return made.counts, made.facts, self._tiles(made, unit.place, tilers)

    def _tiles(self, made: MosaicUnit, place: Window, tilers: Sequence[WindowTiler]) -> list[WindowTiles]:
        if not made.counts[1:].any():  # most units of a mosaic of scattered photos
            return [one.empty(place) for one in tilers]
        known = (made.label > 0).view(np.uint8) if self.hides else made.valid
        layers = (made.values, made.valid, self.nodata is None), (made.label[..., None], known, True)
        return [
            one.tiles(place, values, valid, blank=blank)
            for one, (values, valid, blank) in zip(tilers, layers, strict=False)
        ]


def render_mosaic(
    blender: Blender | RuleBlender,
    files: MosaicFiles,
    options: MosaicOptions,
    reuse: Reuse | None = None,
    water: Sequence[WaterBody] = (),
) -> RenderedPixels:
    """Mosaic and label raster, written unit by unit.

    Parameters
    ----------
    blender : Blender or RuleBlender
    files : MosaicFiles
    options : MosaicOptions
    reuse : Reuse, optional
        Units of an earlier run.
    water : sequence of WaterBody
        Water to be filled with a tone.

    Returns
    -------
    RenderedPixels

    Raises
    ------
    InputError
        No image shows anything of the output.
    OutputError
        Writing failed.
    """
    render, grid = options.render, blender.grid
    counts, record = np.zeros(len(blender.photos) + 2, dtype=np.int64), GeometryRecord()
    rasters = files.rasters(grid, options.records.tiling)
    if files.tiled:
        files.folder.mkdir(exist_ok=True)
    units = [RenderUnit(window, raster) for raster in rasters for window in raster.split(render.tile, BLOCK_HEIGHT)]
    kept: dict[RenderUnit, KeptUnit | None] = {}
    computed: Iterator[Any] | None = None
    written, done = {}, 0
    with ExitStack() as running:
        for raster, own in rasters.items():
            here = np.zeros_like(counts)
            with ExitStack() as stack:
                sinks = [stack.enter_context(one) for one in _sinks(blender, own, grid.crop(raster), options)]
                if computed is None:
                    kept = _kept_units(units, sinks, reuse)
                    left = [unit for unit in units if kept.get(unit) is None]
                    # Each thread keeps memory of its own: no more of them than there are units to be computed.
                    limited = replace(render, threads=max(1, min(render.threads, len(left))))
                    tilers = tuple(one.tiler for one in sinks)
                    work = RenderedUnits(blender, tilers, tuple(water), render.nodata, render.true_ortho)
                    computed = running.enter_context(closing(map_units(work, left, limited)))
                for unit in units[done : done + len(raster.split(render.tile, BLOCK_HEIGHT))]:
                    earlier = kept.get(unit)
                    if earlier is not None:
                        for one in sinks:
                            one.keep(unit.window)
                        shown, facts = earlier.counts, earlier.facts
                    else:
                        _, (shown, facts, made) = next(computed)
                        for one, its in zip(sinks, made, strict=True):
                            one.add(its)
                        if reuse is not None:
                            reuse.add(unit.window, shown, facts)
                    here += shown
                    for fact in facts:
                        record.add(*fact)
                    # Photos that end above these rows are closed: memory is that of a strip of photos.
                    blender.photos.passed(raster.row if files.tiled else unit.window.row)
                    done += 1
                    render.report(done, len(units), "mosaic")
                if here[1:-1].any():  # else the tile has no file
                    render.report(0, 1, "writing")
                    for one in sinks:
                        one.finish()
                    written[raster] = own
            counts += here
    if not written:
        raise InputError(
            "no image shows anything of the output area",
            hint="check `bounds`, the images' nodata and the DEM's extent",
        )
    if files.tiled:
        write_virtual(files, grid, written, overwrite=render.overwrite)
    record.judge(render.tolerance)
    return RenderedPixels([int(count) for count in counts[1:-1]], int(counts[-1]), record, written)


def _sinks(
    blender: Blender | RuleBlender, files: MosaicFiles, grid: Grid, options: MosaicOptions
) -> Iterator[RasterSink]:
    """Rasters of the mosaic and its labels, or of one of their tiles."""
    render, info, number = options.render, blender.info, len(blender.photos)
    yield RasterSink(
        files.mosaic, grid, Samples(info.bands, blender.dtype, nodata=render.nodata), creation=render.creation,
        driver=render.driver, overwrite=render.overwrite, threads=render.threads,
        metadata=RasterMetadata(
            info.descriptions, tags={"GEOMOSAIC_IMAGES": str(number)},
            overviews=overview_mean(blender.photos.block.scenes, render.resampling),
        ),
    )  # fmt: skip
    if files.labels is not None:
        yield RasterSink(
            files.labels, grid, Samples(1, label_type(number), nodata=0), driver=render.driver,
            overwrite=render.overwrite, threads=render.threads,
            metadata=RasterMetadata(("source image",), categorical=True),
        )  # fmt: skip


def _kept_units(
    units: Sequence[RenderUnit], sinks: Sequence[RasterSink], reuse: Reuse | None
) -> dict[RenderUnit, KeptUnit | None]:
    """Units of an earlier run whose tiles fit into the rasters."""
    if reuse is None:
        return {}
    # Tiles are kept as compressed bytes: an earlier file of another form has none that fit.
    if not all(one.reuse_tiles_of(one.path) for one in sinks):
        reuse.forget()
    return {unit: reuse.kept(unit.window) for unit in units}


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
    if options.merge.rule is not None:
        return _by_rule(block, grid, outlines, output, options, reference=reference, about=about)
    from shapely import Polygon

    _refuse_weight_of_heights(block, options)
    render = options.render
    files = MosaicFiles.of(output, options, grid)
    files.check(block, grid, options)
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
            solved = earlier.balance(lambda: rounded(colour_balance(photos, options, reference)))
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
        rasters = {"mosaic": output, "labels": files.labels, "views": files.views}
        earlier_files = {name: path for name, path in rasters.items() if path is not None}
        no_tiles = None if files.tiled else earlier_run
        reuse = reuse_of(options, no_tiles, blender, earlier_files, _water_fingerprint(water))
        with Timer(seconds, "mosaic"):
            pixels = render_mosaic(blender, files, options, reuse, water)
        digest = sha256 if earlier_run is None else earlier_run.digest
        checksum = None if files.item is None else background.submit(digest, output)
        # Records look at every image once more, from the first row on.
        photos.again()
        if files.vectors is not None or files.item is not None:
            facts = source_facts(photos, about or {}, render)
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
                places = worst_places(blender, parts, quality, output)
    finally:
        photos.close()
        background.shutdown(wait=False)
    with Timer(seconds, "records"):
        if files.vectors is not None:
            sources = SourceImages(outlines, shares, pixels.by_image, solved, facts)
            write_vectors(files.vectors, grid, sources, parts, quality, overwrite=render.overwrite)
        if files.item is not None and checksum is not None:
            images, sums = [to_path(scene.path) for scene in block.scenes], {output: checksum.result()}
            columns: dict[str, Sequence[Any]] = {**gains(solved), "pixels": pixels.by_image, **facts}
            if files.tiled:
                write_collection(files, grid, shapes, images, pixels.files, columns, overwrite=render.overwrite)
            else:
                write_item(files, grid, shapes, images, sums, columns, overwrite=render.overwrite)
        if reuse is not None:
            reuse.save()
    return replace(
        _result(files, blender, pixels, render.tolerance, solved, seconds),
        feather=width * grid.resolution[0] if np.isfinite(width) else 0.0,
        reused=0 if reuse is None else len(reuse.taken),
        units=len(tiles(grid, render.tile)),
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
        tiles=tuple(own.mosaic for own in pixels.files.values()) if files.tiled else (),
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


def _by_rule(
    block: OrientedBlock,
    grid: Grid,
    outlines: list[Footprint],
    output: Path,
    options: MosaicOptions,
    *,
    reference: OrientedImage | None = None,
    about: Mapping[str, Mapping[str, Any]] | None = None,
) -> MosaicResult:
    """Mosaic in which `options.merge.rule` makes each pixel from all images that show it."""
    from shapely import Polygon

    from geomosaic.mosaicking.blending.rules import SINGLE_SOURCE_RULES, RuleBlender, output_info

    rule, render = options.merge.rule or "", options.render
    order = image_order(block.scenes, outlines, options.merge)
    files = MosaicFiles.of(output, options, grid)
    if rule not in SINGLE_SOURCE_RULES:
        files = replace(files, labels=None)
    files.check(block, grid, options)
    seconds: dict[str, float] = {}
    photos = Photos(block, grid, outlines, render.spare_memory * 3 // 5, options.samples, render.resampling)
    try:
        with Timer(seconds, "balance"):
            solved = colour_balance(photos, options, reference)
        ground = Ground.under(grid, block.surface)
        rectifier = Rectifier(grid, render.resampling, render.tolerance)
        info = output_info(photos.info, rule)
        blender = RuleBlender(photos, ground, corrections(solved), rectifier, rule, order, info)
        with Timer(seconds, "mosaic"):
            pixels = render_mosaic(blender, files, options)
        photos.again()
        facts = source_facts(photos, about or {}, render) if files.vectors or files.item else {}
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
                write_collection(files, grid, shapes, images, pixels.files, columns, overwrite=render.overwrite)
            else:
                write_item(files, grid, shapes, images, {output: sha256(output)}, columns, overwrite=render.overwrite)
    return _result(files, blender, pixels, render.tolerance, solved, seconds)


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
