"""Contours of a DEM: traced, refined, and written with its spot heights to a GeoPackage."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import height_name
from geomosaic.geo.grid import Bounds
from geomosaic.numbers import multiples, nice_step
from geomosaic.options.declaration import compose
from geomosaic.options.sheet import ContourOptions
from geomosaic.raster.files import check_output
from geomosaic.raster.vector import Layer, VectorProduct, write_layers
from geomosaic.relief.contour_smoothing import Heights, deviation, on_surface, smooth
from geomosaic.relief.spot_heights import SpotHeight, find_spots
from geomosaic.stores.path import given_path
from geomosaic.surface.dem import Dem
from geomosaic.types import FloatArray, PathLike

# Contours that are traced at most: more would be one black area, and take minutes.
_MOST_LEVELS = 2000


@dataclass(frozen=True)
class Contour:
    """Contour line.

    Attributes
    ----------
    height : float, height of the contour, metres
    index : bool, whether it is a main contour
    xy : array (N, 2)
        Vertices in the CRS of the heights; the ground rises to the left. Closed where the first point is the last.
    deviation : float, largest difference in metres between the surface along the line and `height`
    """

    height: float
    index: bool
    xy: FloatArray
    deviation: float

    @property
    def closed(self) -> bool:
        """Whether it is a ring."""
        return _closed(self.xy)


def nice_interval(low: float, high: float, count: int = 20) -> float:
    """Round interval that gives about `count` contours between two heights.

    Parameters
    ----------
    low, high : float, metres
    count : int
    """
    return nice_step(max((high - low) / count, 1e-3))


def trace(
    heights: Heights, interval: float, *, index: int = 5, tolerance: float | None = None, shortest: float = 0.0
) -> list[Contour]:
    """Contours at all multiples of an interval, from the lowest up.

    Parameters
    ----------
    heights : Heights
    interval : float, metres
    index : int, every so many contours, counted from height 0, one is a main one
    tolerance : float, optional
        Metres of height that smoothing may change; a tenth of the interval by default, 0 for contours as traced.
    shortest : float, rings shorter than this, in map units, are left out

    Raises
    ------
    InputError
        The interval is not positive, gives more than 2000 levels, or the tolerance is half the interval or more.
    """
    from contourpy import LineType, contour_generator

    if not (interval > 0 and np.isfinite(interval)):
        raise InputError(f"{interval} is no interval of contours", hint="give metres, such as 5")
    tolerance = 0.1 * interval if tolerance is None else tolerance
    if not 0 <= tolerance < 0.5 * interval:
        raise InputError(
            f"a tolerance of {tolerance:g} m is no less than half the interval of {interval:g} m: contours could cross",
            hint="give a smaller tolerance",
        )
    known = heights.values[np.isfinite(heights.values)]
    if not known.size or min(heights.values.shape) < 2:
        raise InputError("there are no heights to draw contours of", hint="check that the DEM covers the area")
    levels = multiples(float(known.min()), float(known.max()), interval)
    if len(levels) > _MOST_LEVELS:
        raise InputError(
            f"an interval of {interval:g} m gives {len(levels)} contours between {known.min():.1f} and "
            f"{known.max():.1f} m",
            hint="give a longer interval",
        )
    # A serial generator: its lines do not depend on threads.
    generator = contour_generator(
        z=np.ma.masked_invalid(heights.values.astype(np.float64)), name="serial", line_type=LineType.Separate
    )
    lines: list[FloatArray] = []
    heights_of: list[float] = []
    cell = float(np.hypot(heights.transform.a, heights.transform.d))
    for level in levels:
        traced: Any = generator.lines(float(level))
        if tolerance > 0:
            traced = on_surface(heights.values, [line for line in traced if len(line) > 1], float(level), tolerance)
        for line in map(_distinct, traced):
            if len(line) > 1 and not (_closed(line) and cell * np.hypot(*np.diff(line, axis=0).T).sum() < shortest):
                lines.append(line)
                heights_of.append(float(level))
    if tolerance > 0:
        lines = smooth(heights.values, lines, heights_of, tolerance)
    return [
        _finish(heights, line, level, round(level / interval) % index == 0)
        for line, level in zip(lines, heights_of, strict=True)
    ]


def _finish(heights: Heights, nodes: FloatArray, level: float, main: bool) -> Contour:
    """Contour on the map from vertices (N, 2) in node coordinates, directed with higher ground to the left."""
    t = heights.transform
    col, row = nodes[:, 0] + 0.5, nodes[:, 1] + 0.5
    xy = np.column_stack([t.a * col + t.b * row + t.c, t.d * col + t.e * row + t.f])
    if not _rises_left(heights, xy):
        xy, nodes = xy[::-1], nodes[::-1]
    return Contour(level, main, np.ascontiguousarray(xy), deviation(heights.values, nodes, level))


def _closed(nodes: FloatArray) -> bool:
    return bool((nodes[0] == nodes[-1]).all())


def _distinct(nodes: FloatArray) -> FloatArray:
    """Vertices without those that coincide with the one before."""
    keep = np.concatenate([[True], np.hypot(*np.diff(nodes, axis=0).T) > 1e-9])
    if not keep[-1]:  # a ring's last point stays the first
        keep[-1], keep[np.flatnonzero(keep)[-1]] = True, False
    kept: FloatArray = nodes[keep]
    return kept


def _rises_left(heights: Heights, xy: FloatArray) -> bool:
    """Whether the ground to the left of a line is higher than to its right, by the middle of its segments."""
    a, b = xy[:-1], xy[1:]
    middle, along = (a + b) / 2, b - a
    length = np.hypot(*along.T)
    t = heights.transform
    aside = (
        0.25 * np.hypot(t.a, t.d) * np.column_stack([-along[:, 1], along[:, 0]]) / np.maximum(length, 1e-12)[:, None]
    )
    rise = heights.at(middle + aside) - heights.at(middle - aside)
    return bool(np.nansum(rise * length) >= 0)


@dataclass(frozen=True)
class ContourResult(VectorProduct):
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
    dem_heights: str | None = None,
    overwrite: bool = False,
    **options: Any,
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
    dem_heights : str, optional
        Vertical datum of the DEM, where the file does not say it.
    overwrite : bool
        Replace an existing file.
    **options
        Of `ContourOptions`: `interval`, `index`, `tolerance`, `min_length`, `prominence`, `spacing`.

    Raises
    ------
    InputError, OutputExistsError, OutputError
    """
    dem, output, wanted = given_path(dem), given_path(output), compose(ContourOptions, options)
    if output.suffix.lower() != ".gpkg":
        raise InputError("contours are written as GeoPackage", where=str(output), hint="end the name in .gpkg")
    check_output(output, overwrite=overwrite, inputs=(dem,))
    with closing(Dem.open(dem, heights=dem_heights)) as surface:
        interval = nice_interval(*surface.range) if wanted.interval is None else wanted.interval
        shortest = 8.0 * surface.spacing if wanted.min_length is None else wanted.min_length
        nodes = nodes_of(surface, surface.grid.bounds, 0.0)
        found = trace(nodes, interval, index=wanted.index, tolerance=wanted.tolerance, shortest=shortest)
        prominence = interval if wanted.prominence is None else wanted.prominence
        spacing = 20.0 * surface.spacing if wanted.spacing is None else wanted.spacing
        spots = find_spots(nodes, prominence, spacing) if prominence > 0 else []
        datum = height_name(surface.crs)
    if not found:
        raise InputError(
            f"no contour: the heights do not reach a multiple of {interval:g} m",
            where=str(dem),
            hint="give a shorter `interval`",
        )
    import shapely

    lines = [shapely.LineString(c.xy) for c in found]
    columns: dict[str, Sequence[Any]] = {
        "height": [c.height for c in found], "main": [c.index for c in found],
        "deviation": [round(c.deviation, 4) for c in found],
    }  # fmt: skip
    layers = {"contours": Layer(surface.grid.crs, "LineString", lines, columns)}
    if spots:
        layers["spot_heights"] = _spot_layer(spots, surface.grid.crs)
    write_layers(output, layers, overwrite=overwrite)
    return ContourResult(
        output, interval, 0.1 * interval if wanted.tolerance is None else wanted.tolerance,
        found[0].height, found[-1].height,
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
    """Heights over bounds in the CRS of the surface; nodes closer than `spacing` are averaged.

    Parameters
    ----------
    surface : Dem
    bounds : Bounds, in the CRS of the surface
    spacing : float, units of that CRS; 0 for all nodes
    """
    patch = surface.patch(bounds, spacing)
    return Heights(patch.heights, ~patch.transform)
