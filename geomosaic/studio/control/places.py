"""Places of one point: in the image, on the ground, and on a georeferenced layer."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import geographic, has_heights, horizontal
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import metres_per_unit
from geomosaic.georeferencing.live_control import LiveControl
from geomosaic.raster.info import inspect
from geomosaic.surface.model import Surface
from geomosaic.types import FloatArray


def map_frame(path: Path | None) -> tuple[CRS, FloatArray]:
    """Map CRS and pixel → map matrix (2, 3) of a layer.

    Parameters
    ----------
    path : Path or None
        Raster of the layer; None where the page named none that exists.

    Raises
    ------
    InputError
        There is no such layer, or it is not georeferenced.
    """
    if path is None:
        raise InputError("there is no such layer", hint="choose one of the list")
    info = inspect(path)
    if info.crs is None or info.transform is None:
        raise InputError(f"{path.name} is not georeferenced", hint="choose an ortho, a mosaic or a map")
    return horizontal(info.crs), np.array(list(info.transform)[:6]).reshape(2, 3)


def ground_under(xy: FloatArray, crs: CRS, target: CRS, surface: Surface | None) -> FloatArray:
    """Ground points (N, 3) in a CRS under map places (N, 2), with heights of the surface where the CRS has any.

    Parameters
    ----------
    xy : array (N, 2)
        Map places.
    crs : CRS
        Of the map.
    target : CRS
        Of the result.
    surface : Surface or None

    Raises
    ------
    InputError
        The target has heights, and there is no surface.
    """
    found = np.zeros((len(xy), 3))
    if not has_heights(target):
        found[:, :2] = Transform(crs, horizontal(target))(xy)
        return found
    if surface is None:
        raise InputError("the ground has no heights here", hint="give the project a DEM or a height")
    found[:, :2] = Transform(crs, horizontal(surface.crs))(xy)
    found[:, 2] = surface.height(found[:, :2])
    return Transform(surface.crs, target)(found)


def map_places(xyz: FloatArray, source: CRS, crs: CRS) -> FloatArray:
    """Map places (N, 2) of ground points (N, 2) or (N, 3).

    Parameters
    ----------
    xyz : array (N, 2) or (N, 3)
    source, crs : CRS
        Of the points and of the map.
    """
    if source.is_geocentric:
        level = geographic(source)
        xyz, source = Transform(source, level)(xyz), level
    return Transform(horizontal(source), crs)(xyz[:, :2])


def points_on_map(live: LiveControl, crs: CRS) -> tuple[FloatArray, FloatArray]:
    """Map places (N, 2) of the control points, and of where they were measured in the image, by the residuals.

    Parameters
    ----------
    live : LiveControl
    crs : CRS
        Of the map.

    Returns
    -------
    places : array (N, 2)
    measured : array (N, 2)
        NaN without a solution.
    """
    control = live.control
    places = map_places(control.ground, control.crs, crs)
    if live.solution is None:
        return places, np.full(places.shape, np.nan)
    steps = live.solution.map_residuals
    if not control.crs.is_geocentric:
        return places, map_places(control.xy + steps, horizontal(control.crs), crs)
    # Metres east and north; what the map's own scale and convergence do to them is not seen.
    return places, places + steps / metres_per_unit(crs, places)
