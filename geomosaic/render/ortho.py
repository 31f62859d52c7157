"""Orthos: one image rectified block by block, and the gaps of the DEM that leave them empty."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import DTypeLike

from geomosaic.block import Footprint, OrientedImage
from geomosaic.errors import InputError, listed, warn
from geomosaic.execution.units import map_units, workers_for
from geomosaic.geo.grid import Grid, Window
from geomosaic.options.render import BLOCK_HEIGHT, RenderOptions
from geomosaic.raster.cog.codec import RasterMetadata, Samples
from geomosaic.raster.cog.tiles import WindowTiler, WindowTiles
from geomosaic.raster.files import check_output_size
from geomosaic.raster.info import joined
from geomosaic.raster.sink import RasterProduct, RasterSink
from geomosaic.raster.source import Stack, UnevenStackError
from geomosaic.render.calibrated import check_squares, overview_mean
from geomosaic.render.photo import Photo, Rectifier, refuse_palette
from geomosaic.resample.warp import Colour, Target
from geomosaic.sensor.lattice import Lattice, blocks, finite_median
from geomosaic.sensor.map_to_image import BlockGround, Ground
from geomosaic.surface.model import Surface
from geomosaic.types import FloatArray

if TYPE_CHECKING:
    from shapely import Polygon

    from geomosaic.execution.run_report import RunReport
    from geomosaic.render.accuracy import AccuracyRaster
    from geomosaic.render.occlusion import OcclusionMask


# Pixels of a grid up to which every one is looked at; of larger ones every second, fourth ... along either axis.
SAMPLES = 4_000_000
# Part of the side of what the images cover that is left out along its outline, as true as its corners only.
RIM = 0.004
NAMES = 3
# Output pixels up to which one thread draws. Each thread opens the image and makes its transformations for itself,
# which takes 25 ms of processor time; so many pixels of a small job take 15.
ALONE = 1 << 20


def height_notes(ground: Ground, outlines: Sequence[Footprint]) -> tuple[str, ...]:
    """Notes on the parts of the output that stay empty for want of heights.

    Parameters
    ----------
    ground : Ground
        The surface under the output.
    outlines : sequence of Footprint
        Of the images, in the output map.

    Returns
    -------
    tuple of str
        One note on images that reach past the DEM, one on its holes, with places and a way to correct them.
    """
    surface: Any = ground.surface
    if surface is None or getattr(surface, "gaps", None) is None:
        return ()
    cut = [outline.name for outline in outlines if not outline.complete]
    notes = []
    if cut:
        what = "the image reaches" if len(outlines) == 1 else f"{len(cut)} of {len(outlines)} images reach"
        which = "" if len(outlines) == 1 else f" ({listed(cut, NAMES)})"
        notes.append(
            f"{what} past the heights of the DEM{which}: what lies beyond is left out; give a DEM that covers it"
        )
    if surface.gaps:
        notes += _holes(ground, outlines)
    return tuple(notes)


def _holes(ground: Ground, outlines: Sequence[Footprint]) -> list[str]:
    import shapely

    grid = ground.grid
    covered = shapely.union_all([outline.polygon for outline in outlines]).intersection(shapely.box(*grid.bounds))
    inner = covered.buffer(-max(2 * max(grid.resolution), RIM * math.sqrt(covered.area)))
    shapely.prepare(inner)
    step = 2 ** max(0, math.ceil(math.log2(grid.width * grid.height / SAMPLES) / 2))
    found = [xy for block in blocks(grid.window) if len(xy := _without(ground, grid, block, inner, step))]
    pixels = sum(map(len, found)) * step**2
    if not pixels:
        return []
    x, y = max(found, key=len).mean(axis=0)
    share = 100 * pixels * grid.resolution[0] * grid.resolution[1] / covered.area
    digits = 2 if grid.crs.is_projected or grid.crs.is_engineering else 6
    about = "" if step == 1 else "about "
    return [
        f"the DEM has holes: {about}{pixels} pixels, {share:.2g} % of what the images cover, have no height and stay "
        f"empty, most of them about x {x:.{digits}f}, y {y:.{digits}f}; fill the DEM, for example with gdal_fillnodata"
    ]


def _without(ground: Ground, grid: Grid, block: Window, inner: Polygon, step: int) -> FloatArray:
    """Map places (N, 2) of the pixels of a block, within the outline, that have no height."""
    import shapely

    part = block.intersection(grid.window)
    corners = grid.crop(part).bounds
    if not inner.intersects(shapely.box(*corners)):
        return np.empty((0, 2))
    here = ground.block(part)
    if here.patch is not None and not np.isnan(here.patch.heights).any():
        return np.empty((0, 2))
    c, r = np.meshgrid(np.arange(part.col, part.stop_col, step), np.arange(part.row, part.stop_row, step))
    xy = grid.xy(np.column_stack([c.ravel() + 0.5, r.ravel() + 0.5]))
    if ground.to_surface is not None:
        xy = xy[np.isnan(here.height(ground.to_surface(xy)))]
    places: FloatArray = xy[shapely.contains_xy(inner, xy[:, 0], xy[:, 1])]
    return places


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class OrthoResult(RasterProduct):
    """Ortho that was written, with the accuracy of its geometry.

    Attributes
    ----------
    path : Path
    grid : Grid
    valid_pixels : int
        Pixels that show the image.
    lattice_error : float
        Largest measured interpolation error of the geometry, in image pixels, or output pixels where those are larger.
    tolerance : float
        What it had to stay under.
    scale : float
        Image pixels per output pixel (median over blocks).
    seconds : float
    notes : tuple of str
        What the sensor says of the image: how it was oriented, what was assumed; and where heights are missing.
    hidden_pixels : int, optional
        Pixels that the image covers and the surface hides from it; None where that was not asked.
    placement : mapping, optional
        How control points place the image, and how well, as JSON values.
    placement_file : Path, optional
        The same as a file.
    accuracy : AccuracyRaster, optional
        Standard deviations of position, where they were asked for.
    run : RunReport, optional
        What each worker did; None where threads of the process did everything.
    """

    path: Path
    grid: Grid
    valid_pixels: int
    lattice_error: float
    tolerance: float
    scale: float
    seconds: float
    notes: tuple[str, ...] = ()
    hidden_pixels: int | None = None
    placement: Mapping[str, Any] | None = None
    placement_file: Path | None = None
    accuracy: AccuracyRaster | None = None
    run: RunReport | None = None


@dataclass
class GeometryRecord:
    """Worst lattice error and image scales, gathered block by block.

    Attributes
    ----------
    error : float
        Largest interpolation error so far, pixels as in `OrthoResult.lattice_error`.
    scales : list of float
        Image pixels per output pixel, one a lattice.
    """

    error: float = 0.0
    scales: list[float] = field(default_factory=list)

    def add(self, error: float, scale: float) -> None:
        """Addition of one block's error and scale."""
        self.error = max(self.error, error if np.isfinite(error) else 0.0)
        self.scales.append(scale)

    def judge(self, tolerance: float) -> None:
        """Warning where the tolerance could not be kept: at the walls of a surface model, on a coarse grid."""
        if self.error > tolerance > 0:
            warn(
                f"the geometry is interpolated within {self.error:.3f} px, not {tolerance} px, where the relief is "
                "steepest, a map ends, or neighbouring pixels of the image do not show neighbouring ground"
            )

    @property
    def scale(self) -> float:
        """Median scale."""
        return finite_median(np.array(self.scales))


