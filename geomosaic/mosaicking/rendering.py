"""Pixels of a mosaic, rendered in units: into one file, or into tiles, which workers can write themselves."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from typing import TYPE_CHECKING

import numpy as np

from geomosaic.errors import InputError
from geomosaic.geo.grid import Grid, Window
from geomosaic.mosaicking.blending.block import Blender
from geomosaic.mosaicking.kept_tiles import Tile, WrittenTile, file_facts
from geomosaic.mosaicking.outputs import MosaicFiles, MosaicUnit, label_type
from geomosaic.mosaicking.reruns import Fact, KeptUnit, Reuse, UnitKeys
from geomosaic.mosaicking.tiled_files import write_virtual
from geomosaic.options.mosaic import MosaicOptions
from geomosaic.options.render import BLOCK_HEIGHT
from geomosaic.raster.cog.codec import RasterMetadata, Samples
from geomosaic.raster.cog.tiles import WindowTiler, WindowTiles
from geomosaic.raster.sink import RasterSink
from geomosaic.render.calibrated import overview_mean
from geomosaic.render.occlusion import hidden_label
from geomosaic.render.ortho import GeometryRecord
from geomosaic.render.regions import map_by_regions
from geomosaic.sensor.lattice import blocks

if TYPE_CHECKING:
    from geomosaic.mosaicking.blending.rules import RuleBlender
    from geomosaic.mosaicking.water_filling import WaterBody

# Pixels by label, errors and scales of the lattices, and the tiles of each raster.
RenderedUnit = tuple[Counter[int], list[Fact], list[WindowTiles]]


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
    units : int
        Units of work: windows of one file, or tiles.
    kept : int
        Tiles taken from an earlier run, those without a file among them.
    tiles : dict of Window to (MosaicFiles, WrittenTile)
        Tiles with a file, by their place; empty for a mosaic in one file.
    """

    by_image: list[int]
    hidden: int
    geometry: GeometryRecord
    units: int
    kept: int = 0
    tiles: dict[Window, tuple[MosaicFiles, WrittenTile]] = field(default_factory=dict)

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

    def __call__(self, unit: RenderUnit) -> RenderedUnit:
        """Pixels by label, errors and scales of the lattices, and the tiles of each raster."""
        blender, raster = self.blender, unit.raster
        made = MosaicUnit.empty(unit.window, blender.info.bands, blender.dtype, len(blender.photos))
        for block in blocks(unit.window):
            blender.fill(block.intersection(blender.grid.window), made)
        for pool in self.water:
            pool.paint(made, blender.grid)
        tilers = [one.of_size(raster.width, raster.height) for one in self.tilers]
        shown = +made.counts  # without zeros
        return shown, made.facts, self._tiles(made, unit.place, tilers)

    def _tiles(self, made: MosaicUnit, place: Window, tilers: Sequence[WindowTiler]) -> list[WindowTiles]:
        if made.counts.total() == made.counts[0]:  # most units of a mosaic of scattered photos
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
    keys: UnitKeys | None = None,
) -> RenderedPixels:
    """Mosaic and label raster, written unit by unit.

    Parameters
    ----------
    blender : Blender or RuleBlender
    files : MosaicFiles
    options : MosaicOptions
    reuse : Reuse, optional
        Units of an earlier run, for one file.
    water : sequence of WaterBody
        Water to be filled with a tone.
    keys : UnitKeys, optional
        For a mosaic in tiles: digests of all that its windows depend on, by which those of an earlier run are kept.

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
    overviews = overview_mean(blender.photos.scenes, options.render.resampling)
    work = _Work(blender, files, options, tuple(water), overviews)
    pixels = work.one_file(reuse) if keys is None else work.in_tiles(keys)
    pixels.geometry.judge(options.render.tolerance)
    return pixels


@dataclass(frozen=True)
class _Work:
    """Rasters of a mosaic and what fills them; sent as it is to workers that write whole tiles."""

    blender: Blender | RuleBlender
    files: MosaicFiles
    options: MosaicOptions
    water: tuple[WaterBody, ...]
    overviews: str

    def one_file(self, reuse: Reuse | None) -> RenderedPixels:
        """Mosaic in one file, with units of an earlier run where they are known."""
        render, grid = self.options.render, self.blender.grid
        counts, record = Counter[int](), GeometryRecord()
        units = _units(grid.window, render.tile)
        with ExitStack() as stack:
            sinks = [stack.enter_context(one) for one in self._sinks(self.files, grid)]
            kept = _kept_units(units, sinks, reuse)
            left = [unit for unit in units if kept.get(unit) is None]
            computed = stack.enter_context(closing(self._computed(sinks, left, len(left))))
            for done, unit in enumerate(units, start=1):
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
                counts.update(shown)
                for fact in facts:
                    record.add(*fact)
                # Photos that end above these rows are closed: memory is that of a strip of photos.
                self.blender.photos.passed(unit.window.row)
                render.report(done, len(units), "mosaic")
            pixels = self._pixels(counts, record, len(units))
            render.report(0, 1, "writing")
            for one in sinks:
                one.finish()
        return pixels

    def in_tiles(self, keys: UnitKeys) -> RenderedPixels:
        """Mosaic in tiles; those of an earlier run are kept where they would be made the same."""
        render, grid = self.options.render, self.blender.grid
        places = self.files.rasters(grid, self.options.records.tiling)
        tiles = [Tile(window, own, keys.key(window)) for window, own in places.items()]
        found = {tile.window: WrittenTile.of(tile) for tile in tiles}
        done = {window: written for window, written in found.items() if written is not None}
        count, total = len(done), sum(_unit_count(tile.window, render.tile) for tile in tiles)
        if count < len(tiles):
            self.files.remove_virtual()
        if render.workers is not None and count < len(tiles):
            left = [tile for tile in tiles if tile.window not in done]
            before = sum(_unit_count(window, render.tile) for window in done)
            with closing(self._whole_tiles(left)) as computed:
                for tile, written in computed:
                    if written is not None:
                        done[tile.window] = written
                    before += _unit_count(tile.window, render.tile)
                    render.report(before, total, "mosaic")
        # Here, with threads; or with workers that do not see the folder of the tiles, and send pixels.
        left = [tile for tile in tiles if tile.window not in done]
        before = sum(_unit_count(window, render.tile) for window in done)
        for tile, written in self._by_units(left, lambda more: render.report(before + more, total, "mosaic")):
            done[tile.window] = written
        counts, record = Counter[int](), GeometryRecord()
        for written in (done[window] for window in places):
            counts.update(written.counts)
            for fact in written.facts:
                record.add(*fact)
        pixels = self._pixels(counts, record, len(tiles))
        shown = {window: (own, done[window]) for window, own in places.items() if done[window].files}
        write_virtual(self.files, grid, {window: own for window, (own, _) in shown.items()})
        return replace(pixels, kept=count, tiles=shown)

    def _by_units(
        self, tiles: Sequence[Tile], report: Callable[[int], None]
    ) -> Generator[tuple[Tile, WrittenTile], None, None]:
        """Tiles written here, from units that are rendered wherever the options say."""
        width, done = self.options.render.tile, 0
        units = (unit for tile in tiles for unit in _units(tile.window, width))
        number = sum(_unit_count(tile.window, width) for tile in tiles)
        computed: Generator[tuple[RenderUnit, RenderedUnit], None, None] | None = None

        def one_more() -> None:
            nonlocal done
            done += 1
            report(done)

        with ExitStack() as running:
            for tile in tiles:
                with ExitStack() as stack:
                    sinks = [stack.enter_context(one) for one in self._sinks_of(tile)]
                    if computed is None:
                        computed = running.enter_context(closing(self._computed(sinks, units, number)))
                    own = islice(computed, _unit_count(tile.window, width))
                    yield tile, self.write_tile(tile, sinks, (made for _, made in own), one_more)
                self.blender.photos.passed(tile.window.row)

    def write_tile(
        self, tile: Tile, sinks: Sequence[RasterSink], made: Iterable[RenderedUnit], report: Callable[[], None]
    ) -> WrittenTile:
        """One tile from its units, in their order; nothing is written of one that shows nothing."""
        counts, record = Counter[int](), GeometryRecord()
        for shown, facts, pieces in made:
            for one, its in zip(sinks, pieces, strict=True):
                one.add(its)
            counts.update(shown)
            for fact in facts:
                record.add(*fact)
            report()
        shows = any(self._is_image(label) for label in counts)
        for one in sinks:
            if shows:
                one.finish()
            else:
                one.path.unlink(missing_ok=True)
        written = WrittenTile(
            tile.key,
            dict(sorted(counts.items())),
            [(record.error, record.scale)] if record.scales else [],
            {one.path.name: file_facts(one.path) for one in sinks if shows},
        )
        written.save(tile)
        return written

    def write_whole_tile(self, tile: Tile) -> WrittenTile:
        """One tile rendered and written here."""
        with ExitStack() as stack:
            sinks = [stack.enter_context(one) for one in self._sinks_of(tile)]
            rendered = self._rendered(sinks)
            units = _units(tile.window, self.options.render.tile)
            return self.write_tile(tile, sinks, map(rendered, units), lambda: None)

    def _as_sent(self) -> _Work:
        """Work without what belongs to this process."""
        render = replace(self.options.render, workers=None, progress=None, threads=1, overwrite=True)
        return replace(self, options=replace(self.options, render=render))

    def _computed(
        self, sinks: Sequence[RasterSink], units: Iterable[RenderUnit], number: int
    ) -> Generator[tuple[RenderUnit, RenderedUnit], None, None]:
        """Units in their order, computed wherever the options say."""
        render = self.options.render
        # Each thread keeps memory of its own: no more of them than there are units to be computed.
        limited = replace(render, threads=max(1, min(render.threads, number)))
        images = len(self.blender.photos)
        return map_by_regions(lambda near: self._only(near)._rendered(sinks), units, self._near, images, limited)

    def _whole_tiles(self, tiles: Iterable[Tile]) -> Generator[tuple[Tile, WrittenTile | None], None, None]:
        """Tiles as workers have written them; None for those whose folder a worker does not see."""
        sent, token, images = self._as_sent(), self.files.token, len(self.blender.photos)
        whole = partial(_WholeTiles, token=token)
        return map_by_regions(lambda near: whole(sent._only(near)), tiles, self._near, images, self.options.render)

    def _near(self, unit: RenderUnit | Tile) -> list[int]:
        """Numbers of the images that a unit depends on."""
        return self.blender.photos.near(unit.window.grown(self.blender.reach))

    def _only(self, near: Collection[int] | None) -> _Work:
        """Work for a region that depends on these images."""
        return self if near is None else replace(self, blender=self.blender.only(near))

    def _rendered(self, sinks: Sequence[RasterSink]) -> RenderedUnits:
        render, tilers = self.options.render, tuple(one.tiler for one in sinks)
        return RenderedUnits(self.blender, tilers, self.water, render.nodata, render.true_ortho)

    def _sinks_of(self, tile: Tile) -> Iterator[RasterSink]:
        return self._sinks(tile.files, self.blender.grid.crop(tile.window))

    def _sinks(self, files: MosaicFiles, grid: Grid) -> Iterator[RasterSink]:
        """Rasters of the mosaic and its labels, or of one of their tiles."""
        blender, render, number = self.blender, self.options.render, len(self.blender.photos)
        # What stands under the name of a tile is that of an earlier run: the folder was free, or may be replaced.
        overwrite = render.overwrite or self.files.tiled
        yield RasterSink(
            files.mosaic, grid, Samples(blender.info.bands, blender.dtype, nodata=render.nodata),
            creation=render.creation, driver=render.driver, overwrite=overwrite, threads=render.threads,
            metadata=RasterMetadata(
                blender.info.descriptions, tags={"GEOMOSAIC_IMAGES": str(number)},
                overviews=self.overviews,
            ),
        )  # fmt: skip
        if files.labels is not None:
            yield RasterSink(
                files.labels, grid, Samples(1, label_type(number), nodata=0), driver=render.driver,
                overwrite=overwrite, threads=render.threads,
                metadata=RasterMetadata(("source image",), categorical=True),
            )  # fmt: skip

    def _is_image(self, label: int) -> bool:
        """Whether pixels of a label show something: they are neither empty nor hidden."""
        return 0 < label <= len(self.blender.photos)

    def _pixels(self, counts: Counter[int], record: GeometryRecord, units: int) -> RenderedPixels:
        """Counts of a whole mosaic, which shows something."""
        if not any(self._is_image(label) for label in counts):
            raise InputError(
                "no image shows anything of the output area",
                hint="check `bounds`, the images' nodata and the DEM's extent",
            )
        images = len(self.blender.photos)
        by_image = [counts[label] for label in range(1, images + 1)]
        return RenderedPixels(by_image, counts[hidden_label(images)], record, units)


@dataclass(frozen=True)
class _WholeTiles:
    """Rendering of whole tiles to their files, by workers that see the folder."""

    work: _Work
    token: str

    def __call__(self, tile: Tile) -> WrittenTile | None:
        """The tile as it was written; None where this process does not see the folder, or sees another one."""
        # A folder of the same path may be on a disk of the worker's own.
        return self.work.write_whole_tile(tile) if self.work.files.token == self.token else None


def _units(raster: Window, width: int) -> list[RenderUnit]:
    """Units of a raster file, row by row."""
    return [RenderUnit(window, raster) for window in raster.split(width, BLOCK_HEIGHT)]


def _unit_count(raster: Window, width: int) -> int:
    """Number of units of a raster file."""
    return -(-raster.width // width) * -(-raster.height // BLOCK_HEIGHT)


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
