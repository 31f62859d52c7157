"""A mosaic by rule, without seams: what `rio merge` does, for images of any CRS and pixel size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from geomosaic.block.block import OrientedBlock, OrientedImage
from geomosaic.block.footprint import Footprint
from geomosaic.digests import sha256
from geomosaic.geo.grid import Grid
from geomosaic.mosaicking.blending.rules import LABELLED, Ruler, output_info
from geomosaic.mosaicking.colour.corrections import corrections
from geomosaic.mosaicking.mosaic import _balanced, _render, beside
from geomosaic.mosaicking.records.files import gains, write_item, write_vectors
from geomosaic.mosaicking.records.provenance import source_facts
from geomosaic.mosaicking.result import Clock, MosaicResult
from geomosaic.mosaicking.seams.image_order import image_order
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.raster.output_files import check_geotiff, check_output
from geomosaic.render.dem_gaps import height_notes
from geomosaic.render.ortho import samples
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
    """Lay images together by `options.merge.rule`.

    Parameters
    ----------
    block : OrientedBlock
    grid : Grid
        The output.
    outlines : list of Footprint
        One per scene, in the output map.
    output : Path
    options : MosaicOptions
        Its seams and blending play no part.
    reference : OrientedImage, optional
    about : mapping of str to mapping, optional
        As in `mosaic`.

    Returns
    -------
    MosaicResult
        Under other rules than first and last, `pixels` counts for each image the pixels that no image before it shows.
    """
    from shapely import Polygon

    rule, render = options.merge.rule or "", options.render
    order = image_order(block.scenes, outlines, options.merge.order, None)
    if options.merge.base is not None:  # lowest: the last of what is laid first to last, else the first
        with_base = image_order(block.scenes, outlines, options.merge.order, options.merge.base)
        order = with_base if rule != "last" else [with_base[-1], *with_base[:-1]]
    labels = beside(output, "-labels", ".tif") if options.records.labels and rule in LABELLED else None
    item = beside(output, "", ".stac.json") if options.writes_item and not grid.crs.is_engineering else None
    vectors = beside(output, "", ".gpkg") if options.records.vectors else None
    check_geotiff(output, overwrite=render.overwrite)
    for path in (labels, vectors, item):
        if path is not None:
            check_output(path, overwrite=render.overwrite)
    seconds: dict[str, float] = {}
    photos = Photos(block, grid, outlines, render.memory_limit // 2, options.samples, render.resampling)
    try:
        with Clock(seconds, "balance"):
            solved = _balanced(photos, options, reference)
        ground = Ground.under(grid, block.surface)
        engine = engine_for(samples(grid, outlines), render.resampling)
        info = output_info(photos.info, rule)
        ruler = Ruler(
            photos, grid, ground, corrections(solved), engine, render.resampling, render.tolerance, rule, order, info
        )
        with Clock(seconds, "mosaic"):
            pixels, _, record = _render(ruler, output, labels, options, None)
        photos.again()
        facts = source_facts(photos, about or {}) if vectors is not None or item is not None else {}
    finally:
        photos.close()
    with Clock(seconds, "records"):
        if vectors is not None:  # footprints alone: there are no seams
            nobody = [Polygon() for _ in outlines]
            write_vectors(
                vectors, grid, outlines, nobody, solved, pixels, [], sources=facts, overwrite=render.overwrite
            )
        if item is not None:
            images, shapes = [Path(scene.path) for scene in block.scenes], [outline.polygon for outline in outlines]
            sources: dict[str, Sequence[Any]] = {**gains(solved), "pixels": pixels, **facts}
            write_item(
                item, output, labels, vectors, grid, shapes, images, {output: sha256(output)}, sources,
                overwrite=render.overwrite,
            )  # fmt: skip
    return MosaicResult(
        path=output,
        labels=labels,
        vectors=vectors,
        item=item,
        grid=grid,
        valid_pixels=sum(pixels),
        pixels=pixels,
        balance=solved,
        feather=0.0,
        lattice_error=record.error,
        tolerance=render.tolerance,
        scale=record.scale,
        seconds=seconds,
        notes=height_notes(ground, outlines),
    )
