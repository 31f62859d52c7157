"""Contours and spot heights of a DEM, to a GeoPackage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import height_name
from geomosaic.geo.grid import Bounds
from geomosaic.raster.output_files import check_output
from geomosaic.raster.vector import Layer, write_layers
from geomosaic.relief.contour_smoothing import Heights
from geomosaic.relief.contours import nice_interval, trace
from geomosaic.relief.spot_heights import SpotHeight, find_spots
from geomosaic.surface.dem import Dem
from geomosaic.types import PathLike


@dataclass(frozen=True)
class ContourResult:
    """Contours and spot heights written to a file.

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
    summits, hollows : int
        Spot heights.
    prominence : float
        Metres by which they stand out at least; 0 where none were looked for.
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
    summits: int = 0
    hollows: int = 0
    prominence: float = 0.0


def contours(
    dem: PathLike,
    output: PathLike,
    *,
    interval: float | None = None,
    index: int = 5,
    tolerance: float | None = None,
    min_length: float | None = None,
    dem_heights: str | None = None,
    prominence: float | None = None,
    spacing: float | None = None,
    overwrite: bool = False,
) -> ContourResult:
    """Contours and spot heights of a whole DEM, written as layers of a GeoPackage.

    Columns: `height` (metres), `main` (true for every `index`-th), `deviation` (metres, see `ContourResult`). The
    ground rises to the left of each line. Layer `spot_heights` has the summits and hollows that stand out: `height`,
    `prominence` (metres), `kind`.

    Parameters
    ----------
    dem : path
    output : path
        Ends in .gpkg.
    interval : float, optional
        Metres; a round one that gives about 20 contours by default.
    index : int
        Every so many contours one is a main one.
    tolerance : float, optional
        Metres of height that smoothing may change; a tenth of the interval by default, 0 for none.
    min_length : float, optional
        Shorter rings are left out; in units of the DEM's CRS, 8 nodes by default.
    dem_heights : str, optional
        Vertical datum of the DEM, where the file does not say it.
    prominence : float, optional
        Metres by which spot heights stand out at least; the interval by default, 0 for no spot heights.
    spacing : float, optional
        Of spot heights, in units of the DEM's CRS; 20 nodes by default.
    overwrite : bool
        Replace an existing file.

    Raises
    ------
    InputError, OutputExistsError, OutputError
    """
    dem, output = Path(dem), Path(output)
    if output.suffix.lower() != ".gpkg":
        raise InputError("contours are written as GeoPackage", where=str(output), hint="end the name in .gpkg")
    check_output(output, overwrite=overwrite)
    surface = Dem.open(dem, heights=dem_heights)
    try:
        if interval is None:
            interval = nice_interval(*surface.range)
        min_length = 8.0 * surface.spacing if min_length is None else min_length
        nodes = nodes_of(surface, surface.grid.bounds, 0.0)
        found = trace(nodes, interval, index=index, tolerance=tolerance, shortest=min_length)
        prominence = interval if prominence is None else prominence
        spacing = 20.0 * surface.spacing if spacing is None else spacing
        spots = find_spots(nodes, prominence, spacing) if prominence > 0 else []
        datum = height_name(surface.crs)
    finally:
        surface.close()
    if not found:
        raise InputError(
            f"no contour: the heights do not reach a multiple of {interval:g} m",
            where=str(dem),
            hint="give a shorter `interval`",
        )
    import shapely

    lines = [shapely.LineString(c.xy) for c in found]
    columns: dict[str, Sequence[Any]] = {
        "height": [c.height for c in found],
        "main": [c.index for c in found],
        "deviation": [round(c.deviation, 4) for c in found],
    }
    layers = {"contours": Layer(surface.grid.crs, "LineString", lines, columns)}
    if spots:
        layers["spot_heights"] = _spot_layer(spots, surface.grid.crs)
    write_layers(output, layers, overwrite=overwrite)
    return ContourResult(
        output, interval, 0.1 * interval if tolerance is None else tolerance, found[0].height, found[-1].height,
        len(found), sum(c.index for c in found), max(c.deviation for c in found), datum,
        sum(not spot.hollow for spot in spots), sum(spot.hollow for spot in spots), prominence,
    )  # fmt: skip


def _spot_layer(spots: Sequence[SpotHeight], crs: CRS) -> Layer:
    import shapely

    columns: dict[str, Sequence[Any]] = {
        "height": [round(spot.height, 3) for spot in spots],
        "prominence": [round(spot.prominence, 3) for spot in spots],
        "kind": ["hollow" if spot.hollow else "summit" for spot in spots],
    }
    return Layer(crs, "Point", [shapely.Point(spot.x, spot.y) for spot in spots], columns)


def nodes_of(surface: Dem, bounds: Bounds, spacing: float) -> Heights:
    """Heights over bounds in the CRS of the surface; nodes closer than `spacing` are averaged."""
    patch = surface.patch(bounds, spacing)
    return Heights(patch.heights, ~patch.transform)
