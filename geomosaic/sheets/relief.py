"""Relief of a sheet: contours and spot heights of a DEM, inside its neatline."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from pyproj import CRS

from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.geo.crs import height_name, horizontal
from geomosaic.geo.grid import Bounds
from geomosaic.geo.transform import Transform
from geomosaic.relief.contour_layers import nodes_of
from geomosaic.relief.contours import Contour, nice_interval, trace
from geomosaic.relief.spot_heights import SpotHeight, find_spots
from geomosaic.surface.dem import Dem
from geomosaic.types import FloatArray


@dataclass(frozen=True)
class SheetRelief:
    """Contours and spot heights in the CRS of the map.

    Attributes
    ----------
    contours : tuple of Contour
    interval : float
        Metres; 0 without contours.
    datum : str or None
        Name of the vertical datum.
    spots : tuple of SpotHeight
        The most prominent first.
    """

    contours: tuple[Contour, ...] = ()
    interval: float = 0.0
    datum: str | None = None
    spots: tuple[SpotHeight, ...] = ()


def sheet_relief(
    dem: Path,
    crs: CRS,
    bounds: Bounds,
    spacing: float,
    *,
    interval: float | None,
    index: int,
    tolerance: float | None,
    heights: str | None,
    spots: float | None,
    prominence: float | None,
) -> SheetRelief:
    """Contours and spot heights inside a neatline.

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
        As in `contours`; the interval by default follows from the heights on the sheet.
    spots : float, optional
        Least distance of spot heights in units of `crs`; None for none.
    prominence : float, optional
        Metres by which spot heights stand out at least; the interval by default.

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
        nodes = nodes_of(surface, (low[0], low[1], high[0], high[1]), spacing * ratio)
        known = nodes.values[np.isfinite(nodes.values)]
        if not known.size:
            raise InputError("the DEM has no heights on the sheet", where=str(dem), hint="give one that covers it")
        if interval is None:
            interval = nice_interval(float(known.min()), float(known.max()))
        _warn_of_dem_gaps(surface, there(_lattice(bounds)), dem)
        cell = float(np.hypot(nodes.transform.a, nodes.transform.d))
        found = trace(nodes, interval, index=index, tolerance=tolerance, shortest=12.0 * cell)
        lines = tuple(replace(c, xy=back(c.xy)) for c in found)
        points: list[SpotHeight] = []
        if spots is not None:
            points = find_spots(nodes, prominence or interval, spots * ratio)
            points = [_snapped_to_extremum(surface, point, cell) for point in points]
        return SheetRelief(lines, interval, height_name(surface.crs), _moved(points, back))
    finally:
        surface.close()


def _lattice(bounds: Bounds) -> FloatArray:
    """Sample positions (N, 2) spread over bounds."""
    t = (np.arange(24) + 0.5) / 24
    x, y = np.meshgrid(bounds[0] + t * (bounds[2] - bounds[0]), bounds[1] + t * (bounds[3] - bounds[1]))
    return np.column_stack([x.ravel(), y.ravel()])


def _warn_of_dem_gaps(surface: Dem, places: FloatArray, dem: Path) -> None:
    """Warning where contours end because the DEM does."""
    known = float(np.isfinite(surface.height(places)).mean())
    if known < 0.98:
        warnings.warn(f"{dem} has heights on {100 * known:.0f} % of the sheet", GeomosaicWarning, stacklevel=3)


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
