"""Whether a raster lies where its file says: what is missing, and coordinates that do not fit their CRS."""

from __future__ import annotations

import warnings

import numpy as np
from pyproj import CRS

from geomosaic.errors import GeomosaicWarning, InputError
from geomosaic.geo.crs import horizontal
from geomosaic.geo.grid import Grid
from geomosaic.geo.turn import whole_turn
from geomosaic.raster.info import SourceInfo, control_point_count

TINY = 0.01
"""Metres: coordinates that could be degrees, in pixels smaller than that, are degrees."""
HAIR = 0.01
"""Share of a quarter turn that the edge of a pixel may reach beyond a pole."""


def check_placed(info: SourceInfo, given: CRS | None = None) -> CRS:
    """CRS of a raster: `given`, or what the file says.

    Raises
    ------
    InputError
        The raster has no place, names no CRS, or its coordinates cannot be of that CRS.
    """
    if info.transform is None:
        points = control_point_count(info.path)
        raise InputError(
            f"the raster has no geotransform{f', but {points} control points' if points else ' and no world file'}",
            where=info.path,
            mend="place it by control points first: geomosaic georeference",
        )
    crs = given or info.crs
    grid = Grid(CRS("EPSG:4326"), info.transform, info.width, info.height)
    left, bottom, right, top = grid.bounds
    place = f"x {left:.8g} to {right:.8g}, y {bottom:.8g} to {top:.8g}"
    small = max(abs(left), abs(right)) <= 360.0 and max(abs(bottom), abs(top)) <= 90.0
    if crs is None:
        kind = "could be degrees" if small else "are no degrees, so they are of a map"
        raise InputError(
            "the raster names no CRS", where=info.path,
            mend=f"give --src-crs; its coordinates ({place}) {kind}",
        )  # fmt: skip
    crs = horizontal(crs)
    turn = whole_turn(crs)
    if turn is not None and max(abs(bottom), abs(top)) > turn / 4 * (1 + HAIR):
        raise InputError(
            f"the coordinates ({place}) are no longitudes and latitudes, as the CRS '{crs.name}' has them",
            where=info.path,
            mend="give the CRS of the map that they belong to as --src-crs, or exchange x and y",
        )
    if crs.is_projected and small and float(np.max(grid.resolution)) < TINY:
        warnings.warn(
            f"{info.path}: the coordinates ({place}) look like degrees, and the CRS '{crs.name}' counts in "
            f"{crs.axis_info[0].unit_name}; if they are degrees, give --src-crs EPSG:4326",
            GeomosaicWarning,
            stacklevel=2,
        )
    return crs
