"""Accuracy rasters: the standard deviation of position of every place of an ortho or a mosaic.

Errors on level ground and the tangent of the view angle are smooth over an image: they are propagated exactly at nodes
of a net, as far below and above the ground there as the ground departs from the net, and interpolated. Slope and
standard deviation of the heights, which are not smooth, are taken at each cell (`geomosaic.sensor.error_propagation`
has the formulas). A linear mean of covariances is a covariance, so no variance can become negative on the way.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geomosaic.block import OrientedBlock, OrientedImage
from geomosaic.errors import InputError, counted
from geomosaic.execution.units import map_units
from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.units import metres_per_unit
from geomosaic.interpolation import interval
from geomosaic.raster.cog.codec import RasterMetadata, Samples
from geomosaic.raster.cog.tiles import WindowTiler, WindowTiles
from geomosaic.raster.sink import RasterProduct, RasterSink
from geomosaic.raster.source import Source
from geomosaic.sensor.error_propagation import InputUncertainty, LevelErrors
from geomosaic.sensor.map_to_image import Ground, MapToImage
from geomosaic.stores.path import to_path
from geomosaic.surface.dem import height_sigmas
from geomosaic.surface.model import Surface
from geomosaic.types import AnyArray, FloatArray, IntArray

if TYPE_CHECKING:
    from geomosaic.options.render import RenderOptions, UncertaintyOptions

# Side in cells of a unit of work: a tile of the raster; and of a strip of it whose arrays stay in a processor's cache.
TILE, STRIP = 512, 64
# Nodes along a side of a unit, every 32 cells: a covariance is nearly quadratic in the image, and bends by less than
# 0.1 % between them unless the image has fewer than some 500 cells across.
NODES = 17
# Least 1 − g·t, above which a slope lengthens errors at most tenfold. Where a line of sight grazes the ground, or the
# ground hides itself, propagation of first order says nothing.
GRAZING = 0.1
DIRECTIONS = ("along x", "along y", "along the view", "across the view")
BANDS = 5
# Bins of the histogram of standard deviations, metres: 0.5 % apart, from 0.01 mm to 100 km.
_BINS = np.geomspace(1e-5, 1e5, 4618)


@dataclass(frozen=True, eq=False, repr=False)
class AccuracyRaster(RasterProduct):
    """Raster of standard deviations that was written, and what it shows.

    Attributes
    ----------
    path : Path
        Bands: standard deviations along x and along y of the map, metres; their correlation; standard deviations along
        and across the view, metres: the direction in which an error of the height moves a place, and the one square to
        it, which knows nothing of heights.
    grid : Grid
        Of its cells.
    parts : tuple of str
        Sources of error that are in it.
    cells : int
        Cells with a value.
    rms : (float, float)
        Root mean square of the standard deviations along x and y, metres.
    rms_of_view : (float, float)
        The same along and across the view.
    quantiles : mapping of float to float
        By share of the area: standard deviation of position in plan, √(σx² + σy²), that it does not exceed, metres.
    images : mapping of str to float
        Root mean square of that standard deviation in the cells of each image, metres.
    notes : tuple of str
        Where the covariances come from, and what is not known.
    target : float, optional
        Largest admissible error of position in plan, metres.
    """

    path: Path
    grid: Grid
    parts: tuple[str, ...]
    cells: int
    rms: tuple[float, float]
    rms_of_view: tuple[float, float]
    quantiles: Mapping[float, float]
    images: Mapping[str, float]
    notes: tuple[str, ...] = ()
    target: float | None = None

    @property
    def plan(self) -> float:
        """Root mean square of the standard deviations of position in plan, metres."""
        return math.hypot(*self.rms)

    @property
    def facts(self) -> dict[str, Any]:
        """JSON values."""
        return {
            "file": self.path.name,
            "errors_of": list(self.parts),
            "rms_x_m": self.rms[0],
            "rms_y_m": self.rms[1],
            "rms_along_view_m": self.rms_of_view[0],
            "rms_across_view_m": self.rms_of_view[1],
            "rms_plan_m": self.plan,
            "quantiles_m": {f"{share:g}": value for share, value in self.quantiles.items()},
            "rms_by_image_m": dict(self.images),
            "target_m": self.target,
            "notes": list(self.notes),
        }


def raster_lines(facts: Mapping[str, Any]) -> list[str]:
    """Expected errors in words, a few lines.

    Parameters
    ----------
    facts : mapping
        Of `AccuracyRaster.facts`.
    """
    x, y, along, across, plan = (facts[f"rms_{name}_m"] for name in ("x", "y", "along_view", "across_view", "plan"))
    within = facts["quantiles_m"]
    shares = f"half of the area within {within['0.5']:.3g} m, 95 % within {within['0.95']:.3g} m"
    lines = [
        f"{facts['file']}: expected errors (one standard deviation) of {' and '.join(facts['errors_of'])}",
        f"RMS {x:.3g} m along x, {y:.3g} m along y, {plan:.3g} m in plan; {shares}",
        f"RMS {along:.3g} m along the view, where heights count, {across:.3g} m across it",
    ]
    images = facts["rms_by_image_m"]
    worst = max(images, key=lambda name: images[name])
    if images[worst] > 1.5 * plan:
        lines.append(f"least accurate image: {worst}, {images[worst]:.3g} m in plan")
    target = facts["target_m"]
    if target is not None:
        met = "kept" if plan <= target else "MISSED"
        lines.append(f"target of {target:g} m in plan: {met} by expectation; check points would prove it")
    return [*lines, *facts["notes"]]


@dataclass(frozen=True, eq=False)
class Uncertainties:
    """Uncertainties of a block's images and of the heights of its ground.

    Attributes
    ----------
    images : tuple of InputUncertainty
    height : float, Surface or None
        Standard deviation of the heights, metres.
    lattice : float
        Standard deviation of the interpolated geometry, in image pixels, or output pixels where those are larger.
    step : int
        Output pixels along a cell of the raster.
    parts : tuple of str
        Sources of error that are known.
    notes : tuple of str
    """

    images: tuple[InputUncertainty, ...]
    height: float | Surface | None
    lattice: float
    step: int
    parts: tuple[str, ...]
    notes: tuple[str, ...]

    @classmethod
    def of(cls, block: OrientedBlock, options: UncertaintyOptions, render: RenderOptions) -> Uncertainties:
        """Uncertainties of a block whose images know their covariances.

        Parameters
        ----------
        block : OrientedBlock
        options : UncertaintyOptions
        render : RenderOptions

        Raises
        ------
        InputError
            Nothing is known of any source of error.
        """
        # The nearest pixel's centre lies anywhere within half a pixel of the place; other resampling takes its value at
        # the place itself.
        nearest = 1.0 / math.sqrt(12.0) if render.resampling == "nearest" else 0.0
        pixel = math.hypot(options.sigma_px or 0.0, nearest)
        height = _heights_of(block.surface, options.sigma_dem)
        images = tuple(InputUncertainty(pixel, height, scene.covariance) for scene in block.scenes)
        known = sum(scene.covariance is not None for scene in block.scenes)
        parts, notes = [], _sources(block.scenes)
        if known:
            of = "" if known == len(images) else f" of {known} of {counted(len(images), 'image')}"
            parts.append(f"orientation{of}")
        if height is not None:
            parts.append("heights")
        elif block.surface is not None:
            notes.append("heights take no part in the error: nothing says how well they are known (`sigma_dem` would)")
        if options.sigma_px is not None:
            parts.append("places in the image")
        if not parts:
            raise InputError(
                "nothing says how accurate the images or the heights are",
                where="`accuracy`",
                hint="give `sigma_dem`, `sigmas` of the orientation, control points, or a table with sigma_x ...",
            )
        # Errors of the lattice are within the tolerance, and as likely anywhere between.
        lattice = render.tolerance / math.sqrt(3.0)
        return cls(images, height, lattice, options.accuracy_step, (*parts, "interpolation"), tuple(notes))

    def of_image(self, number: int) -> Uncertainties:
        """Uncertainties of one of the images alone."""
        return replace(self, images=(self.images[number],))


def _heights_of(surface: Surface | None, given: float | Path | None) -> float | Surface | None:
    """Standard deviation of the heights of a surface: as it is given, else as the surface has it."""
    if given is None:
        # A surface of tie points knows how good it is.
        return getattr(surface, "sigma", None)
    if surface is None:
        raise InputError(
            "`sigma_dem` would do nothing: the images use no heights", hint="leave out `sigma_dem`, or give a `dem`"
        )
    own = getattr(surface, "path", None)
    if isinstance(given, Path) and own and to_path(own).resolve() == given.resolve():
        raise InputError(
            "this is the DEM, and no raster of its standard deviations",
            where="`sigma_dem`",
            hint="give metres, or the raster of standard deviations that came with the DEM",
        )
    return height_sigmas(given)


def _sources(scenes: Sequence[OrientedImage]) -> list[str]:
    """Where the covariances come from, each source once with the number of its images."""
    count: dict[str, int] = {}
    for scene in scenes:
        source = scene.known_by
        if not source and scene.covariance is None:
            source = "the orientation takes no part in the error: nothing says how well it is known"
        if source:
            count[source] = count.get(source, 0) + 1
    if len(count) == 1:
        return list(count)
    shown = sorted(count.items(), key=lambda item: -item[1])
    rest = sum(number for _, number in shown[3:])
    lines = [f"{counted(number, 'image')}: {text}" for text, number in shown[:3]]
    return [*lines, f"{counted(rest, 'image')}: other sources"] if rest else lines


@dataclass(frozen=True, eq=False)
class _Cells:
    """Ground of a window of cells.

    Attributes
    ----------
    window : Window
    nodes : array (NODES, NODES)
        Height at the nodes of the window, metres.
    above : array (rows, cols)
        Height above what is interpolated between them; NaN where unknown, 0 where heights play no part.
    slope : array (2, rows, cols)
        Metres of height per metre along x and y of the map.
    sigma : array (rows, cols)
        Standard deviation of the heights, metres; 0 where unknown everywhere.
    """

    window: Window
    nodes: FloatArray
    above: FloatArray
    slope: FloatArray
    sigma: FloatArray


def write_accuracy(
    path: Path,
    shown: Path,
    block: OrientedBlock,
    grid: Grid,
    known: Uncertainties,
    render: RenderOptions,
    *,
    labelled: bool = True,
) -> AccuracyRaster:
    """Raster of standard deviations of position; NaN where nothing is shown or heights are unknown.

    Across a seam the image with the most weight counts. What is blended there lies between the places where both
    images show it, so that its error is no larger than the larger of theirs.

    Parameters
    ----------
    path : Path
        Bands of float32, see `AccuracyRaster`.
    shown : Path
        Raster of source images, or an ortho.
    block : OrientedBlock
    grid : Grid
        Of the ortho or mosaic.
    known : Uncertainties
        Of the block.
    render : RenderOptions
    labelled : bool
        False where `shown` is an ortho.

    Returns
    -------
    AccuracyRaster

    Raises
    ------
    InputError
        The standard deviations of heights cover nothing of the output, or are none.
    OutputError
    """
    fields = _Fields.of(block, grid, known)
    units = fields.grid.window.split(TILE, TILE)
    total = _Totals(len(block.scenes))
    of = " and ".join(known.parts)
    x, y, *view = (f"standard deviation {which}, metres, of {of}" for which in DIRECTIONS)
    metres = (1.0, 0.0, "m")
    units_of = (metres, metres, (1.0, 0.0, ""), metres, metres)
    metadata = RasterMetadata((x, y, "correlation along x and y", *view), units_of)
    with (
        Source(str(shown)) as source,
        RasterSink(
            path, fields.grid, Samples(BANDS, "float32", nodata=float("nan")), driver=render.driver,
            overwrite=render.overwrite, threads=render.threads, metadata=metadata,
        ) as sink,
    ):  # fmt: skip
        work = _AccuracyUnits(fields, source, sink.tiler, labelled)
        for done, (_, (made, sums)) in enumerate(map_units(work, units, render)):
            sink.add(made)
            total.add(sums)
            render.report(done + 1, len(units), "accuracy")
        sink.finish()
    names_of = [scene.name for scene in block.scenes]
    return AccuracyRaster(path, fields.grid, known.parts, *total.summary(names_of), (*known.notes, *total.notes))


@dataclass(frozen=True, eq=False)
class _AccuracyUnits:
    """Standard deviations in the units of a raster, each to its tiles and sums; for any thread or process."""

    fields: _Fields
    shown: Source
    tiler: WindowTiler
    labelled: bool

    def __call__(self, window: Window) -> tuple[WindowTiles, _Sums]:
        fields = self.fields
        label = _labels(self.shown, window, fields.known.step, self.labelled)
        label[label > len(fields.block.scenes)] = 0  # hidden from all
        values = fields.window(window, label)
        tiles = self.tiler.tiles(window, values, np.isfinite(values[..., 0]).view(np.uint8))
        return tiles, _Sums.of(values, label)


def _labels(source: Source, window: Window, step: int, labelled: bool) -> IntArray:
    """Number of the image that each cell shows, from 1; 0 where none."""
    # The pixel in its middle stands for a cell, or the overviews' where there are any; beyond the end the last one.
    size = source.info.width, source.info.height
    first = [min(at * step + step // 2, end - 1) for at, end in zip((window.col, window.row), size, strict=True)]
    cells = window.width, window.height
    count = [min(n, (end - 1 - at) // step + 1) for n, at, end in zip(cells, first, size, strict=True)]
    values, valid = source.read_decimated((first[0], first[1]), (count[0], count[1]), step)
    label = values[..., 0].astype(np.int64) if labelled else np.ones(values.shape[:2], dtype=np.int64)
    label = label if valid is None else np.where(valid > 0, label, 0)
    return np.pad(label, ((0, cells[1] - count[1]), (0, cells[0] - count[0])), mode="edge")


@dataclass(frozen=True, eq=False)
class _Fields:
    """Standard deviations of the images of a block over a grid of cells; other processes make its maps again."""

    block: OrientedBlock
    output: Grid
    grid: Grid
    pixel: float
    ground: Ground
    sigmas: Ground | None
    mappers: tuple[MapToImage, ...]
    known: Uncertainties

    @classmethod
    def of(cls, block: OrientedBlock, grid: Grid, known: Uncertainties) -> _Fields:
        """Fields over cells of some pixels of a grid."""
        cells, surface = grid.coarser(known.step), block.surface
        height = known.height
        sigmas = None if height is None or isinstance(height, float) else Ground.under(cells, height)
        crs = None if surface is None else surface.crs
        mappers = tuple(MapToImage.between(grid.crs, crs, scene.model) for scene in block.scenes)
        pixel = float(grid.resolution[0])
        return cls(block, grid, cells, pixel, Ground.under(cells, surface), sigmas, mappers, known)

    def __reduce__(self) -> tuple[Any, ...]:
        return _Fields.of, (self.block, self.output, self.known)

    def window(self, window: Window, label: IntArray) -> AnyArray:
        """Values (rows, cols, BANDS) of a window whose cells show the images of `label`."""
        out = np.full((*label.shape, BANDS), np.nan, dtype=np.float32)
        numbers = np.unique(label[label > 0]).tolist()
        if not numbers:
            return out
        cells = self._cells(window)
        for number in numbers:
            self._fill(out, cells, label == number, number - 1)
        return out

    def _cells(self, window: Window) -> _Cells:
        shape = window.height, window.width
        height = self.known.height
        sigma = np.full(shape, height if isinstance(height, float) else 0.0)
        if self.sigmas is not None:
            sigma = _heights(self.sigmas, window)
            if (sigma < 0.0).any():
                raise InputError(
                    f"a standard deviation of {np.nanmin(sigma):g} m is negative",
                    where="`sigma_dem`",
                    hint="give a raster of standard deviations, not of heights",
                )
        if self.ground.surface is None:
            return _Cells(window, np.zeros((NODES, NODES)), np.zeros(shape), np.zeros((2, *shape)), sigma)
        # One cell more on each side, for slopes.
        z = _heights(self.ground, Window(window.col - 1, window.row - 1, window.width + 2, window.height + 2))
        along, down = _differences(z[1:-1], 1), _differences(z[:, 1:-1], 0)
        t = self.grid.transform
        metres = self._metres(np.array([[window.col + window.width / 2, window.row + window.height / 2]]))[0, :2]
        # A cell goes (a, d) along a row and (b, e) down a column: derivatives by the map are those by cells times the
        # inverse.
        (xx, xy), (yx, yy) = (np.linalg.inv(np.array([[t.a, t.b], [t.d, t.e]])) / metres).tolist()
        slope = np.stack([along * xx + down * yx, along * xy + down * yy])
        z = z[1:-1, 1:-1]
        at = (np.linspace(0, size - 1, NODES).round().astype(np.int64) for size in shape)
        nodes = z[np.ix_(*at)]
        nodes = np.where(np.isfinite(nodes), nodes, np.nanmedian(z) if np.isfinite(z).any() else 0.0)
        return _Cells(window, nodes, z - _between(nodes, *map(_intervals, shape)), slope, sigma)

    def _metres(self, colrow: FloatArray) -> FloatArray:
        """Metres in a unit of x, y and height (N, 3) at cells."""
        xy = self.grid.xy(colrow)
        return np.column_stack([metres_per_unit(self.grid.crs, xy), np.ones(len(xy))])

    def _fill(self, out: AnyArray, cells: _Cells, here: AnyArray, number: int) -> None:
        """Values of the cells that one image shows."""
        above = np.abs(cells.above[here])
        most = float(np.fmax.reduce(above))
        if math.isnan(most):
            return
        # Of ground that is as the net to a millimetre one height is enough.
        levels = (0.0,) if most < 1e-3 or not self.mappers[number].uses_heights else (-most, most)
        nodes = [self._nodes(cells.window, number, cells.nodes + level) for level in levels]
        shown, wide = (np.flatnonzero(here.any(axis=axis)) for axis in (1, 0))
        cols = slice(int(wide[0]), int(wide[-1]) + 1)
        down, across = (_intervals(size) for size in here.shape)
        across = across[0][cols], across[1][cols]
        for row in range(int(shown[0]), int(shown[-1]) + 1, STRIP):
            part = slice(row, min(row + STRIP, int(shown[-1]) + 1)), cols
            level = [_between(each, (down[0][part[0]], down[1][part[0]]), across) for each in nodes]
            above = cells.above[part]
            # NaN, where the height is unknown, spreads from here.
            fields = level[0] + (0.0 * above if len(level) == 1 else (0.5 + 0.5 / most * above) * (level[1] - level[0]))
            found = _on_ground(fields, cells.slope[(slice(None), *part)], cells.sigma[part])
            np.copyto(out[part], found, where=here[part][..., None])

    def _nodes(self, window: Window, number: int, heights: FloatArray) -> FloatArray:
        """Covariance (xx, xy, yy) on level ground and tangent (x, y) of the view at nodes (5, NODES, NODES)."""
        cols, rows = (np.linspace(0, size, NODES) for size in (window.width, window.height))
        c, r = np.meshgrid(window.col + cols, window.row + rows)
        colrow = np.column_stack([c.ravel(), r.ravel()])
        places = np.column_stack([self.grid.xy(colrow), heights.ravel()])
        mapper, metres = self.mappers[number], self._metres(colrow)

        def to_model(points: FloatArray) -> FloatArray:
            ground: FloatArray = mapper.to_model(np.column_stack([mapper.surface_xy(points[:, :2]), points[:, 2]]))
            return ground

        level = LevelErrors.at(mapper.model, to_model, places, metres, self.known.images[number])
        spread = (self.known.lattice * np.maximum(level.sampling, self.pixel * metres[:, 0])) ** 2
        c = level.covariance
        fields = [c[:, 0, 0] + spread, c[:, 0, 1], c[:, 1, 1] + spread, *level.tangent.T]
        return np.stack(fields).reshape(5, NODES, NODES)


def _heights(ground: Ground, window: Window) -> FloatArray:
    """Values (rows, cols) of a surface at the centres of cells."""
    cols, rows = (np.linspace(0, size, NODES) for size in (window.width, window.height))
    c, r = np.meshgrid(window.col + cols, window.row + rows)
    xy = ground.grid.xy(np.column_stack([c.ravel(), r.ravel()]))
    assert ground.to_surface is not None
    # Between nodes two maps differ by parts of a millionth of the distance.
    nodes = np.moveaxis(ground.to_surface(xy).reshape(NODES, NODES, 2), -1, 0)
    places = _between(nodes, _intervals(window.height), _intervals(window.width)).reshape(2, -1).T
    return ground.block(window).height(places).reshape(window.height, window.width)


def _intervals(size: int) -> tuple[IntArray, FloatArray]:
    """Node before the centre of each cell of an axis, and the part of the way to the next."""
    return interval((np.arange(size) + 0.5) / size * (NODES - 1), NODES)


def _between(nodes: FloatArray, down: tuple[IntArray, FloatArray], across: tuple[IntArray, FloatArray]) -> FloatArray:
    """Fields (..., rows, cols) between nodes (..., NODES, NODES)."""
    # Not as products of matrices: libraries of linear algebra sum them in an order that depends on the processor.
    known = np.asarray(np.isfinite(nodes).all(axis=tuple(range(nodes.ndim - 2))))
    if not known.all():  # beyond a horizon: the nodes that see ground tell
        weight = _between(np.where(known, 1.0, 0.0), down, across)
        found = _between(np.where(known, nodes, 0.0), down, across)
        return np.divide(found, weight, out=np.full_like(found, np.nan), where=weight > 0.0)
    (above, lower), (left, right) = down, across
    part = lower[:, None]
    rows = nodes[..., above, :] * (1.0 - part) + nodes[..., above + 1, :] * part
    fields: FloatArray = rows[..., left] * (1.0 - right) + rows[..., left + 1] * right
    return fields


def _on_ground(level: FloatArray, slope: FloatArray, sigma: FloatArray) -> FloatArray:
    """Bands (rows, cols, BANDS) on sloping ground of fields (5, rows, cols)."""
    xx, xy, yy, tx, ty = level
    gx, gy = slope
    facing = np.maximum(1.0 - gx * tx - gy * ty, GRAZING)
    ux, uy = tx / facing, ty / facing
    # S = I + u·gᵀ, see `error_propagation`; S·t = u.
    sxx, sxy, syx, syy = 1.0 + ux * gx, ux * gy, uy * gx, 1.0 + uy * gy
    of_heights = sigma * sigma
    vx = sxx * sxx * xx + 2.0 * sxx * sxy * xy + sxy * sxy * yy + of_heights * ux * ux
    vy = syx * syx * xx + 2.0 * syx * syy * xy + syy * syy * yy + of_heights * uy * uy
    vxy = sxx * syx * xx + (sxx * syy + sxy * syx) * xy + sxy * syy * yy + of_heights * ux * uy
    # An error of the height moves a place along u; straight below the sensor there is no such direction, and x serves.
    length = np.hypot(tx, ty)
    ex, ey = (np.divide(t, length, out=np.full_like(t, i), where=length > 0.0) for t, i in ((tx, 1.0), (ty, 0.0)))
    cross = 2.0 * ex * ey * vxy
    along, across = ex * ex * vx + cross + ey * ey * vy, ey * ey * vx - cross + ex * ex * vy
    x, y, along, across = (np.sqrt(np.maximum(v, 0.0)) for v in (vx, vy, along, across))
    both = x * y
    return np.stack([x, y, np.divide(vxy, both, out=np.zeros_like(both), where=both > 0.0), along, across], axis=-1)


def _differences(z: FloatArray, axis: int) -> FloatArray:
    """Change of height per cell, of the side that is known where one is not; 0 where neither is."""
    change = np.diff(z, axis=axis)
    count = change.shape[axis]
    before, after = (np.take(change, np.arange(*ends), axis=axis) for ends in ((0, count - 1), (1, count)))
    before, after = np.where(np.isnan(before), after, before), np.where(np.isnan(after), before, after)
    return np.nan_to_num((before + after) / 2.0)


@dataclass(frozen=True, eq=False)
class _Sums:
    """Sums over the cells of a window.

    Attributes
    ----------
    shown : int
        Cells that show an image.
    images : int array (K,)
        Numbers of those of cells with a value.
    counts : int array (K,)
    squares : array (K, 4)
        Sums of the squared standard deviations in `DIRECTIONS`, square metres.
    histogram : int array (bins,)
        Of those in plan.
    largest : float
        Of those in plan.
    """

    shown: int
    images: IntArray
    counts: IntArray
    squares: FloatArray
    histogram: IntArray
    largest: float

    @classmethod
    def of(cls, values: AnyArray, label: IntArray) -> _Sums:
        """Sums of a window's values (rows, cols, BANDS)."""
        seen = np.isfinite(values[..., 0])
        images, which = np.unique(label[seen] - 1, return_inverse=True)
        sigma = values[seen][:, (0, 1, 3, 4)].astype(np.float64)
        square = sigma * sigma
        squares = [np.bincount(which, weights=axis, minlength=len(images)) for axis in square.T]
        plan = np.sqrt(square[:, :2].sum(axis=1))
        histogram = np.bincount(np.searchsorted(_BINS, plan), minlength=len(_BINS) + 1)
        return cls(
            int(np.count_nonzero(label)), images, np.bincount(which, minlength=len(images)),
            np.column_stack(squares), histogram, float(plan.max(initial=0.0)),
        )  # fmt: skip


