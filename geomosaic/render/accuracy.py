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
from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.units import metres_per_unit
from geomosaic.raster.cog.codec import RasterMetadata, Samples
from geomosaic.raster.sink import RasterProduct, RasterSink
from geomosaic.raster.source import Source
from geomosaic.render.photos import map_in_order
from geomosaic.sensor.error_propagation import InputUncertainty, LevelErrors
from geomosaic.sensor.map_to_image import Ground, MapToImage
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
# Bins of the histogram of standard deviations, metres: 0.5 % apart, from 0.01 mm to 100 km.
_BINS = np.geomspace(1e-5, 1e5, 4618)


@dataclass(frozen=True, eq=False, repr=False)
class AccuracyRaster(RasterProduct):
    """Raster of standard deviations that was written, and what it shows.

    Attributes
    ----------
    path : Path
        Bands: standard deviations along x and along y of the map, metres; their correlation.
    grid : Grid
        Of its cells.
    parts : tuple of str
        Sources of error that are in it.
    cells : int
        Cells with a value.
    rms : (float, float)
        Root mean square of the standard deviations along x and y, metres.
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
            "file": str(self.path),
            "errors_of": list(self.parts),
            "rms_x_m": self.rms[0],
            "rms_y_m": self.rms[1],
            "rms_plan_m": self.plan,
            "quantiles_m": {f"{share:g}": value for share, value in self.quantiles.items()},
            "rms_by_image_m": dict(self.images),
            "target_m": self.target,
            "notes": list(self.notes),
        }

    @property
    def words(self) -> list[str]:
        """Lines of text."""
        x, y = self.rms
        shares = ", ".join(f"{100 * s:g} % of the area within {self.quantiles[s]:.3g} m" for s in (0.5, 0.95))
        lines = [
            f"{self.path}: expected errors (one standard deviation) of {' and '.join(self.parts)}",
            f"RMS {x:.3g} m along x, {y:.3g} m along y, {self.plan:.3g} m in plan; {shares}",
        ]
        worst = max(self.images, key=lambda name: self.images[name])
        if len(self.images) > 1 and self.images[worst] > 1.5 * self.plan:
            lines.append(f"least accurate image: {worst}, {self.images[worst]:.3g} m in plan")
        if self.target is not None:
            met = "kept" if self.plan <= self.target else "MISSED"
            lines.append(f"target of {self.target:g} m in plan: {met} by expectation; check points would prove it")
        return [*lines, *self.notes]


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
        height = height_sigmas(options.sigma_dem) if options.sigma_dem is not None and block.surface else None
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
    slope : array (rows, cols, 2)
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
        Three bands of float32, see `AccuracyRaster`.
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

    def one(window: Window) -> tuple[AnyArray, AnyArray]:
        label = _labels(source, window, known.step, labelled)
        label[label > len(block.scenes)] = 0  # hidden from all
        return fields.window(window, label), label

    of = " and ".join(known.parts)
    names = tuple(f"standard deviation along {axis}, metres, of {of}" for axis in ("x", "y"))
    metadata = RasterMetadata((*names, "correlation of both"), ((1.0, 0.0, "m"), (1.0, 0.0, "m"), (1.0, 0.0, "")))
    with (
        Source(str(shown)) as source,
        RasterSink(
            path, fields.grid, Samples(3, "float32", nodata=float("nan")), driver=render.driver,
            overwrite=render.overwrite, threads=render.threads, metadata=metadata,
        ) as sink,
    ):  # fmt: skip
        for done, (window, (values, label)) in enumerate(map_in_order(one, units, render.threads)):
            sink.write(window, values, np.isfinite(values[..., 0]).view(np.uint8), blank=False)
            total.add(values, label)
            render.report(done + 1, len(units), "accuracy")
        sink.finish()
    names_of = [scene.name for scene in block.scenes]
    return AccuracyRaster(path, fields.grid, known.parts, *total.summary(names_of), known.notes)


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
    """Standard deviations of the images of a block over a grid of cells."""

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
        return cls(cells, pixel, Ground.under(cells, surface), sigmas, mappers, known)

    def window(self, window: Window, label: IntArray) -> AnyArray:
        """Values (rows, cols, 3) of a window whose cells show the images of `label`."""
        out = np.full((*label.shape, 3), np.nan, dtype=np.float32)
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
            return _Cells(window, np.zeros((NODES, NODES)), np.zeros(shape), np.zeros((*shape, 2)), sigma)
        # One cell more on each side, for slopes.
        z = _heights(self.ground, Window(window.col - 1, window.row - 1, window.width + 2, window.height + 2))
        along = np.stack([_differences(z[1:-1], 1), _differences(z[:, 1:-1], 0)], axis=-1)
        t = self.grid.transform
        metres = self._metres(np.array([[window.col + window.width / 2, window.row + window.height / 2]]))[0, :2]
        # A cell goes (a, d) along a row and (b, e) down a column: derivatives by the map are those by cells times the
        # inverse.
        by_map = np.linalg.inv(np.array([[t.a, t.b], [t.d, t.e]])) / metres
        z = z[1:-1, 1:-1]
        down, across = (np.linspace(0, size - 1, NODES).round().astype(np.int64) for size in shape)
        nodes = z[np.ix_(down, across)]
        nodes = np.where(np.isfinite(nodes), nodes, np.nanmedian(z) if np.isfinite(z).any() else 0.0)
        above = z - _weights(shape[0], NODES) @ nodes @ _weights(shape[1], NODES).T
        return _Cells(window, nodes, above, along @ by_map, sigma)

    def _metres(self, colrow: FloatArray) -> FloatArray:
        """Metres in a unit of x, y and height (N, 3) at cells."""
        xy = self.grid.xy(colrow)
        return np.column_stack([metres_per_unit(self.grid.crs, xy), np.ones(len(xy))])

    def _fill(self, out: AnyArray, cells: _Cells, here: AnyArray, number: int) -> None:
        """Values of the cells that one image shows."""
        above = np.abs(cells.above[here])
        if np.isnan(above).all():
            return
        most = float(np.nanmax(above))
        # Of ground that is as the net to a millimetre one height is enough.
        levels = (0.0,) if most < 1e-3 or not self.mappers[number].uses_heights else (-most, most)
        nodes = np.stack([self._nodes(cells.window, number, cells.nodes + level) for level in levels])
        down, across = (_weights(size, NODES) for size in here.shape)
        for row in range(0, len(here), STRIP):
            rows = slice(row, row + STRIP)
            if not here[rows].any():
                continue
            part = np.zeros(()) if len(levels) == 1 else 0.5 + 0.5 * cells.above[rows] / most
            level = _between(nodes, down[rows], across, part)
            found = _on_ground(level, cells.slope[rows], cells.sigma[rows])
            found[np.isnan(cells.above[rows])] = np.nan
            out[rows][here[rows]] = found[here[rows]]

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
    nodes = ground.to_surface(xy).reshape(NODES, NODES, 2)
    down, across = _weights(window.height, NODES), _weights(window.width, NODES)
    places = np.stack([down @ nodes[..., axis] @ across.T for axis in (0, 1)], axis=-1)
    return ground.block(window).height(places.reshape(-1, 2)).reshape(places.shape[:2])


def _weights(size: int, nodes: int) -> FloatArray:
    """Matrix (size, nodes) from values at nodes over an axis to those at the centres of its cells."""
    at = (np.arange(size) + 0.5) / size * (nodes - 1)
    return np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(nodes)))


def _between(nodes: FloatArray, down: FloatArray, across: FloatArray, part: FloatArray) -> FloatArray:
    """Fields (F, rows, cols) between nodes (levels, F, NODES, NODES); `part` of the way from the first to the last."""
    known = np.isfinite(nodes).all(axis=(0, 1))
    if known.all():
        weight = None
    else:  # beyond a horizon: the nodes that see ground tell
        nodes = np.where(known, nodes, 0.0)
        weight = down @ known.astype(np.float64) @ across.T
        weight = np.where(weight > 0.0, weight, np.nan)
    found: list[FloatArray] = []
    for level in nodes:
        fields = down @ level @ across.T
        found.append(fields if weight is None else fields / weight)
    first: FloatArray = found[0]
    return first if len(found) == 1 else first + part * (found[1] - first)


def _on_ground(level: FloatArray, slope: FloatArray, sigma: FloatArray) -> FloatArray:
    """Standard deviations and correlation (rows, cols, 3) on sloping ground of fields (5, rows, cols)."""
    xx, xy, yy, tx, ty = level
    gx, gy = slope[..., 0], slope[..., 1]
    facing = np.maximum(1.0 - gx * tx - gy * ty, GRAZING)
    ux, uy = tx / facing, ty / facing
    # S = I + u·gᵀ, see `error_propagation`; S·t = u.
    sxx, sxy, syx, syy = 1.0 + ux * gx, ux * gy, uy * gx, 1.0 + uy * gy
    of_heights = sigma * sigma
    vx = sxx * sxx * xx + 2.0 * sxx * sxy * xy + sxy * sxy * yy + of_heights * ux * ux
    vy = syx * syx * xx + 2.0 * syx * syy * xy + syy * syy * yy + of_heights * uy * uy
    vxy = sxx * syx * xx + (sxx * syy + sxy * syx) * xy + sxy * syy * yy + of_heights * ux * uy
    x, y = np.sqrt(np.maximum(vx, 0.0)), np.sqrt(np.maximum(vy, 0.0))
    both = x * y
    return np.stack([x, y, np.divide(vxy, both, out=np.zeros_like(both), where=both > 0.0)], axis=-1)


def _differences(z: FloatArray, axis: int) -> FloatArray:
    """Change of height per cell, of the side that is known where one is not; 0 where neither is."""
    change = np.diff(z, axis=axis)
    count = change.shape[axis]
    before, after = (np.take(change, np.arange(*ends), axis=axis) for ends in ((0, count - 1), (1, count)))
    before, after = np.where(np.isnan(before), after, before), np.where(np.isnan(after), before, after)
    return np.nan_to_num((before + after) / 2.0)


@dataclass
class _Totals:
    """Sums over the cells of a raster, gathered window by window."""

    images: int
    counts: IntArray = field(init=False)
    squares: FloatArray = field(init=False)
    histogram: IntArray = field(init=False)
    largest: float = 0.0

    def __post_init__(self) -> None:
        self.counts = np.zeros(self.images, dtype=np.int64)
        self.squares = np.zeros((self.images, 2))
        self.histogram = np.zeros(len(_BINS) + 1, dtype=np.int64)

    def add(self, values: AnyArray, label: IntArray) -> None:
        """Addition of a window's values (rows, cols, 3)."""
        seen = np.isfinite(values[..., 0])
        if not seen.any():
            return
        number, sigma = label[seen] - 1, values[seen][:, :2].astype(np.float64)
        square = sigma * sigma
        self.counts += np.bincount(number, minlength=self.images)
        for axis in (0, 1):
            self.squares[:, axis] += np.bincount(number, weights=square[:, axis], minlength=self.images)
        plan = np.sqrt(square.sum(axis=1))
        self.histogram += np.bincount(np.searchsorted(_BINS, plan), minlength=len(_BINS) + 1)
        self.largest = max(self.largest, float(plan.max()))

    def summary(self, names: Sequence[str]) -> tuple[int, tuple[float, float], dict[float, float], dict[str, float]]:
        """Cells, RMS along x and y, quantiles, and RMS in plan by image."""
        cells = int(self.counts.sum())
        if not cells:
            raise InputError(
                "no place of the output has a known accuracy",
                where="`accuracy`",
                hint="check that the raster of `sigma_dem` covers the output",
            )
        x, y = np.sqrt(self.squares.sum(axis=0) / cells).tolist()
        shares = np.cumsum(self.histogram) / cells
        quantiles = {
            share: min(self.largest, float(_BINS[min(int(np.searchsorted(shares, share)), len(_BINS) - 1)]))
            for share in (0.5, 0.683, 0.9, 0.95, 0.99)
        }
        by_image = {
            name: float(np.sqrt(square.sum() / count))
            for name, square, count in zip(names, self.squares, self.counts.tolist(), strict=True)
            if count
        }
        return cells, (x, y), {**quantiles, 1.0: self.largest}, by_image
