"""A sheet of a series on the map: its neatline, curved where it follows the graticule, and what surrounds it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal, parse_crs
from geomosaic.geo.grid import Bounds
from geomosaic.geo.transform import Transform
from geomosaic.sheets.extent import Extent, densified_ring, extent_of, neatline_points
from geomosaic.sheets.series.regular import Scheme
from geomosaic.types import FloatArray

PARTS = 64
"""Pieces of a side: between its nodes a side of 6° at 1:1 000 000 is off by 0.02 mm, shorter ones by less."""


@dataclass(frozen=True, eq=False)
class SheetPlace:
    """A sheet on the map.

    Attributes
    ----------
    name, series : str
    scale : float or None
    ring : array (N, 2)
        Neatline in the CRS of the map, not closed.
    corners : array (K, 2)
        Its corners there.
    neighbours : mapping of str to str
        Names around by direction.
    """

    name: str
    series: str
    scale: float | None
    ring: FloatArray
    corners: FloatArray
    neighbours: Mapping[str, str]

    @property
    def bounds(self) -> Bounds:
        """Smallest box around the neatline."""
        low, high = self.ring.min(axis=0), self.ring.max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def sheet_place(scheme: Scheme, name: str, map_crs: CRS, overlap: float = 0.0) -> SheetPlace:
    """Bring a sheet to a map.

    Parameters
    ----------
    scheme : Scheme
    name : str
    map_crs : CRS
        Projected.
    overlap : float
        Units of the map by which the sheet reaches beyond its edges.

    Raises
    ------
    InputError
        There is no such sheet, or the CRS does not reach it.
    """
    name = scheme.proper(name)
    crs, edges = scheme.edges(name)
    move = Transform(parse_crs(crs), map_crs)
    # Straight sides of a sheet in the map's own CRS stay as they are.
    ring = edges if move.source == move.target else move(densified_ring(edges, PARTS))
    corners = move(edges)
    if not np.isfinite(ring).all():
        raise InputError(
            f"sheet {name} lies where '{map_crs.name}' has no coordinates", hint="use a map CRS for its area"
        )
    if overlap > 0:
        from shapely import Polygon

        grown = Polygon(ring).buffer(overlap, join_style="mitre").exterior
        ring = np.asarray(grown.coords)[:-1]
    return SheetPlace(name, scheme.title, scheme.scale, ring, corners, scheme.neighbours(name))


def sheets_on(scheme: Scheme, map_crs: CRS, bounds: Bounds) -> Iterator[str]:
    """Names of the sheets that share ground with a rectangle of the map.

    Raises
    ------
    InputError
        The rectangle cannot be brought to the scheme's CRS.
    """
    from shapely import Polygon, box

    crs = parse_crs(scheme.crs)
    there = Transform(map_crs, crs)
    if not np.isfinite(there(neatline_points(bounds))).all():
        raise InputError(f"the area has no coordinates in {scheme.crs}", hint="use another scheme")
    extent = extent_of(horizontal(crs), there, Transform(crs, map_crs), bounds)
    area = box(*bounds)
    names = dict.fromkeys(name for part in _boxes(extent) for name in scheme.within(part))
    for name in names:
        part = Polygon(sheet_place(scheme, name, map_crs).ring).intersection(area)
        if part.area > 1e-9 * area.area:
            yield name


def _boxes(extent: Extent) -> list[Bounds]:
    """The box of an extent, or one on each side of the 180th meridian where it lies across it."""
    (left, bottom), (right, top) = extent.low.tolist(), extent.high.tolist()
    if extent.turns and right > 180.0:
        return [(left, bottom, 180.0, top), (-180.0, bottom, right - 360.0, top)]
    return [(left, bottom, right, top)]
