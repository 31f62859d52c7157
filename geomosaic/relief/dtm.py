"""Terrain model from contours, spot heights, breaklines and water: a thin plate that goes through all of them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError, counted, warn
from geomosaic.geo.crs import height_name, horizontal, is_local, with_heights
from geomosaic.geo.grid import Bounds, Grid, Window
from geomosaic.interpolation import bilinear
from geomosaic.options.declaration import compose
from geomosaic.options.terrain import DtmOptions
from geomosaic.planning.guidelines import interval
from geomosaic.raster.cog.codec import BLOCK, RasterMetadata, Samples
from geomosaic.raster.files import check_output
from geomosaic.raster.sink import RasterProduct, RasterSink
from geomosaic.relief.terrain_data import TerrainData, read_terrain
from geomosaic.stores.path import given_path
from geomosaic.surface.plate_grid import HeldNodes, PlateData, solve_grid
from geomosaic.surface.thin_plate import Heights
from geomosaic.types import BoolArray, FloatArray, PathLike

# Grid cells between observations along a line: there is one in each cell that it crosses.
LINE_SPACING = 0.5
# Nodes from the border of the grid within which a breakline is taken to go on beyond it.
BORDER = 2.0
# Weights relative to the bending energy: lines are met within centimetres, spot heights within a thousandth of that.
LINE_WEIGHT, SPOT_WEIGHT = 10.0, 1e5
# Metres by which a spot height may be missed before a warning.
SPOT_TOLERANCE = 1e-3
# Nodes of the largest grid that is made.
MAX_NODES = 4_000_000_000


@dataclass(frozen=True, eq=False, repr=False)
class DtmResult(RasterProduct):
    """Terrain model as a raster of heights, with its errors.

    Attributes
    ----------
    path : Path
    grid : Grid
        Its nodes are the pixel centres.
    heights : str
        Vertical datum.
    range : tuple of float
        Lowest and highest height, metres.
    nodes : int
        With a height: those within the convex outline of the data.
    line_rms, line_worst : float
        Misfit at contours and breaklines with heights, metres; NaN without any.
    spot_worst : float
        Largest misfit at spot heights, metres; NaN without any.
    left_out : array (N,)
        Spot height minus what the model without it has there, metres; NaN of those that were not left out.
    names : tuple of str (N,)
        Of the spot heights.
    lakes : int
    advised : tuple of float or None
        Grid interval that K-2.8 advises for the map, metres.
    """

    path: Path
    grid: Grid
    heights: str
    range: tuple[float, float]
    nodes: int
    line_rms: float
    line_worst: float
    spot_worst: float
    left_out: FloatArray
    names: tuple[str, ...]
    lakes: int
    advised: tuple[float, float] | None

    @property
    def facts(self) -> dict[str, Any]:
        """JSON values."""
        known = np.flatnonzero(np.isfinite(self.left_out))
        worst = known[np.argsort(-np.abs(self.left_out[known]))][:5]
        lengths = np.abs(self.left_out[known])
        return {
            "output": str(self.path), "width": self.grid.width, "height": self.grid.height,
            "resolution": self.grid.resolution[0], "heights": self.heights, "range": list(self.range),
            "nodes": self.nodes, "lakes": self.lakes,
            "lines": {"rms_m": _number(self.line_rms), "worst_m": _number(self.line_worst)},
            "spot_heights": {"count": len(self.names), "worst_m": _number(self.spot_worst)},
            "left_out": {
                "count": len(known),
                "rms_m": float(np.sqrt(np.mean(lengths**2))) if len(known) else None,
                "median_m": float(np.median(lengths)) if len(known) else None,
                "worst": [{"id": self.names[k], "m": float(self.left_out[k])} for k in worst],
            },
            "advised_interval_m": None if self.advised is None else list(self.advised),
        }  # fmt: skip


def dtm(output: PathLike, *, overwrite: bool = False, **options: Any) -> DtmResult:
    """Terrain model from contours, spot heights, breaklines and lakes.

    The heights of the nodes are the thin plate of least bending through the data, so that hilltops and valley floors
    within the last contour are no flats; spot heights are kept exactly, lakes are level, and across breaklines and
    shores the slope may break.

    Parameters
    ----------
    output : path
        GeoTIFF to write.
    overwrite : bool
        Replace an existing file.
    **options
        Of `DtmOptions`: `contours`, `points`, `breaklines`, `water`, `resolution` or `map_scale`, ...

    Raises
    ------
    InputError, OutputExistsError, OutputError
    """
    asked, output = compose(DtmOptions, options), given_path(output)
    read = [path for path in (asked.contours, asked.points, asked.breaklines, asked.water) if path]
    check_output(output, overwrite=overwrite, inputs=read, geotiff=True)
    advised = None if asked.map_scale is None else interval(asked.map_scale, asked.terrain)  # type: ignore[arg-type]
    resolution = asked.resolution or (advised[0] if advised else None)
    if resolution is None:
        hint = "give `resolution`, or `map_scale`: K-2.8 has the interval for it"
        raise InputError("nothing says how far apart the nodes are", hint=hint)
    terrain = read_terrain(asked)
    grid = _grid(terrain, asked.bounds, resolution)
    crs = grid.crs if asked.heights is None else with_heights(grid.crs, asked.heights, "`heights`")
    data = _plate_data(terrain, grid)
    if len(data.observed.height) + len(data.spots.height) < 3:
        raise InputError("three heights at least make a surface", where=str(read[0]), hint="give more of them")
    written = replace(grid, crs=crs if crs.is_compound and not is_local(crs) else horizontal(crs))
    made = _written(output, written, crs, data, terrain, advised, overwrite=overwrite)
    contradiction = _contradiction(made, terrain)
    if contradiction is not None:
        warn(f"{output}: {contradiction}")
    return made


def _contradiction(made: DtmResult, terrain: TerrainData) -> str | None:
    """Spot height that all other data miss by more than the interval of the contours, or that is not kept."""
    levels = np.unique([line[0, 2] for line in terrain.contours])
    step = float(np.median(np.diff(levels))) if len(levels) > 1 else np.inf
    missed = np.nan_to_num(np.abs(made.left_out))
    many = int((missed > step).sum())
    if many:
        most = int(missed.argmax())
        others = f" ({counted(many - 1, 'other')} too)" if many > 1 else ""
        return (
            f"all other data miss the spot height {made.names[most]} by {missed[most]:.3g} m, more than the interval "
            f"of the contours, {step:g} m{others}: look for a mistyped height"
        )
    if made.spot_worst > SPOT_TOLERANCE:
        return (
            f"a spot height is missed by {made.spot_worst:.3g} m, as it contradicts another one in the same cell or "
            "the level of a lake: correct one of them, or choose a smaller `resolution`"
        )
    return None


def _plate_data(terrain: TerrainData, grid: Grid) -> PlateData:
    """Terrain data in the nodes, the pixel centres, of a grid."""
    import shapely

    def node(xy: FloatArray) -> FloatArray:
        return grid.colrow(xy) - 0.5

    shores = [
        np.column_stack([shapely.get_coordinates(ring), np.full(shapely.get_num_coordinates(ring), level)])
        for area, level in terrain.water
        for ring in shapely.get_rings(area)
    ]
    breaks = [_sampled(line, node) for line in (*terrain.breaklines, *shores)]
    lines = [*(_sampled(line, node) for line in terrain.contours), *breaks]
    places = np.vstack([np.empty((0, 3)), *lines])
    places = places[np.isfinite(places[:, 2])]
    folds = [_segments(line[:, :2], grid) for line in breaks]
    spots = np.column_stack([node(terrain.spots[:, :2]), terrain.spots[:, 2]])
    areas = tuple((shapely.transform(area, node), level) for area, level in terrain.water)
    return PlateData(
        _heights(places, LINE_WEIGHT), _heights(spots, SPOT_WEIGHT),
        np.concatenate([np.empty((0, 2, 2)), *folds]), HeldNodes(areas) if areas else None,
    )  # fmt: skip


def _heights(places: FloatArray, weight: float) -> Heights:
    """Observations of one weight."""
    return Heights(places[:, :2], places[:, 2], np.full(len(places), weight))


def _sampled(line: FloatArray, node: Any) -> FloatArray:
    """Places (N, 3) along a line in node coordinates, at most `LINE_SPACING` apart."""
    place = np.column_stack([node(line[:, :2]), line[:, 2]])
    steps = np.maximum(np.ceil(np.hypot(*np.diff(place[:, :2], axis=0).T) / LINE_SPACING), 1.0)
    at = np.concatenate([[0.0], np.cumsum(steps)])
    every = np.arange(at[-1] + 1.0)
    return np.column_stack([np.interp(every, at, place[:, k]) for k in range(3)])


def _segments(line: FloatArray, grid: Grid) -> FloatArray:
    """Segments (S, 2, 2) of a line in node coordinates, which goes on where it ends at the border of the grid.

    A row of nodes beyond its end would hold the slope over the end of a ridge that the map's edge cuts off.
    """
    last, closed = np.array([grid.width, grid.height]) - 1.0, (line[0] == line[-1]).all()
    for end, before in () if closed else ((0, 1), (-1, -2)):
        at, step = line[end], line[end] - line[before]
        away = np.arange(LINE_SPACING, 2 * BORDER + LINE_SPACING, LINE_SPACING)[:, None]
        beyond = at + away * step / max(float(np.hypot(*step)), 1e-12)
        if (np.minimum(at, last - at) <= BORDER).any() and (np.minimum(beyond[-1], last - beyond[-1]) < 0.0).any():
            line = np.vstack([beyond[::-1], line] if end == 0 else [line, beyond])
    return np.stack([line[:-1], line[1:]], axis=1)


def _grid(terrain: TerrainData, bounds: Bounds | None, resolution: float) -> Grid:
    """Grid of the nodes; half a cell more than the data all around, so that all lie between nodes."""
    import shapely

    west, south, east, north = terrain.bounds
    left, bottom, right, top = bounds or terrain.bounds
    hull = shapely.convex_hull(shapely.MultiPoint(terrain.xy))
    if hull.geom_type != "Polygon":
        raise InputError("all heights lie on one line", hint="give heights on both sides of it")
    if not shapely.intersects(hull, shapely.box(left, bottom, right, top)):
        hint = f"the data lie within {west:.10g} {south:.10g} {east:.10g} {north:.10g}"
        raise InputError("no data lie in it", where="`bounds`", hint=hint)
    half = 0.5 * resolution if bounds is None else 0.0
    around = (left - half, bottom - half, right + half, top + half)
    grid = Grid.from_bounds(terrain.crs, around, resolution, snap=bounds is None)
    if grid.width * grid.height > MAX_NODES:
        what = f"a grid of {grid.width} x {grid.height} nodes is too large"
        raise InputError(what, where="`resolution`", hint="give a larger one, or smaller `bounds`")
    if min(grid.width, grid.height) < 2:
        raise InputError("the data lie within one cell", where="`resolution`", hint="give a smaller one")
    return grid


def _written(
    output: Path,
    grid: Grid,
    crs: CRS,
    data: PlateData,
    terrain: TerrainData,
    advised: tuple[float, float] | None,
    *,
    overwrite: bool,
) -> DtmResult:
    """Solve the grid from the top down, write it, and hold its heights against the data."""
    description = "heights of the ground, metres"
    samples, metadata = Samples(1, "float32", nodata=float("nan")), RasterMetadata((description,), ((1.0, 0.0, "m"),))
    outline = _outline(terrain.xy, grid)
    lines, spots = _Misfits(data.observed), _Misfits(data.spots)
    left_out = np.full(len(data.spots.height), np.nan)
    low, high, nodes = np.inf, -np.inf, 0
    last = np.empty((0, grid.width), dtype=np.float32)
    waiting = last
    with RasterSink(output, grid, samples, overwrite=overwrite, metadata=metadata) as sink:
        for band in solve_grid(data, grid.shape):
            heights = band.heights.astype(np.float32)
            left_out = np.where(np.isnan(band.left_out), left_out, band.left_out)
            whole = np.vstack([last, heights])
            lines.add(whole, band.row - len(last))
            spots.add(whole, band.row - len(last))
            last = heights[-1:]
            shown = _within(outline, band.row, heights.shape)
            low = min(low, float(heights[shown].min(initial=np.inf)))
            high = max(high, float(heights[shown].max(initial=-np.inf)))
            nodes += int(shown.sum())
            waiting = np.vstack([waiting, np.where(shown, heights, np.float32(np.nan))])
            first = band.row + len(heights) - len(waiting)
            ready = len(waiting) if first + len(waiting) == grid.height else len(waiting) // BLOCK * BLOCK
            if ready:
                made, waiting = waiting[:ready], waiting[ready:]
                sink.write(Window(0, first, grid.width, ready), made[..., None], np.isfinite(made).astype(np.uint8))
        sink.finish()
    return DtmResult(
        output, grid, height_name(crs), (low, high), nodes, lines.rms, lines.worst, spots.worst, left_out,
        terrain.names, len(terrain.water), advised,
    )  # fmt: skip


def _outline(xy: FloatArray, grid: Grid) -> FloatArray:
    """First and last column (rows, 2) within the convex outline of places (N, 2), by row; empty where first > last."""
    import shapely

    hull = shapely.convex_hull(shapely.MultiPoint(grid.colrow(xy) - 0.5))
    ring = shapely.get_coordinates(hull)
    row = np.arange(grid.height, dtype=np.float64)
    first, last = np.full(grid.height, np.inf), np.full(grid.height, -np.inf)
    for (c0, r0), (c1, r1) in itertools.pairwise(ring):
        low, high = min(r0, r1), max(r0, r1)
        hit = np.flatnonzero((row >= low - 1e-6) & (row <= high + 1e-6))
        share = np.clip((row[hit] - r0) / (r1 - r0), 0.0, 1.0) if r1 != r0 else np.zeros(len(hit))
        for col in (c0 + share * (c1 - c0), *([np.full(len(hit), c1)] if r1 == r0 else [])):
            first[hit], last[hit] = np.minimum(first[hit], col), np.maximum(last[hit], col)
    return np.column_stack([first, last])


def _within(outline: FloatArray, row: int, shape: tuple[int, int]) -> BoolArray:
    """Nodes (rows, cols) of a band that lie within the outline, or in a cell that it crosses."""
    first, last = outline[row : row + shape[0]].T[..., None]
    col = np.arange(shape[1])
    # A cell more all around: heights at the outermost data need all four nodes of their cell.
    beside = [outline[np.clip(np.arange(shape[0]) + row + step, 0, len(outline) - 1)].T[..., None] for step in (-1, 1)]
    first, last = (
        np.minimum(first, np.minimum(beside[0][0], beside[1][0])),
        np.maximum(last, np.maximum(beside[0][1], beside[1][1])),
    )
    return np.asarray((col > first - 1.0) & (col < last + 1.0))


class _Misfits:
    """Misfit of the heights of a grid at observations, row by row."""

    def __init__(self, observed: Heights) -> None:
        self._observed, self._sum, self._count, self._worst = observed, 0.0, 0, 0.0
        self._order = np.argsort(observed.colrow[:, 1], kind="stable")
        self._rows = observed.colrow[self._order, 1]

    def add(self, heights: FloatArray, row: int) -> None:
        """Misfits in the cells of some rows, of which the next call has the last one again."""
        start, stop = np.searchsorted(self._rows, (row, row + len(heights) - 1))
        here = self._observed.part(self._order[start:stop])
        place = here.colrow - (0, row)
        place = place[inside := (place[:, 0] >= 0) & (place[:, 0] <= heights.shape[1] - 1)]
        node = np.clip(np.floor(place), 0, np.array(heights.shape[::-1]) - 2).astype(np.int64)
        misfit = np.abs(here.height[inside] - bilinear(heights, node, place - node))
        self._sum, self._count = self._sum + float((misfit**2).sum()), self._count + len(misfit)
        self._worst = max(self._worst, float(misfit.max(initial=0.0)))

    @property
    def rms(self) -> float:
        """Metres; NaN without any."""
        return float(np.sqrt(self._sum / self._count)) if self._count else float("nan")

    @property
    def worst(self) -> float:
        """Metres; NaN without any."""
        return self._worst if self._count else float("nan")


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
