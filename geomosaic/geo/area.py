"""Where on the earth a CRS is meant to be used."""

from __future__ import annotations

import numpy as np
from pyproj import CRS

from geomosaic.geo.crs import horizontal, longitude_latitude_crs
from geomosaic.geo.transform import Transform
from geomosaic.types import FloatArray

Area = tuple[float, float, float, float]
"""West, south, east, north in degrees."""


def area_of_use(crs: CRS) -> Area | None:
    """Return west, south, east, north in degrees; a PROJ string is looked up among the known CRS."""
    area = crs.area_of_use
    if area is None and (code := crs.to_epsg()) is not None:
        area = CRS.from_epsg(code).area_of_use
    return None if area is None else (area.west, area.south, area.east, area.north)


def longitude_latitude(xy: FloatArray, crs: CRS) -> FloatArray:
    """Return degrees (N, 2) on the CRS's own datum; NaN where the projection has no such place."""
    flat = horizontal(crs)
    degrees = Transform(flat, longitude_latitude_crs(flat))(xy)
    degrees[np.abs(degrees[:, 1]) > 90.0] = np.nan
    degrees[np.abs(degrees[:, 0]) > 360.0] = np.nan
    return degrees


def beyond(degrees: FloatArray, area: Area) -> FloatArray:
    """Return by how many degrees places (N, 2) miss an area, in longitude and latitude; 0 inside, NaN nowhere."""
    west, south, east, north = area
    middle, half = (west + (east - west) % 360.0 / 2, (east - west) % 360.0 / 2) if east != west + 360 else (0.0, 180.0)
    off = np.abs((degrees[:, 0] - middle + 180.0) % 360.0 - 180.0) - half
    return np.maximum(np.column_stack([off, np.abs(degrees[:, 1] - (south + north) / 2) - (north - south) / 2]), 0.0)
