"""Camera positions from which a photo cannot show the land of a reference: those of another country."""

from __future__ import annotations

import numpy as np
from pyproj import CRS, Geod

from geomosaic.block_adjustment.start import StartBlock
from geomosaic.errors import InputError
from geomosaic.geo.crs import is_local, with_heights
from geomosaic.geo.grid import Grid
from geomosaic.geo.transform import Transform
from geomosaic.sensor.plugin import HasPose
from geomosaic.types import FloatArray

GEOCENTRIC, GEOGRAPHIC = CRS.from_epsg(4978), CRS.from_epsg(4979)
# Metres from the land of a reference, and heights of the camera, beyond which a photo shows none of it.
DISTANT, HEIGHTS = 10_000.0, 5.0


def distances_beyond(start: StartBlock, grid: Grid, search: float) -> FloatArray:
    """Distances (M,) of camera positions from the land of a reference, metres; NaN where a photo may show some of it.

    NaN also of what has no position, or is no photo. Distances are geodesics, as no map reaches from any country to any
    other.

    Parameters
    ----------
    start : StartBlock
    grid : Grid
        Of the reference.
    search : float
        Metres that positions may be wrong.
    """
    away = np.full(len(start.scenes), np.nan)
    if is_local(grid.crs) or is_local(start.ground):
        return away
    left, bottom, right, top = grid.bounds
    corners = np.array([(x, y, 0.0) for x in (left, right) for y in (bottom, top)])
    land = Transform(with_heights(grid.crs, "ellipsoidal"), GEOCENTRIC)(corners)
    middle = land.mean(axis=0)
    radius = float(np.linalg.norm(land - middle, axis=1).max())
    to_geographic = Transform(GEOCENTRIC, GEOGRAPHIC)
    here = to_geographic(middle[None])[0]
    for number in np.flatnonzero(start.placed).tolist():
        model = start.models[number]
        if not isinstance(model, HasPose):
            continue
        place = to_geographic(Transform(model.crs, GEOCENTRIC)(np.array([model.pose[0]], dtype=np.float64)))[0]
        if not np.isfinite(place).all():
            continue
        off = Geod(ellps="WGS84").inv(here[0], here[1], place[0], place[1])[2] - radius
        if off > max(DISTANT + search, HEIGHTS * float(place[2])):
            away[number] = off
    return away


def too_distant(away: FloatArray, reference: str) -> InputError:
    """Error of photos whose positions lie far from the land of a reference.

    Parameters
    ----------
    away : array (M,)
        Their distances, metres.
    reference : str
        Its file.
    """
    near, far = round(float(away.min()) / 1e3), round(float(away.max()) / 1e3)
    size = f"{near} km" if near == far else f"{near} to {far} km"
    whose = "its position lies" if len(away) == 1 else f"the positions of all {len(away)} images lie"
    return InputError(
        f"{whose} {size} from the land that the reference shows",
        where=reference,
        hint="give a reference of the land where the images were taken; where the positions or their CRS are wrong, "
        "correct them, or leave them empty: images without a position are looked for in all of the reference",
    )
