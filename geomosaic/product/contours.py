"""Contours of a DEM: to a GeoPackage, or for a sheet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.carto.contours import Contour, Heights, nice_interval, trace
from geomosaic.errors import InputError
from geomosaic.geo.crs import height_name, horizontal
from geomosaic.geo.grid import Bounds
from geomosaic.geo.transform import Transform
from geomosaic.raster.output import check_output
from geomosaic.raster.vector import Layer, write_layers
from geomosaic.surface.dem import Dem


@dataclass(frozen=True)
class ContourResult:
    """What was made.

    Attributes
    ----------
    path : Path
    interval, tolerance : float
        Metres.
    low, high : float
        Range of the contours' heights in metres; NaN where there are none.
    lines, index_lines : int
        Contours, and main ones among them.
    deviation : float
        Largest difference in metres between the DEM's surface along a contour and the contour's height.
    heights : str
        Vertical datum.
    """

    path: Path
    interval: float
    tolerance: float
    low: float
    high: float
    lines: int
    index_lines: int
    deviation: float
    heights: str


def make_contours(
    dem: Path,
    output: Path,
    *,
    interval: float | None = None,
    index: int = 5,
    tolerance: float | None = None,
    shortest: float | None = None,
    heights: str | None = None,
    overwrite: bool = False,
) -> ContourResult:
    """Trace contours of a whole DEM and write them as layer `contours` of a GeoPackage.

    Columns: `height` (metres), `main` (true for every `index`-th), `deviation` (metres, see `ContourResult`). The
    ground rises to the left of each line.

    Parameters
    ----------
    dem : Path
    output : Path
        Ends in .gpkg.
    interval : float, optional
        Metres; a round one that gives about 20 contours by default.
    index : int
        Every so many contours one is a main one.
    tolerance : float, optional
        Metres of height that smoothing may change; a tenth of the interval by default, 0 for none.
    shortest : float, optional
        Shorter rings are left out; in units of the DEM's CRS, 8 nodes by default.
    heights : str, optional
        Vertical datum of the DEM, where the file does not say it.
    overwrite : bool
        Replace an existing file.

    Raises
    ------
    InputError, OutputExistsError, OutputError
    """
    if output.suffix.lower() != ".gpkg":
        raise InputError("contours are written as GeoPackage", where=str(output), mend="end the name in .gpkg")
    check_output(output, overwrite=overwrite)
    surface = Dem.open(dem, heights=heights)
    try:
        if interval is None:
            interval = nice_interval(*surface.range)
        shortest = 8.0 * surface.spacing if shortest is None else shortest
        nodes = _nodes(surface, surface.grid.bounds, 0.0)
        found = trace(nodes, interval, index=index, tolerance=tolerance, shortest=shortest)
        datum = height_name(surface.crs)
    finally:
        surface.close()
    if not found:
        raise InputError(
            f"no contour: the heights do not reach a multiple of {interval:g} m",
            where=str(dem),
            mend="give a shorter --interval",
        )
    import shapely

    lines = [shapely.LineString(c.xy) for c in found]
    columns: dict[str, Sequence[Any]] = {
        "height": [c.height for c in found],
        "main": [c.index for c in found],
        "deviation": [round(c.deviation, 4) for c in found],
    }
    write_layers(output, {"contours": Layer(surface.grid.crs, "LineString", lines, columns)}, overwrite=overwrite)
    return ContourResult(
        output, interval, 0.1 * interval if tolerance is None else tolerance, found[0].height, found[-1].height,
        len(found), sum(c.index for c in found), max(c.deviation for c in found), datum,
    )  # fmt: skip


def _nodes(surface: Dem, bounds: Bounds, spacing: float) -> Heights:
    patch = surface.patch(bounds, spacing)
    return Heights(patch.heights, ~patch.transform)


def sheet_contours(
    dem: Path,
    crs: CRS,
    bounds: Bounds,
    spacing: float,
    *,
    interval: float | None,
    index: int,
    tolerance: float | None,
    heights: str | None,
) -> tuple[list[Contour], float, str]:
    """Contours inside a neatline.

    Parameters
    ----------
    dem : Path
    crs : CRS
        Of the map.
    bounds : Bounds
        Neatline in `crs`.
    spacing : float
        In units of `crs`: closer nodes are averaged, since the paper does not show them.
    interval, index, tolerance, heights
        As in `make_contours`; the interval by default follows from the heights on the sheet.

    Returns
    -------
    contours : list of Contour
        In `crs`.
    interval : float
        Metres.
    datum : str
        Name of the vertical datum.

    Raises
    ------
    InputError
        The DEM does not cover the sheet.
    """
    surface = Dem.open(dem, heights=heights)
    try:
        there, back = Transform(crs, surface.grid.crs), Transform(surface.grid.crs, horizontal(crs))
        left, bottom, right, top = bounds
        t = np.linspace(0.0, 1.0, 33)
        edge = np.array(
            [(left + u * (right - left), y) for u in t for y in (bottom, top)]
            + [(x, bottom + u * (top - bottom)) for u in t for x in (left, right)]
        )
        edge = there(edge)
        low, high = edge.min(axis=0), edge.max(axis=0)
        ratio = float((high - low).max() / max(right - left, top - bottom))
        nodes = _nodes(surface, (low[0], low[1], high[0], high[1]), spacing * ratio)
        known = nodes.values[np.isfinite(nodes.values)]
        if not known.size:
            raise InputError("the DEM has no heights on the sheet", where=str(dem), mend="give one that covers it")
        if interval is None:
            interval = nice_interval(float(known.min()), float(known.max()))
        cell = float(np.hypot(nodes.transform.a, nodes.transform.d))
        found = trace(nodes, interval, index=index, tolerance=tolerance, shortest=12.0 * cell)
        return [replace(c, xy=back(c.xy)) for c in found], interval, height_name(surface.crs)
    finally:
        surface.close()
