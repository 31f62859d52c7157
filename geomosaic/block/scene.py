"""One image with its sensor model."""

from __future__ import annotations

from dataclasses import dataclass

from geomosaic.sensor.model import SensorModel


@dataclass(frozen=True, eq=False)
class Scene:
    """An image file and the model that says where its pixels lie.

    Attributes
    ----------
    name : str
        Unique in its block.
    path : str
        The image file.
    sensor : str
        Name of the sensor plugin the model comes from.
    model : SensorModel
    nodata : float, optional
        Value of missing pixels, in place of what the file says.
    bands : tuple of int, optional
        Bands to use, counted from 1, in this order; all but alpha unless given.
    usable : tuple of (col, row), optional
        Corners of the part of the image that may be used, in order: no fiducial marks, no border of the film.
    """

    name: str
    path: str
    sensor: str
    model: SensorModel
    nodata: float | None = None
    bands: tuple[int, ...] | None = None
    usable: tuple[tuple[float, float], ...] | None = None
