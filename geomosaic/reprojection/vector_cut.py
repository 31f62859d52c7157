"""Transformation of features to another CRS, cut where its map does not show them whole."""

from __future__ import annotations

from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.geo.crs import horizontal
from geomosaic.geo.projection_domain import Domain, domain
from geomosaic.geo.transform import Transform
from geomosaic.types import BoolArray, FloatArray

SLIVER = 1e-9
"""Degrees left out along a seam, which PROJ would count to the other side."""
CLOSE = 1.0
"""Degrees between the vertices of a feature that was cut: the rim of a map is curved."""


def moved(geometries: Any, own: CRS, crs: CRS) -> tuple[Any, BoolArray]:
    """Geometries in another CRS, cut where they reach over the edge of its map.

    Vertices are transformed and lines between them stay straight. A feature that crosses the seam of the new map (the
    meridian opposite to its centre), or reaches where the map has no end, is cut there and gets a vertex every degree.

    Parameters
    ----------
    geometries : array (N,) of shapely geometry or None
    own, crs : CRS
        Of the geometries, and of the new map; z stays as it is.

    Returns
    -------
    geometries : array (N,)
        Not finite, or empty, where a feature has no place in the new map.
    cut : bool array (N,)
        Which of them were cut.
    """
    import shapely

    straight = Transform(horizontal(own), horizontal(crs))
    geodetic = crs.geodetic_crs
    cut = np.zeros(len(geometries), dtype=bool)
    if geodetic is None or not (own.is_geographic or own.is_projected):
        return _over(geometries, straight), cut
    to_degrees = Transform(horizontal(own), horizontal(geodetic))
    whole, home = domain(crs), domain(own)
    degrees = shapely.transform(geometries, lambda xy: _plain(_unrolled(to_degrees(xy), own, home)))
    cut = ~_within(shapely.bounds(degrees), whole) & ~shapely.is_empty(degrees) & ~shapely.is_missing(degrees)
    out = _over(np.where(cut, None, geometries), straight)
    torn = np.zeros_like(cut) if whole.centre is not None else shapely.bounds(degrees)[:, 0] < SLIVER - 180.0
    if (cut | torn).any():
        to_map = Transform(horizontal(geodetic), horizontal(crs))
        for k in np.nonzero(cut | torn)[0]:
            here = _pieces(degrees[k], whole) if cut[k] else degrees[k]
            out[k] = shapely.transform(here, lambda xy, torn=torn[k]: _plain(to_map(_closed(xy) if torn else xy)))
    return _mended(geometries, out), cut


def _over(geometries: Any, transform: Transform) -> Any:
    """Transform x and y; z, where there is one, stays."""
    import shapely

    out = shapely.transform(geometries, lambda xy: _plain(transform(xy)))
    deep = shapely.has_z(geometries)
    if deep.any():
        out[deep] = shapely.transform(
            geometries[deep], lambda xyz: np.column_stack([_plain(transform(xyz[:, :2])), xyz[:, 2]]), include_z=True
        )
    return out


def _plain(xy: FloatArray) -> FloatArray:
    """Infinity where there is no place: rings of NaN would not count as closed."""
    xy[np.isnan(xy).any(axis=1)] = np.inf
    return xy


def _unrolled(lonlat: FloatArray, own: CRS, home: Domain) -> FloatArray:
    """Longitudes without a jump within the old map; those of a geographic CRS are as they are."""
    if own.is_projected and home.centre is not None:
        lonlat[:, 0] = home.centre + (lonlat[:, 0] - home.centre + 180.0) % 360.0 - 180.0
    return lonlat


def _closed(lonlat: FloatArray) -> FloatArray:
    """The date line once, where a map shows both its sides side by side: sines of ±180 degrees differ by a hair."""
    lonlat[np.abs(np.abs(lonlat[:, 0]) - 180.0) < SLIVER, 0] = 180.0
    return lonlat


def _within(bounds: FloatArray, whole: Domain) -> BoolArray:
    """Whether a map shows all of what has these bounds (left, bottom, right, top), degrees."""
    inside: BoolArray = (bounds[:, 1] >= whole.south) & (bounds[:, 3] <= whole.north)
    if whole.centre is None:
        return inside
    limit = whole.reach - SLIVER
    return inside & (bounds[:, 0] >= whole.centre - limit) & (bounds[:, 2] <= whole.centre + limit)


def _pieces(geometry: Any, whole: Domain) -> Any:
    """What lies within the map, each turn of the globe brought to the same one and joined again."""
    import shapely

    if not shapely.is_valid(geometry):
        geometry = shapely.make_valid(geometry)
    # Without a centre the map has no seam and shows all longitudes, as about a pole; 540 degrees hold three turns.
    middle, reach = (0.0, 540.0) if whole.centre is None else (whole.centre, whole.reach - SLIVER)
    found = []
    for turn in (0.0,) if whole.centre is None else (-360.0, 0.0, 360.0):
        box = shapely.box(middle - reach + turn, whole.south, middle + reach + turn, whole.north)
        piece = shapely.intersection(geometry, box)
        if not piece.is_empty:
            found.append(shapely.transform(piece, lambda xy, turn=turn: xy - (turn, 0.0)))
    joined = shapely.union_all(_alike(found, shapely.get_dimensions(geometry)))
    if joined.geom_type == "MultiLineString":
        joined = shapely.line_merge(joined)
    return shapely.segmentize(joined, CLOSE)


def _alike(pieces: list[Any], dimension: int) -> list[Any]:
    """Parts of a dimension: an area that only touches the edge leaves a line there."""
    import shapely

    parts = [part for piece in pieces for part in shapely.get_parts(shapely.get_parts(piece))]
    return [part for part in parts if shapely.get_dimensions(part) == dimension]


def _mended(before: Any, after: Any) -> Any:
    """Areas that touch themselves only in the new map, as along the meridian that leads to a pole, made simple."""
    import shapely

    areas = (shapely.get_dimensions(after) == 2) & ~shapely.is_valid(after)
    for k in np.nonzero(areas)[0]:
        if np.isfinite(shapely.get_coordinates(after[k])).all() and shapely.is_valid(before[k]):
            after[k] = shapely.union_all(_alike([shapely.make_valid(after[k])], 2))
    return after
