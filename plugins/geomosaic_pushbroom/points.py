"""Control points of one image: read, brought to one CRS, and reported in the model's notes."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.sensor.inputs import known_keys, number, positive
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.types import FloatArray

POINT = ("x", "y", "z", "col", "row")


@dataclass(frozen=True)
class ImageControl:
    """Control points of one image.

    Attributes
    ----------
    names : tuple of str
    xyz : array (N, 3)
        In the CRS of the request.
    colrow : array (N, 2)
        Pixels.
    sigmas : array (N,)
        Pixels.
    """

    names: tuple[str, ...]
    xyz: FloatArray
    colrow: FloatArray
    sigmas: FloatArray

    def __len__(self) -> int:
        return len(self.names)


def read_points(points: Any, where: str) -> ImageControl:
    """Control points of the inputs.

    Parameters
    ----------
    points : object
        List of tables with x, y, z, col, row and, optionally, id and sigma (pixels, 1 unless given).
    where : str
        Named in errors.

    Raises
    ------
    InputError
        It is no list of points, or a point lacks a coordinate or has one that is no number.
    """
    if not isinstance(points, Iterable) or isinstance(points, str | Mapping) or not list(points):
        raise InputError("'points' is not a list of control points", where=where, hint=f"each with {', '.join(POINT)}")
    names, rows = [], []
    for index, point in enumerate(points, 1):
        if not isinstance(point, Mapping):
            raise InputError(f"control point {index} is not a table", where=where, hint=f"give {', '.join(POINT)}")
        known_keys(point, (*POINT, "id", "sigma"), f"{where}, control point {index}")
        name = str(point.get("id", index))
        missing = [key for key in POINT if point.get(key) is None]
        if missing:
            raise InputError(
                f"control point {name} has no {', '.join(missing)}", where=where, hint=f"give {', '.join(POINT)}"
            )
        label = f"control point {name}, "
        row = [number(point[key], label + key, where) for key in POINT]
        rows.append([*row, positive(point.get("sigma", 1.0), f"{label}sigma", where)])
        names.append(name)
    table = np.array(rows)
    return ImageControl(tuple(names), table[:, :3], table[:, 3:5], table[:, 5])


def need_crs(request: SensorRequest) -> CRS:
    """CRS of the control points and the track.

    Parameters
    ----------
    request : SensorRequest

    Raises
    ------
    InputError
        There is none.
    """
    if request.crs is None:
        raise InputError(
            "positions and control points have no CRS",
            where=request.image,
            hint="name one with a vertical datum, for example EPSG:32633 with heights = 'egm96'",
        )
    return request.crs