@dataclass
class _Totals:
    """Sums over the cells of a raster by image, gathered window by window; see `_Sums`."""

    images: int
    counts: IntArray = field(init=False)
    squares: FloatArray = field(init=False)
    histogram: IntArray = field(init=False)
    largest: float = 0.0
    shown: int = 0

    def __post_init__(self) -> None:
        self.counts = np.zeros(self.images, dtype=np.int64)
        self.squares = np.zeros((self.images, len(DIRECTIONS)))
        self.histogram = np.zeros(len(_BINS) + 1, dtype=np.int64)

    def add(self, sums: _Sums) -> None:
        """Addition of a window."""
        self.shown += sums.shown
        self.counts[sums.images] += sums.counts
        self.squares[sums.images] += sums.squares
        self.histogram += sums.histogram
        self.largest = max(self.largest, sums.largest)

    @property
    def notes(self) -> list[str]:
        """What is said of cells that show an image and have no value."""
        share = 1.0 - int(self.counts.sum()) / max(1, self.shown)
        # Cells at the rim of the heights are fewer.
        if share < 0.001:
            return []
        return [f"{100 * share:.2g} % of the area has no known accuracy: its height, or how well that is known, is not"]

    def summary(
        self, names: Sequence[str]
    ) -> tuple[int, tuple[float, float], tuple[float, float], dict[float, float], dict[str, float]]:
        """Cells, RMS along x and y, along and across the view, quantiles, and RMS in plan by image."""
        cells = int(self.counts.sum())
        if not cells:
            raise InputError(
                "no place of the output has a known accuracy",
                where="`accuracy`",
                hint="check that the raster of `sigma_dem` covers the output",
            )
        x, y, along, across = np.sqrt(self.squares.sum(axis=0) / cells).tolist()
        shares = np.cumsum(self.histogram) / cells
        quantiles = {
            share: min(self.largest, float(_BINS[min(int(np.searchsorted(shares, share)), len(_BINS) - 1)]))
            for share in (0.5, 0.683, 0.9, 0.95, 0.99)
        }
        by_image = {
            name: float(np.sqrt(square[:2].sum() / count))
            for name, square, count in zip(names, self.squares, self.counts.tolist(), strict=True)
            if count
        }
        return cells, (x, y), (along, across), {**quantiles, 1.0: self.largest}, by_image
