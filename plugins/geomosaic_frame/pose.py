"""Pose in the coordinates of another program, and what these are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pyproj import CRS
from pyproj.exceptions import CRSError

from geomosaic.errors import InputError
from geomosaic.geo.crs import geocentric
from geomosaic.sensor.inputs import need, numbers
from geomosaic.types import FloatArray

WORLDS = ("map", "geocentric", "local")
"""What the world of another program may be: axes of the map, of the Earth, or east, north, up at a reference."""


def read_pose(row: Mapping[str, Any], where: str) -> tuple[FloatArray, FloatArray, str, CRS | None]:
    """Read a pose.

    Parameters
    ----------
    row : mapping
        `rotation`, world → camera (x right, y down, z forward), row by row; `position`; `world`.
    where : str
        Named in errors.

    Returns
    -------
    rotation : array (3, 3)
        The nearest rotation to the one that is given, which must be one to 1e-5.
    position : array (3,)
    frame : str
        'map', 'geocentric' or 'topocentric'.
    crs : CRS or None
        Geocentric, where the file names it.
    """
    text = "rotation matrix world → camera, row by row"
    rotation = np.array(numbers(need(row, "rotation", where, text), 9, "rotation", where)).reshape(3, 3)
    worst = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if worst > 1e-5 or np.linalg.det(rotation) < 0.0:
        raise InputError(f"rotation is no rotation: rows are off orthonormal by {worst:.1e}", where=where)
    left, _, right = np.linalg.svd(rotation)
    position = np.array(numbers(need(row, "position", where, "projection centre"), 3, "position", where))
    frame, crs = _world(str(need(row, "world", where, f"what the world is, one of {', '.join(WORLDS)}")), where)
    return left @ right, position, frame, crs


def _world(world: str, where: str) -> tuple[str, CRS | None]:
    """Frame of a world: one of `WORLDS`, or the WKT of a CRS in whose geocentric coordinates the file counts."""
    if world in WORLDS:
        return ("topocentric" if world == "local" else world), None
    if not world or world.lstrip().upper().startswith(("LOCAL_CS", "ENGCRS", "ENGINEERINGCRS")):
        raise InputError(
            "the file counts in local coordinates and does not say where these are",
            where=where,
            hint="say it: world = 'map' (they are those of the CRS that is named), 'geocentric', or 'local' with "
            "reference = [longitude, latitude, altitude]",
        )
    try:
        return "geocentric", geocentric(CRS.from_wkt(world))
    except (CRSError, InputError) as error:
        raise InputError(
            f"what the world is cannot be understood: '{world[:60]}'",
            where=where,
            hint=f"say it: world = {', '.join(WORLDS)}",
        ) from error
