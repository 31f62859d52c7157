"""Areas and lengths of map features on the ellipsoid of their CRS."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely
from pyproj import CRS, Geod

from geomosaic.geo.crs import geographic, is_local
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import linear_unit
from geomosaic.types import FloatArray

# Metres between places of an edge: a geodesic leaves a straight line of the map by less than a millimetre in between.
_STEP = 1000.0


def areas_and_lengths(geometries: Sequence[Any], crs: CRS) -> FloatArray:
    """Areas and lengths of features whose edges are straight on the map, by geodesics of their ellipsoid.

    Parameters
    ----------
    geometries : sequence of shapely geometry
    crs : CRS
        2-D; in a local frame both are of the plane.

    Returns
    -------
    array (N, 2)
        Square metres and metres, the latter of the outline of an area; 0 where a geometry has none, and NaN for the
        area of an outline that crosses itself.

    Notes
    -----
    Karney, Algorithms for geodesics, Journal of Geodesy 87 (2013), as in pyproj's `Geod`.
    """
    shapes = np.array(geometries, dtype=object)
    out = np.zeros((len(shapes), 2))
    if not len(shapes):
        return out
    unit = linear_unit(crs)
    if is_local(crs):
        out = np.column_stack([shapely.area(shapes) * unit**2, shapely.length(shapes) * unit])
    else:
        geod: Geod = crs.get_geod() or Geod(ellps="WGS84")
        dense = shapely.segmentize(shapely.force_2d(shapes), _STEP / unit)
        placed = shapely.transform(dense, Transform(crs, geographic(crs)))
        for index, one in enumerate(placed):
            if not np.isfinite(shapely.get_coordinates(one)).all():
                out[index] = np.nan
            elif shapes[index].area > 0.0:
                area, _ = geod.geometry_area_perimeter(shapely.orient_polygons(one))
                out[index] = abs(area), geod.geometry_length(one.boundary)
            elif shapes[index].length > 0.0:
                out[index] = 0.0, geod.geometry_length(one)
    out[~shapely.is_valid(shapes) & (shapely.area(shapes) != 0.0), 0] = np.nan
    return out