def _tiles(grid: Grid, width: int) -> list[Window]:
    """Work units of an ortho: rows of blocks from the upper left, `width` output pixels wide."""
    return grid.window.split(width, BLOCK_HEIGHT)


def ortho(
    scene: OrientedImage,
    surface: Surface | None,
    grid: Grid,
    outline: Footprint,
    output: Path,
    options: RenderOptions | None = None,
) -> OrthoResult:
    """Rectify one image onto a surface.

    Parameters
    ----------
    scene : OrientedImage
    surface : Surface or None
        None where the model uses no heights.
    grid : Grid
        The output, see `extent.output_grid`.
    outline : Footprint
        Of the scene in the output map.
    output : Path
        File to write.
    options : RenderOptions

    Returns
    -------
    OrthoResult

    Raises
    ------
    InputError
        The image cannot be read, or shows nothing of the grid.
    OutputError
        Writing failed; no file is left under the final name.
    """
    return stack([scene], surface, grid, [outline], output, options)


def stack(
    scenes: Sequence[OrientedImage],
    surface: Surface | None,
    grid: Grid,
    outlines: Sequence[Footprint],
    output: Path,
    options: RenderOptions | None = None,
) -> OrthoResult:
    """Rectify images of one place as the bands of one raster; valid is what all of them show.

    Parameters
    ----------
    scenes : sequence of OrientedImage
        In the order of their bands. Of those that have one model (the same object) the geometry is computed once.
    surface, grid, output, options
        As `ortho`.
    outlines : sequence of Footprint
        Of the scenes in the output map.

    Returns
    -------
    OrthoResult

    Raises
    ------
    InputError, OutputError
        As `ortho`.
    """
    options = options or RenderOptions()
    started = time.perf_counter()
    drawn = _RectifiedUnits(tuple(scenes), surface, grid, tuple(outlines), options)
    info = drawn.info
    check_output_size(output, grid, info.pixel_bytes, options.max_output)
    record, seen, hidden = GeometryRecord(), 0, 0
    units = _tiles(grid, options.tile)
    try:
        with (
            workers_for(options) as run,
            RasterSink(
                output,
                grid,
                Samples(info.bands, info.dtype, nodata=options.nodata),
                driver=options.driver,
                creation=options.creation,
                overwrite=options.overwrite,
                threads=options.threads,
                metadata=RasterMetadata(
                    info.descriptions,
                    tuple(zip(info.scales, info.offsets, info.units, strict=True)),
                    {"GEOMOSAIC_SENSOR": scenes[0].sensor, "GEOMOSAIC_LATTICE_TOLERANCE_PX": str(options.tolerance)},
                    overviews=overview_mean(scenes, options.resampling),
                ),
            ) as sink,
        ):
            running = options if grid.width * grid.height > ALONE else replace(options, threads=1)
            drawn.tiler = sink.tiler
            rendered = map_units(drawn, units, running)
            for done, (_, (made, shown, facts, behind)) in enumerate(rendered):
                sink.add(made)
                seen += shown
                hidden += behind
                for fact in facts:
                    record.add(*fact)
                options.report(done + 1, len(units), "ortho")
            if not seen:
                one = "the image shows nothing of the output area"
                raise InputError(
                    one if len(scenes) == 1 else "no place in the output area is shown by all images",
                    where=scenes[0].name if len(scenes) == 1 else None,
                    hint="check `bounds`, the DEM's extent and the image's orientation"
                    if len(scenes) == 1
                    else "check `bounds`, and leave out images of another place",
                )
            sink.finish()
    finally:
        drawn.close()
    record.judge(options.tolerance)
    sensor_notes = dict.fromkeys(note for scene in scenes for note in getattr(scene.model, "notes", ()))
    notes = (*sensor_notes, *height_notes(drawn.below, list(outlines)))
    seconds = time.perf_counter() - started
    return OrthoResult(
        path=output,
        grid=grid,
        valid_pixels=seen,
        lattice_error=record.error,
        tolerance=options.tolerance,
        scale=record.scale,
        seconds=seconds,
        notes=notes,
        hidden_pixels=hidden if options.true_ortho else None,
        run=run,
    )


