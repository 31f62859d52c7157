"""Image to ground for every sensor model, on a height or a surface, by damped Newton for many points at once."""

from __future__ import annotations

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import has_heights, horizontal
from geomosaic.geo.transform import Transform
from geomosaic.sensor.model import HasRays, SensorModel
from geomosaic.sensor.solve.line_of_sight import SightLines, first_meeting
from geomosaic.surface.model import Surface
from geomosaic.surface.ray_intersection import intersect
from geomosaic.types import FloatArray


def image_to_height(model: SensorModel, colrow: FloatArray, heights: FloatArray | float, crs: CRS) -> FloatArray:
    """Ground points at given heights.

    Parameters
    ----------
    model : SensorModel
    colrow : array (N, 2)
        Pixels.
    heights : float or array (N,)
        In the height unit and datum of `crs`.
    crs : CRS
        3-D map CRS of the heights and of the result; a 2-D one will do for models without heights.

    Returns
    -------
    array (N, 3)
        x, y, height in `crs`; x and y are NaN where the line of sight does not reach the height.
    """
    image = _as_image(colrow)
    levels = np.broadcast_to(np.asarray(heights, dtype=np.float64), (len(image),)).copy()
    lines = SightLines.of(model, image, crs)
    ground = np.column_stack([lines.at(levels), levels])
    ground[~lines.exact(ground), :2] = np.nan
    return ground


def image_to_ground(model: SensorModel, colrow: FloatArray, surface: Surface | None = None) -> FloatArray:
    """Ground points where lines of sight first meet a surface.

    Parameters
    ----------
    model : SensorModel
    colrow : array (N, 2)
        Pixels.
    surface : Surface, optional
        May be left out for a model without heights: the result is then in `model.crs`, with z = 0.

    Returns
    -------
    array (N, 3)
        x, y, z in `surface.crs`; NaN where a line of sight meets no known height. `ground_to_image` of the result
        gives `colrow` back within 1e-6 pixel.

    Raises
    ------
    InputError
        The model needs heights and there is no surface.
    HeightDatumError
        The heights of the surface have no vertical datum.
    """
    image = _as_image(colrow)
    if has_heights(model.crs):
        if surface is None:
            raise InputError("the lines of sight of this sensor need a surface", hint="give a DEM or a height")
        # Rays in closed form need no iteration for the line itself.
        if isinstance(model, HasRays):
            return Transform(model.crs, surface.crs)(intersect(surface, model.crs, *model.rays(image)))
        lines = SightLines.of(model, image, surface.crs)
        ground = first_meeting(lines, surface)
        ground[~lines.exact(ground)] = np.nan
        return ground
    if surface is None:
        return image_to_height(model, image, 0.0, model.crs)
    # Heights play no part in this model: the place is found first, and the surface gives its height.
    ground = image_to_height(model, image, 0.0, horizontal(surface.crs))
    seen = np.isfinite(ground[:, :2]).all(axis=1)
    ground[seen, 2] = surface.height(ground[seen, :2])
    ground[~np.isfinite(ground).all(axis=1)] = np.nan
    return ground


def _as_image(colrow: FloatArray) -> FloatArray:
    image = np.asarray(colrow, dtype=np.float64)
    if image.ndim != 2 or image.shape[1] != 2:
        raise ValueError(f"image coordinates have shape {image.shape}, expected (N, 2)")
    return image
