"""Water proposals: level ground in a DEM that looks even and lies low, as areas for the option `water`.

Seeds are cells where the ground is level and neighbouring cells look alike. Groups of seeds that are level as a whole
grow to their shores, and count if the land around them rises: elsewhere water would run out. The result is a proposal.
A level, even field between banks passes as well, and a rough DEM over water hides it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.errors import InputError
from geomosaic.geo.crs import height_name, horizontal
from geomosaic.geo.grid import Grid, Window
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import linear_unit
from geomosaic.options.declaration import compose
from geomosaic.options.sheet import WaterOptions
from geomosaic.raster.files import check_output
from geomosaic.raster.source import Source
from geomosaic.raster.validity import polygons_of_labels
from geomosaic.raster.vector import Layer, VectorProduct, write_layers
from geomosaic.stores.path import given_path
from geomosaic.surface.dem import Dem
from geomosaic.types import BoolArray, FloatArray, IntArray, PathLike

# Largest standard deviation of 3 × 3 cells of water, in units of the image's contrast.
MAX_DEVIATION = 0.15
# Largest difference of shallow water from the middle of the body, in units of the image's contrast.
MAX_DIFFERENCE = 0.6
# Largest slope of the DEM over four of its nodes on water: the noise of their heights.
MAX_SLOPE = 0.02
# Smallest median rise of the shore above water, in metres; and the most that its parts may lie below.
MIN_RISE = 0.2
# Part of a shore that may lie lower: an outlet, a dam.
MAX_OUTLET = 0.1
# Cells by which water may grow beyond its seeds, and width of the shore whose heights are compared.
SHORE = 6


@dataclass(frozen=True)
class Lake:
    """Group of cells that may be water, and the evidence.

    Attributes
    ----------
    number : int
        In the raster of numbers.
    cells : int
    level : float
        Median height in metres.
    tilt : float
        Slope of the plane through its heights.
    roughness : float
        RMS of the heights about that plane in metres.
    rise : float
        Median height of the shore above the nearest water in metres.
    unevenness : float
        Median local standard deviation, in units of the image's contrast.
    """

    number: int
    cells: int
    level: float
    tilt: float
    roughness: float
    rise: float
    unevenness: float


def _find_lakes(
    values: FloatArray, valid: BoolArray, heights: FloatArray, cell: float, *, smallest: int, tilt: float
) -> tuple[IntArray, list[Lake]]:
    """Water bodies, as level, even and low-lying groups of cells: numbers (rows, cols), −1 elsewhere, and lakes.

    Heights and the cell are in metres, the smallest lake in cells, the tilt is the largest slope of a group as a whole.
    Numbers count from 0, the largest lake first.
    """
    from scipy.ndimage import binary_opening, find_objects, label

    known = valid & np.isfinite(heights)
    out: IntArray = np.full(known.shape, -1)
    if not known.any():
        return out, []
    looks = values / np.maximum(_contrast(values[valid]), 1e-9)
    uneven = _local_deviation(looks, valid)
    middle = known & (uneven <= MAX_DEVIATION) & (_slope(heights, cell) <= MAX_SLOPE)
    groups, _ = label(binary_opening(middle, np.ones((3, 3))))
    found: list[tuple[Lake, tuple[slice, slice], BoolArray]] = []
    for number, box in enumerate(find_objects(groups), start=1):
        around = _padded(box[0], known.shape[0]), _padded(box[1], known.shape[1])
        own = groups[around] == number
        # Seeds are the middle of a body; it grows to its shores only afterwards.
        if own.sum() >= smallest / 4:
            lake, shape = _grown(own, looks[around], uneven[around], heights[around], known[around], cell, tilt)
            if lake is not None and lake.cells >= smallest:
                found.append((lake, around, shape))
    found.sort(key=lambda entry: -entry[0].cells)
    lakes: list[Lake] = []
    for lake, around, shape in found:
        free = shape & (out[around] < 0)
        out[around][free] = len(lakes)
        lakes.append(replace(lake, number=len(lakes)))
    return out, lakes


def _padded(box: slice, size: int) -> slice:
    """Rows or columns of a box, extended by growth and shore."""
    return slice(max(0, box.start - 2 * SHORE), min(size, box.stop + 2 * SHORE))


def _grown(
    own: BoolArray,
    looks: FloatArray,
    uneven: FloatArray,
    heights: FloatArray,
    known: BoolArray,
    cell: float,
    tilt: float,
) -> tuple[Lake | None, BoolArray]:
    """Lake that a group of seeds grows to, and its cells; None where it is not level or not low."""
    from scipy.ndimage import binary_dilation, binary_propagation, distance_transform_edt

    slope, roughness = _plane(own, heights, cell)
    if slope > tilt:
        return None, own
    distance, nearest = distance_transform_edt(~own, return_indices=True)
    above = heights - np.where(own, heights, np.nan)[tuple(nearest)]
    within = max(MIN_RISE, 3 * roughness)
    typical = np.median(looks[own], axis=0)
    alike = (np.abs(looks - typical) <= MAX_DIFFERENCE).all(axis=2)
    level = known & (np.abs(above) <= within)
    whole = binary_propagation(own, mask=own | (level & alike & (distance <= SHORE)))
    whole = _without_glint(whole, level)
    shore = binary_dilation(whole, iterations=SHORE) & ~whole & known & (distance > 1)
    if shore.sum() < 0.3 * (binary_dilation(whole, iterations=SHORE) & ~whole).sum() or not shore.any():
        return None, own  # most of its shores lie beyond what is known
    rise = above[shore]
    if np.median(rise) < within or (rise < -within).mean() > MAX_OUTLET:
        return None, own
    lake = Lake(
        0, int(whole.sum()), float(np.median(heights[own])), slope, roughness, float(np.median(rise)),
        float(np.median(uneven[own])),
    )  # fmt: skip
    return lake, whole


def _without_glint(whole: BoolArray, level: BoolArray) -> BoolArray:
    """Water with those holes filled that are level with it: glint, boats, foam; islands stay."""
    from scipy.ndimage import binary_fill_holes, label

    holes, count = label(binary_fill_holes(whole) & ~whole)
    if not count:
        return whole
    cells = np.bincount(holes.ravel(), minlength=count + 1)
    flat = np.bincount(holes.ravel(), weights=level.ravel().astype(float), minlength=count + 1) >= 0.9 * cells
    flat[0] = False
    return np.asarray(whole | flat[holes])


def _contrast(values: FloatArray) -> FloatArray:
    """Contrast (bands,) of an image as a standard deviation, robust against its brightest places."""
    low, high = np.percentile(values, [5, 95], axis=0)
    return np.asarray((high - low) / 3.29)  # of a normal distribution, 90 % lie within ± 1.645 standard deviations


def _local_deviation(looks: FloatArray, valid: BoolArray) -> FloatArray:
    """Standard deviation of 3 × 3 cells, mean over bands; infinite where one of them is missing."""
    from scipy.ndimage import minimum_filter, uniform_filter

    filled = np.where(valid[..., None], looks, 0.0)
    mean = uniform_filter(filled, (3, 3, 1))
    square = uniform_filter(filled**2, (3, 3, 1))
    deviation = np.sqrt(np.maximum(square - mean**2, 0.0)).mean(axis=2)
    return np.where(minimum_filter(valid, 3), deviation, np.inf)


def _slope(heights: FloatArray, cell: float) -> FloatArray:
    """Slope over eight cells (four nodes of a DEM) of heights smoothed over 3 × 3; infinite where unknown."""
    from scipy.ndimage import uniform_filter

    even = uniform_filter(np.nan_to_num(heights), 3)
    rows, cols = (np.zeros_like(even) for _ in range(2))
    rows[4:-4] = (even[8:] - even[:-8]) / (8 * cell)
    cols[:, 4:-4] = (even[:, 8:] - even[:, :-8]) / (8 * cell)
    # Smoothing and differences reach five cells to each side.
    unknown = uniform_filter(np.isnan(heights).astype(float), 11) > 1e-9
    return np.where(unknown, np.inf, np.hypot(rows, cols))


def _plane(own: BoolArray, heights: FloatArray, cell: float) -> tuple[float, float]:
    """Slope of the plane through the heights of a group, and their RMS about it."""
    r, c = np.nonzero(own)
    z = heights[own]
    design = np.stack([np.ones(len(z)), (c - c.mean()) * cell, (r - r.mean()) * cell], axis=1)
    plane = np.linalg.lstsq(design, z, rcond=None)[0]
    return float(np.hypot(plane[1], plane[2])), float(np.sqrt(np.mean((z - design @ plane) ** 2)))


LAYER = "water"
MAX_CELLS = 4_000_000
# Cells of the smallest water body that is not mere chance.
MIN_CELLS = 40


@dataclass(frozen=True)
class WaterResult(VectorProduct):
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
    dem_heights: str | None = None,
    overwrite: bool = False,
    **options: Any,
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
    dem_heights : str, optional
        Vertical datum of the DEM, where the file does not say it.
    overwrite : bool
        Replace an existing file.
    **options
        Of `WaterOptions`: `min_area`, `tilt`.

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

    image, dem, output, wanted = given_path(image), given_path(dem), given_path(output), compose(WaterOptions, options)
    if output.suffix.lower() != ".gpkg":
        raise InputError("areas are written as GeoPackage", where=str(output), hint="end the name in .gpkg")
    check_output(output, overwrite=overwrite, inputs=(image, dem))
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
    min_area = MIN_CELLS * cell**2 if wanted.min_area is None else wanted.min_area
    # Fewer cells may be level and even by chance, however small an area is asked for.
    cells = max(MIN_CELLS, math.ceil(min_area / cell**2))
    number, lakes = _find_lakes(values, valid, under, cell, smallest=cells, tilt=wanted.tilt)
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

    parts = polygons_of_labels(number, grid)
    if not parts:
        return []
    # As a coverage: lakes that touch keep a common border.
    smooth = shapely.coverage_simplify(np.array([part for part, _ in parts], dtype=object), grid.resolution[0])
    of_lake: dict[int, list[object]] = {lake.number: [] for lake in lakes}
    for shape, (_, own) in zip(smooth, parts, strict=True):
        of_lake[own].append(shape)
    return [shapely.union_all(np.array(own, dtype=object)) for own in of_lake.values()]
