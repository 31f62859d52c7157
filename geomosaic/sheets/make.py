"""Map sheet of a raster: its contents gathered, drawn and written as one file."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.enhancement.picture import band_curves, finishing, local_equalisation, shown_bands
from geomosaic.errors import InputError, warn
from geomosaic.geo.crs import geographic, height_name, horizontal, is_local, parse_crs
from geomosaic.geo.grid import Bounds, Grid
from geomosaic.geo.local_frames import map_place
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import linear_unit
from geomosaic.options.sheet import FileOptions, scale_text
from geomosaic.raster.files import check_output
from geomosaic.raster.pictures import picture, raster_grid
from geomosaic.raster.source import Source
from geomosaic.relief.contours import Contour, nice_interval, nodes_of, trace
from geomosaic.relief.spot_heights import SpotHeight, find_spots
from geomosaic.sheets.drawing.canvas import drawing, missing_glyphs
from geomosaic.sheets.drawing.contents import SheetParts
from geomosaic.sheets.drawing.save import check_format, write_sheet
from geomosaic.sheets.grid_lines import MapGrid, map_grid, neatline_points
from geomosaic.sheets.layout import ContoursPart, GraticulePart, GridPart, Layout, check_layout, declination
from geomosaic.sheets.notes import accuracy_statement, blocks
from geomosaic.sheets.page import Box, Page, lay_out
from geomosaic.sheets.series.regular import SheetPlace
from geomosaic.sheets.vector_layers import VectorInput, read_overlay
from geomosaic.surface.dem import Dem
from geomosaic.types import ByteArray, FloatArray, Progress

# Least distance of lines on paper, for the intervals that are not given: coordinates of seven figures take 10 mm and
# stand clear of each other, and closer lines would cover the picture.
_GRID_MM, _GRATICULE_MM = 40.0, 50.0
# Distance on paper below which nodes of a DEM are averaged for contours: three widths of a line.
_NODE_MM = 0.35
# A map is told to be small where it could be so many times as wide and high on its paper: two steps of round scales,
# since one step may be wanted so that several sheets have one scale.
_SMALL = 4.0
# Latitude in degrees beyond which the middle of a sheet counts as the pole, where north has no direction.
_AT_POLE = 89.9999


@dataclass(frozen=True)
class SheetResult:
    """Map sheet written to a file, with its geometry and contents.

    Attributes
    ----------
    path : Path
    page : Page
        Paper, neatline, area and scale.
    intervals : tuple of float or None
        Intervals of grid and graticule, in their units.
    contours : int
        Number of contour lines.
    contour_interval : float
        Metres; 0 without contours.
    layers : mapping of str to int
        Number of objects drawn, by title of the layer.
    convergence : float or None
        Meridian convergence, degrees; None in a local frame.
    image_dpi : float
        Pixels of the raster per inch of paper.
    records : tuple of str
        Files that notes were taken from.
    elements : mapping of str to Box
        Left, bottom, right, top in mm on the page of title, legend and what else stands around the map; empty where
        the map alone was written.
    """

    path: Path
    page: Page
    intervals: tuple[float | None, float | None]
    contours: int
    contour_interval: float
    layers: Mapping[str, int]
    convergence: float | None
    image_dpi: float
    records: tuple[str, ...] = ()
    elements: Mapping[str, Box] = field(default_factory=dict)

    def __repr__(self) -> str:
        page = self.page
        return f"SheetResult('{self.path}', 1:{page.scale:.10g} on {page.width:g} x {page.height:g} mm)"


@dataclass(frozen=True)
class SheetInputs:
    """Inputs of a sheet, or of all sheets of a series.

    Attributes
    ----------
    raster : Path, north up, in a projected CRS or a local frame: that of the map
    layout : Layout
    layers : tuple of VectorInput, lowest first
    dem : Path, optional, of contours and spot heights
    dem_heights : str, optional, vertical datum of the DEM, where the file does not say it
    shade : Path, optional, DEM of the hillshade; that of the contours where it is not given
    report : mapping, optional
        A project's report and STAC item (under `stac`), for accuracy, sources and date of photography; names of the
        files under `read`.
    files : FileOptions
    """

    raster: Path
    layout: Layout
    layers: tuple[VectorInput, ...] = ()
    dem: Path | None = None
    dem_heights: str | None = None
    shade: Path | None = None
    report: Mapping[str, Any] | None = None
    files: FileOptions = field(default_factory=FileOptions)


def make_sheet(
    inputs: SheetInputs, output: Path, *, series: SheetPlace | None = None, overwrite: bool = False,
    progress: Progress | None = None,
) -> SheetResult:  # fmt: skip
    """Map sheet of a raster at an exact scale.

    Parameters
    ----------
    inputs : SheetInputs
    output : Path, .pdf and .png are the whole page; .tif is the map cut at the neatline, georeferenced
    series : SheetPlace, optional
        Place of the sheet in a series: its neatline, number and neighbours win over the layout.
    overwrite : bool, replace an existing file
    progress : callable, optional
        Called with the number of stages done, their number and the name of the one that begins.

    Raises
    ------
    InputError, OutputExistsError, OutputError
    """
    stage = progress or (lambda _done, _total, _name: None)
    raster, layout = inputs.raster, inputs.layout
    check_format(output, inputs.files)
    check_layout(layout)
    vectors = (vector.path for vector in inputs.layers)
    check_output(output, overwrite=overwrite, inputs=(raster, *vectors, *filter(None, (inputs.dem, inputs.shade))))
    with Source(raster) as source:
        grid = raster_grid(source, str(raster))
        if series is not None:
            layout = series_layout(layout, series)
        page = lay_out(layout, grid.crs, grid.bounds, str(raster))
        if series is None:
            if layout.map.bounds is None:
                _warn_of_cropping(page, grid.bounds)
            warn_of_small_map(page, layout, grid)
        if series is not None and len(series.ring) > 4:
            page = replace(page, outline=tuple((float(x), float(y)) for x, y in series.ring))
        dpi = layout.sheet.dpi
        stage(0, 3, "contours and vectors")
        parts = replace(_sheet_parts(inputs, layout, page), series=series)

        stage(1, 3, "statistics of the raster")
        look = layout.enhance
        bands = shown_bands(look, source.info.bands, str(raster))
        curves = band_curves(look, source, grid, bands)
        finish = finishing(
            look, local_equalisation(look, source, grid, bands, curves), grid, dpi=dpi,
            metres=linear_unit(page.crs), dem=inputs.shade or inputs.dem, dem_heights=inputs.dem_heights,
        )  # fmt: skip

        def pixels(box: Box) -> ByteArray:
            (left, bottom), (right, top) = page.to_map(np.array([box[:2], box[2:]]))
            size = [max(1, round((box[k + 2] - box[k]) / 25.4 * dpi)) for k in (0, 1)]
            area = (float(left), float(bottom), float(right), float(top))
            return finish(picture(source, grid, area, (size[0], size[1]), bands, curves), area)

        with drawing(layout.sheet.fonts):
            _warn_of_glyphs(parts)
            stage(2, 3, "drawing")
            elements, remarks = write_sheet(output, parts, pixels, dpi, inputs.files, overwrite=overwrite)
    for text in remarks:
        warn(text)
    intervals = tuple(None if grid_ is None else grid_.interval for grid_ in parts.grids)
    return SheetResult(
        output, page, (intervals[0], intervals[1]), len(parts.contours), parts.interval,
        {layer.title: layer.count for layer in parts.layers}, parts.convergence,
        25.4 / (page.mm_per_unit * grid.resolution[0]), tuple((inputs.report or {}).get("read", ())),
        elements,
    )  # fmt: skip


def series_layout(layout: Layout, series: SheetPlace) -> Layout:
    """Layout with area, scale, number and series name of one sheet of a series.

    Parameters
    ----------
    layout : Layout, its scale and title win over those of the series
    series : SheetPlace
    """
    sheet = replace(
        layout.sheet,
        number=series.name,
        title=layout.sheet.title or series.series[:1].upper() + series.series[1:],
    )
    area = replace(layout.map, bounds=series.bounds, centre=None, scale=layout.map.scale or series.scale)
    return replace(layout, sheet=sheet, map=area)


def _sheet_parts(inputs: SheetInputs, layout: Layout, page: Page) -> SheetParts:
    """Contents of a sheet in page coordinates; `layout` is that of the inputs, or of one sheet of a series."""
    report = inputs.report or {}
    left, bottom, right, top = page.bounds
    place = None if is_local(page.crs) else map_place(page.crs, (left + right) / 2, (bottom + top) / 2)
    relief = (
        _SheetRelief() if inputs.dem is None else _sheet_relief(inputs.dem, inputs.dem_heights, page, layout.contours)
    )
    grids = (_grid(layout.grid, page, _GRID_MM), _grid(layout.graticule, page, _GRATICULE_MM))
    layers = tuple(read_overlay(vector, page, k) for k, vector in enumerate(inputs.layers))
    measured = layout.notes.accuracy or accuracy_statement(report, page.scale)
    if not measured and {"orient", "check"} & set(report):
        warn("the report measured no accuracy, so the sheet states none")
    texts = tuple(blocks(layout, page, place, relief.datum, report))
    return SheetParts(
        page,
        layout,
        grids,
        layers,
        relief.contours,
        relief.interval,
        relief.spots,
        texts,
        place.convergence if place and abs(place.latitude) < _AT_POLE else None,
        magnetic=declination(layout.north, place),
    )


@dataclass(frozen=True)
class _SheetRelief:
    """Contours (interval in metres, 0 without) and spot heights, the most prominent first, in the CRS of the map."""

    contours: tuple[Contour, ...] = ()
    interval: float = 0.0
    datum: str | None = None
    spots: tuple[SpotHeight, ...] = ()


def _sheet_relief(dem: Path, heights: str | None, page: Page, part: ContoursPart) -> _SheetRelief:
    """Contours and spot heights inside the neatline; the interval by default follows from the heights there."""
    crs, bounds, interval = page.crs, page.bounds, part.interval
    with closing(Dem.open(dem, heights=heights)) as surface:
        there, back = Transform(crs, surface.grid.crs), Transform(surface.grid.crs, horizontal(crs))
        left, bottom, right, top = bounds
        # The edge of the sheet in the CRS of the DEM: its box there, and how long a unit of the map is.
        edge = there(neatline_points(bounds))
        low, high = edge.min(axis=0), edge.max(axis=0)
        ratio = float((high - low).max() / max(right - left, top - bottom))
        # The paper does not show closer nodes.
        spacing = _NODE_MM / page.mm_per_unit * ratio
        nodes = nodes_of(surface, (low[0], low[1], high[0], high[1]), spacing)
        known = nodes.values[np.isfinite(nodes.values)]
        if not known.size:
            raise InputError("the DEM has no heights on the sheet", where=str(dem), hint="give one that covers it")
        if interval is None:
            interval = nice_interval(float(known.min()), float(known.max()))
        _warn_of_dem_gaps(surface, there(_lattice(bounds)), dem)
        cell = float(np.hypot(nodes.transform.a, nodes.transform.d))
        found = trace(nodes, interval, index=part.index, tolerance=part.tolerance, shortest=12.0 * cell)
        lines = tuple(replace(c, xy=back(c.xy)) for c in found)
        points: list[SpotHeight] = []
        if part.spots:
            apart = part.spot_spacing / page.mm_per_unit * ratio
            points = find_spots(nodes, part.spot_prominence or interval, apart)
            points = [_snapped_to_extremum(surface, point, cell) for point in points]
        return _SheetRelief(lines, interval, height_name(surface.crs), _moved(points, back))


def _lattice(bounds: Bounds) -> FloatArray:
    """Sample positions (N, 2) spread over bounds."""
    t = (np.arange(24) + 0.5) / 24
    x, y = np.meshgrid(bounds[0] + t * (bounds[2] - bounds[0]), bounds[1] + t * (bounds[3] - bounds[1]))
    return np.column_stack([x.ravel(), y.ravel()])


def _warn_of_dem_gaps(surface: Dem, places: FloatArray, dem: Path) -> None:
    """Warning where contours end because the DEM does."""
    known = float(np.isfinite(surface.height(places)).mean())
    if known < 0.98:
        warn(f"{dem} has heights on {100 * known:.0f} % of the sheet")


def _snapped_to_extremum(surface: Dem, spot: SpotHeight, reach: float) -> SpotHeight:
    """Spot height found on averaged nodes, moved to the highest (or lowest) original node near it."""
    nodes = nodes_of(surface, (spot.x - reach, spot.y - reach, spot.x + reach, spot.y + reach), 0.0)
    values = -nodes.values if spot.hollow else nodes.values
    row, col = np.unravel_index(np.nanargmax(values), values.shape)
    x, y = nodes.transform @ (float(col) + 0.5, float(row) + 0.5)
    return replace(spot, x=float(x), y=float(y), height=float(nodes.values[row, col]))


def _moved(spots: Sequence[SpotHeight], back: Transform) -> tuple[SpotHeight, ...]:
    places = back(np.array([(spot.x, spot.y) for spot in spots]).reshape(-1, 2))
    return tuple(replace(spot, x=float(x), y=float(y)) for spot, (x, y) in zip(spots, places, strict=True))


def _grid(part: GridPart, page: Page, spacing: float) -> MapGrid | None:
    """Grid where one is wanted; without a CRS of its own it is that of the map, a graticule longitude and latitude."""
    if part.style == "none":
        return None
    if part.crs:
        crs = parse_crs(part.crs)
    elif not isinstance(part, GraticulePart):
        crs = page.crs
    elif is_local(page.crs):
        return None
    else:
        crs = geographic(page.crs)
    return map_grid(crs, page.crs, page.bounds, spacing / page.mm_per_unit, part.interval)


def _warn_of_cropping(page: Page, whole: Bounds) -> None:
    """Warning that the paper shows a part of the raster only, though no bounds were given."""
    shown = [(page.bounds[k + 2] - page.bounds[k]) / (whole[k + 2] - whole[k]) for k in (0, 1)]
    if min(shown) < 1.0 - 1e-6:
        warn(
            f"at {scale_text(page.scale)} the paper shows {min(shown[0], 1.0):.0%} of the picture's width and "
            f"{min(shown[1], 1.0):.0%} of its height; a smaller scale or a larger paper shows all"
        )


def warn_of_small_map(page: Page, layout: Layout, grid: Grid) -> None:
    """Warning that a map leaves most of its paper white, with the scale that fills it.

    Parameters
    ----------
    page : Page, laid out from `layout`
    layout : Layout
    grid : Grid, of the raster
    """
    paper = layout.sheet.paper or "A4"  # the smallest of those that are tried
    filling = lay_out(
        replace(layout, map=replace(layout.map, scale=None), sheet=replace(layout.sheet, paper=paper)),
        grid.crs, grid.bounds,
    )  # fmt: skip
    if page.scale >= _SMALL * filling.scale:
        left, bottom, right, top = page.neatline
        warn(
            f"at {scale_text(page.scale)} the map is {right - left:.0f} x {top - bottom:.0f} mm on {paper}; "
            f"`scale={scale_text(filling.scale)}` fills the paper"
        )


def _warn_of_glyphs(parts: SheetParts) -> None:
    """Warning that names the characters missing from the fonts."""
    sheet = parts.layout.sheet
    texts = [
        sheet.title, sheet.subtitle, sheet.series, sheet.number, sheet.name, parts.layout.legend.title,
        *(line for _, lines in parts.blocks for line in lines),
        *(parts.series.neighbours.values() if parts.series else ()),
        *(layer.title for layer in parts.layers), *(name.text for layer in parts.layers for name in layer.names),
        *(group.title for layer in parts.layers for group in layer.groups),
    ]  # fmt: skip
    lost = missing_glyphs(texts)
    if lost:
        text = f"the font has no glyph for: {' '.join(lost[:40])} (give one that has: [sheet] fonts)"
        warn(text)
        # Matplotlib would warn again for every text.
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
