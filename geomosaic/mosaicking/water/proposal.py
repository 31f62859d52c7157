"""Water proposals: areas for the option `water`, from a mosaic and a DEM, for a person to judge and edit."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from geomosaic.errors import InputError
from geomosaic.geo.crs import height_name, horizontal
from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import linear_unit
from geomosaic.mosaicking.water.level_ground import Lake, find_lakes
from geomosaic.raster.output_files import check_output
from geomosaic.raster.source import Source
from geomosaic.raster.validity import traced
from geomosaic.raster.vector import Layer, write_layers
from geomosaic.surface.dem import Dem
from geomosaic.types import BoolArray, FloatArray, PathLike

LAYER = "water"
MAX_CELLS = 4_000_000
MIN_CELLS = 40
"""Cells of the smallest water body that is not mere chance."""
MAX_TILT = 0.003
"""Largest slope of water as a whole: lakes have none, rivers of the plains less."""


@dataclass(frozen=True)
class WaterResult:
    """Proposed water areas and the resolution of the search.

    Attributes
    ----------
    path : Path
    areas : tuple of float
        Square metres, the largest first.
    cell : float
        Size of the cells in metres.
    smallest : float
        Square metres of the smallest area searched for.
    heights : str
        Vertical datum of the levels.
    """

    path: Path
    areas: tuple[float, ...]
    cell: float
    smallest: float
    heights: str


def propose_water(
    image: PathLike,
    dem: PathLike,
    output: PathLike,
    *,
    min_area: float | None = None,
    tilt: float = MAX_TILT,
    dem_heights: str | None = None,
    overwrite: bool = False,
) -> WaterResult:
    """Areas that may be water, from a mosaic and a DEM, in the layer `water` of a GeoPackage.

    Columns: `area` (m²), `level`, `rise`, `roughness` (metres), `tilt` (slope), `unevenness`, as in `Lake`.

    Parameters
    ----------
    image : path
        A mosaic or an ortho, north up, with square pixels in a projected CRS.
    dem : path
    output : path
        Ends in .gpkg.
    min_area : float, optional
        Square metres; `MIN_CELLS` cells by default, and never less.
    tilt : float
        Largest slope of an area as a whole.
    dem_heights : str, optional
        Vertical datum of the DEM, where the file does not say it.
    overwrite : bool

    Returns
    -------
    WaterResult

    Raises
    ------
    InputError
        An image of another form, a DEM without heights below it, an output that is no GeoPackage.
    OutputExistsError, OutputError
        The name is taken; writing failed.
    """
    import shapely

    image, dem, output = Path(image), Path(dem), Path(output)
    if output.suffix.lower() != ".gpkg":
        raise InputError("areas are written as GeoPackage", where=str(output), hint="end the name in .gpkg")
    check_output(output, overwrite=overwrite)
    surface = Dem.open(dem, heights=dem_heights)
    try:
        with Source(image) as source:
            full = _grid(source)
            shrink = _pixels_per_cell(full, surface)
            values, valid = _read(source, shrink)
        grid, metre = full.coarser(shrink), linear_unit(full.crs)
        under = _heights(surface, grid)
        datum = height_name(surface.crs)
    finally:
        surface.close()
    if not (valid & np.isfinite(under)).any():
        raise InputError("the DEM has no height where the image shows something", where=str(dem), hint="check both CRS")
    cell = grid.resolution[0] * metre
    min_area = MIN_CELLS * cell**2 if min_area is None else min_area
    # Fewer cells may be level and even by chance, however small an area is asked for.
    cells = max(MIN_CELLS, math.ceil(min_area / cell**2))
    number, lakes = find_lakes(values, valid, under, cell, smallest=cells, tilt=tilt)
    shapes = _shapes(number, grid, lakes)
    areas = [shapely.area(shape) * metre**2 for shape in shapes]
    columns = {
        "id": [lake.number + 1 for lake in lakes],
        "area": [round(area, 1) for area in areas],
        **{
            name: [round(getattr(lake, name), 4) for lake in lakes]
            for name in ("level", "rise", "roughness", "tilt", "unevenness")
        },
    }
    write_layers(output, {LAYER: Layer(grid.crs, "MultiPolygon", shapes, columns)}, overwrite=overwrite)
    return WaterResult(output, tuple(areas), cell, cells * cell**2, datum)


def _grid(source: Source) -> Grid:
    """Grid of the image; refused unless north up, with square pixels, in a projected CRS."""
    info = source.info
    t, where = info.transform, info.path
    if info.crs is None or t is None:
        raise InputError("the image is not georeferenced", where=where, hint="make an ortho or a mosaic of it first")
    crs = horizontal(info.crs)
    if t.b or t.d or t.a <= 0 or t.e >= 0 or not math.isclose(t.a, -t.e, rel_tol=1e-6) or not crs.is_projected:
        raise InputError(
            "water is looked for in north-up images with square pixels in a projected CRS",
            where=where,
            hint="bring it there with geomosaic reproject",
        )
    return Grid(crs, t, info.width, info.height)


def _pixels_per_cell(grid: Grid, surface: Dem) -> int:
    """Pixels of the image along a cell: two cells to a node of the DEM, at most `MAX_CELLS` in all."""
    middle = np.array([[grid.width / 2, grid.height / 2], [grid.width / 2 + 1, grid.height / 2]])
    a, b = surface.grid.colrow(Transform(grid.crs, surface.grid.crs)(grid.xy(middle)))
    nodes = float(np.hypot(*(b - a)))
    per_node = 1 / nodes if np.isfinite(nodes) and nodes > 0 else 1.0
    return max(1, round(per_node / 2), math.ceil(math.sqrt(grid.width * grid.height / MAX_CELLS)))


def _read(source: Source, shrink: int) -> tuple[FloatArray, BoolArray]:
    """Means of the image over cells (rows, cols, bands), and which are known."""
    values, valid = source.read(Window(0, 0, source.info.width, source.info.height), shrink)
    known = np.ones(values.shape[:2], dtype=bool) if valid is None else valid > 0
    return np.asarray(values, dtype=np.float64), known


def _heights(surface: Dem, grid: Grid) -> FloatArray:
    """Heights (rows, cols) at the centres of cells."""
    move, out = Transform(grid.crs, surface.grid.crs), np.empty(grid.shape)
    # Row by row: positions of all cells at once would take several times the memory of the heights.
    for row in range(grid.height):
        places = np.column_stack([np.arange(grid.width) + 0.5, np.full(grid.width, row + 0.5)])
        out[row] = surface.height(move(grid.xy(places)))
    return out


def _shapes(number: np.ndarray, grid: Grid, lakes: list[Lake]) -> list[object]:
    """One MultiPolygon for each lake, the staircase of its cells smoothed."""
    import shapely

    parts = traced(number, grid)
    if not parts:
        return []
    # As a coverage: lakes that touch keep a common border.
    smooth = shapely.coverage_simplify(np.array([part for part, _ in parts], dtype=object), grid.resolution[0])
    of_lake: dict[int, list[object]] = {lake.number: [] for lake in lakes}
    for shape, (_, own) in zip(smooth, parts, strict=True):
        of_lake[own].append(shape)
    return [shapely.union_all(np.array(own, dtype=object)) for own in of_lake.values()]
