"""Rendering of a mosaic: units of pixels computed in parallel and written in order, or kept from an earlier run."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geomosaic.errors import InputError
from geomosaic.geo.grid import Window
from geomosaic.mosaicking.blending.block import Blender
from geomosaic.mosaicking.outputs import MosaicFiles, MosaicUnit, label_type
from geomosaic.mosaicking.reruns import KeptUnit, Reuse
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.raster.cog.codec import RasterMetadata
from geomosaic.raster.sink import RasterSink
from geomosaic.render.ortho import GeometryRecord, tiles
from geomosaic.render.workers import in_order
from geomosaic.sensor.lattice import blocks

if TYPE_CHECKING:
    from geomosaic.mosaicking.blending.rules import RuleBlender
    from geomosaic.mosaicking.water_filling import Pool


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
    """

    by_image: list[int]
    hidden: int
    geometry: GeometryRecord

    @property
    def valid(self) -> int:
        """Pixels with a value."""
        return sum(self.by_image)


def render_mosaic(
    blender: Blender | RuleBlender,
    files: MosaicFiles,
    options: MosaicOptions,
    reuse: Reuse | None = None,
    water: Sequence[Pool] = (),
) -> RenderedPixels:
    """Mosaic and label raster, written unit by unit.

    Parameters
    ----------
    blender : Blender or RuleBlender
    files : MosaicFiles
    options : MosaicOptions
    reuse : Reuse, optional
        Units of an earlier run.
    water : sequence of Pool
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
                files.mosaic, grid, info.bands, blender.dtype, nodata=render.nodata, creation=render.creation,
                driver=render.driver, overwrite=render.overwrite, threads=render.threads,
                metadata=RasterMetadata(info.descriptions, tags={"GEOMOSAIC_IMAGES": str(number)}),
            )
        )  # fmt: skip
        label_sink = None
        if files.labels is not None:
            label_sink = stack.enter_context(
                RasterSink(
                    files.labels, grid, 1, label_type(number), nodata=0, driver=render.driver,
                    overwrite=render.overwrite, threads=render.threads,
                    metadata=RasterMetadata(("source image",), categorical=True),
                )
            )  # fmt: skip
        copied = sink.reuse_tiles_of(files.mosaic) if reuse is not None else False
        if files.labels is not None and label_sink is not None:
            copied = copied and label_sink.reuse_tiles_of(files.labels)
        # Tiles are kept as compressed bytes: an earlier file of another form has none that fit.
        if reuse is not None and not copied:
            reuse.forget()
        for done, (window, made) in enumerate(in_order(unit, units, blender.engine.threads(render.threads))):
            if isinstance(made, KeptUnit):
                sink.keep(window)
                if label_sink is not None:
                    label_sink.keep(window)
            elif not made.counts[1:].any():  # most units of a mosaic of scattered photos
                sink.write_empty(window)
                if label_sink is not None:
                    label_sink.write_empty(window)
            else:
                sink.write(window, made.values, made.valid, blank=render.nodata is None)
                if label_sink is not None:
                    known = (made.label > 0).view(np.uint8) if render.true_ortho else made.valid
                    label_sink.write(window, made.label[..., None], known, blank=True)
            counts += made.counts
            for fact in made.facts:
                record.add(*fact)
            # Photos that end above these rows are closed: memory is that of a strip of photos.
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
    return RenderedPixels([int(count) for count in counts[1:-1]], int(counts[-1]), record)