class _RectifiedUnits:
    """Rendering of an ortho's units, each to its tiles; for any thread, and other processes open the images again.

    Parameters
    ----------
    scenes, surface, grid, outlines, options
        As for `stack`.
    tiler : WindowTiler, optional
        Of the raster; to be set before the first unit.
    """

    def __init__(
        self,
        scenes: tuple[OrientedImage, ...],
        surface: Surface | None,
        grid: Grid,
        outlines: tuple[Footprint, ...],
        options: RenderOptions,
        tiler: WindowTiler | None = None,
    ) -> None:
        self._made_of = scenes, surface, grid, outlines
        self._grid, self._options, self.tiler = grid, options, tiler
        check_squares(scenes, options.resampling)
        memory = options.spare_memory // len(scenes)
        self._photos = [
            Photo.open(scene, surface, grid, outline, memory) for scene, outline in zip(scenes, outlines, strict=True)
        ]
        self.info = joined([photo.source.info for photo in self._photos])
        for photo in self._photos:
            refuse_palette(photo.source.info, options.resampling)
        self._layers = _layers(self._photos)
        self._rectifier = Rectifier(grid, options.resampling, options.tolerance)
        self._sight, self.below = None, Ground.under(grid, surface)
        if options.true_ortho:
            from geomosaic.render.occlusion import ground_of, visibility

            self.below = ground_of(grid, surface)
            self._sight = visibility(grid, self.below)

    def __reduce__(self) -> tuple[Any, ...]:
        return _RectifiedUnits, (*self._made_of, replace(self._options, progress=None, workers=None), self.tiler)

    def close(self) -> None:
        """Close the images."""
        for photo in self._photos:
            photo.source.close()

    def __call__(self, unit: Window) -> tuple[WindowTiles, int, list[tuple[float, float]], int]:
        """Tiles, number of valid pixels, errors and scales of the lattices, number of hidden pixels."""
        assert self.tiler is not None
        grid, layers = self._grid, self._layers
        targets = [_blank((unit.height, unit.width), len(layer.bands), self.info.dtype) for layer in layers]
        facts: list[tuple[float, float]] = []
        hidden, bounds = 0, grid.crop(unit).bounds
        for block in blocks(unit) if any(photo.touches(bounds) for photo in self._photos) else ():
            part = block.intersection(grid.window)
            ground = self.below.block(part)
            across = slice(part.col - unit.col, part.stop_col - unit.col)
            for layer, whole in zip(layers, targets, strict=True):
                shades = None if self._sight is None else self._sight.block(ground)
                target = Target(whole.values[:, across], whole.valid[:, across])
                used = layer.fill(self._rectifier, ground, target, shades)
                facts += [(lattice.error, lattice.scale) for lattice in used]
                hidden += 0 if shades is None or layer is not layers[0] else int(np.count_nonzero(shades.mask))
        made = targets[0] if len(layers) == 1 else _interleaved(targets, layers)
        tiles_made = self.tiler.tiles(unit, made.values, made.valid, blank=self._options.nodata is None)
        return tiles_made, int(np.count_nonzero(made.valid.view(np.bool_))), facts, hidden


