"""View geometry: direction and scale in which an image sees a place, for every model, by differences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.sensor.map_to_image import MapToImage
from geomosaic.types import FloatArray


@dataclass(frozen=True)
class Views:
    """View geometry at places on the ground.

    Attributes
    ----------
    angle : array (N,)
        Between the line of sight and the vertical, in degrees; NaN where the model does not see the place.
    azimuth : array (N,)
        From the place towards the sensor, in degrees from the map's north, clockwise; any where the angle is 0.
    sampling : array (N,)
        Ground sampling distance in metres, of level ground.
    """

    angle: FloatArray
    azimuth: FloatArray
    sampling: FloatArray


def views(mapper: MapToImage, xy: FloatArray, z: FloatArray, metres: FloatArray, step: float) -> Views:
    """Directions and scale in which an image sees places.

    The image position does not change along the line of sight, so its direction v solves J · v = 0 with the derivatives
    J (2, 3) of (col, row) after (x, y, z): v is the cross product of J's rows. Models without heights look down.

    Parameters
    ----------
    mapper : MapToImage
    xy : array (N, 2)
        Places in the output map.
    z : array (N,)
        Heights of the surface there, in metres.
    metres : array (2,)
        Metres per unit of the output map's x and y.
    step : float
        For the differences, in metres; about an image pixel on the ground or larger.
    """
    jacobian = np.zeros((len(xy), 2, 3))
    for axis in range(3 if mapper.uses_heights else 2):
        move = np.zeros(3)
        move[axis] = step
        ahead, behind = (
            mapper(xy + sign * move[:2] / metres, z + sign * move[2]) if len(xy) else np.zeros((0, 2))
            for sign in (1.0, -1.0)
        )
        jacobian[:, :, axis] = (ahead - behind) / (2 * step)
    sight = np.cross(jacobian[:, 0], jacobian[:, 1])
    sight *= np.where(sight[:, 2:] < 0, -1.0, 1.0)  # upwards
    with np.errstate(divide="ignore"):
        sampling = 1 / np.sqrt(np.abs(sight[:, 2]))
    angle = np.degrees(np.arctan2(np.hypot(sight[:, 0], sight[:, 1]), sight[:, 2]))
    azimuth = np.degrees(np.arctan2(sight[:, 0], sight[:, 1])) % 360
    unseen = ~np.isfinite(sight).all(axis=1) | (np.abs(sight).max(axis=1, initial=0) == 0)
    return Views(*(np.where(unseen, np.nan, value) for value in (angle, azimuth, sampling)))