@dataclass(frozen=True, eq=False)
class _Layer:
    """Images of one geometry, the same read as one photo, and the bands of the output that they fill."""

    photo: Photo
    photos: tuple[Photo, ...]
    bands: list[int]

    def fill(
        self, rectifier: Rectifier, ground: BlockGround, target: Target, shades: OcclusionMask | None
    ) -> list[Lattice]:
        """Fill one block; the lattices used."""
        colour = Colour.identity(len(self.bands))
        try:
            return rectifier.fill(self.photo, ground, colour, target, shades=shades)
        except UnevenStackError:
            # Through a mask of all, one band would lose pixels for what is missing in another; this is rare.
            lattices, start = None, 0
            target.valid[:] = 1
            for photo in self.photos:
                stop = start + photo.source.info.bands
                alone = _blank(target.valid.shape, stop - start, target.values.dtype)
                colour = Colour.identity(stop - start)
                lattices = rectifier.fill(photo, ground, colour, alone, lattices=lattices, shades=shades)
                target.values[..., start:stop] = alone.values
                target.valid[:] &= alone.valid
                start = stop
            target.values[target.valid == 0] = 0
            return lattices or []


def _layers(photos: Sequence[Photo]) -> list[_Layer]:
    """Photos with those that have the same model put together."""
    ends = np.cumsum([photo.source.info.bands for photo in photos])
    alike: dict[int, list[int]] = {}
    for number, photo in enumerate(photos):
        alike.setdefault(id(photo.scene.model), []).append(number)
    layers = []
    for numbers in alike.values():
        same = tuple(photos[i] for i in numbers)
        bands = [band for i in numbers for band in range(ends[i] - photos[i].source.info.bands, ends[i])]
        both = same[0] if len(same) == 1 else replace(same[0], source=Stack([photo.source for photo in same]))
        layers.append(_Layer(both, same, bands))
    return layers


# Rows of all layers that are brought together at once, so that they stay in a processor's second-level cache.
_TOGETHER = 16


def _blank(shape: tuple[int, ...], bands: int, dtype: DTypeLike) -> Target:
    return Target(np.zeros((*shape, bands), dtype=dtype), np.zeros(shape, dtype=np.uint8))


def _interleaved(targets: Sequence[Target], layers: Sequence[_Layer]) -> Target:
    """Layers as one block, zero where any of them sees nothing."""
    valid = np.bitwise_and.reduce([target.valid for target in targets])
    values = np.empty((*valid.shape, sum(len(layer.bands) for layer in layers)), dtype=targets[0].values.dtype)
    for row in range(0, len(valid), _TOGETHER):
        rows = slice(row, row + _TOGETHER)
        for target, layer in zip(targets, layers, strict=True):
            values[rows][..., layer.bands] = target.values[rows]
    if any((target.valid != valid).any() for target in targets):
        values[valid == 0] = 0
    return Target(values, valid)
