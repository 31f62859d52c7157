"""Positions of an orientation table against those that the photos themselves record (EXIF, XMP).

Zones of a projection such as UTM are congruent: a block with its control in the wrong one has the same scale, the same
convergence of meridians and the same residuals, and no adjustment can tell. What says where on the Earth a photo was
taken is its own receiver.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError, counted
from geomosaic.geo.crs import geographic, horizontal, is_local
from geomosaic.geo.transform import Transform
from geomosaic.inputs.declarations import Block
from geomosaic.inputs.images import Photo
from geomosaic.raster.image_metadata import read_photo_tags, recorded_position
from geomosaic.types import FloatArray

# Metres from which on positions contradict what photos record, and up to which those of another CRS agree with it.
FAR, NEAR = 20_000.0, 1000.0
# Photos whose tags are read.
ASKED = 6
EARTH_RADIUS = 6_371_000.0


def check_recorded_places(inputs: Block, photos: Sequence[Photo], crs: CRS | None) -> None:
    """Check that the positions of a table are where the photos record that they were taken.

    Parameters
    ----------
    inputs : Block
    photos : sequence of Photo
        Some of them, spread over the block, are looked at.
    crs : CRS, optional
        3-D CRS of the table.

    Raises
    ------
    InputError
        Most are many kilometres off; names the UTM zone with which they agree, where there is one.
    """
    if inputs.trusted or crs is None or is_local(crs) or crs.is_geocentric:
        return
    placed = [photo for photo in photos if photo.exterior is not None and photo.exterior.placed]
    given, recorded = [], []
    for photo in placed[:: -(-len(placed) // ASKED) or 1]:
        place = recorded_position(read_photo_tags(photo.path))
        # 0, 0 is what receivers write before they know.
        if place is not None and place[:2] != (0.0, 0.0) and photo.exterior is not None:
            given.append(photo.exterior.position[:2])
            recorded.append(place[:2])
    if not given:
        return
    table, true = np.array(given), np.array(recorded)
    off = _median_distance(table, horizontal(crs), true)
    if not off > FAR:
        return
    from geomosaic.render.extent import utm_zone

    zone = utm_zone(*np.median(true, axis=0).tolist())
    hint = "check `crs`, and the order of x and y"
    if _median_distance(table, zone, true) < NEAR:
        hint = f"in {zone.to_string()} they agree with the photos: give it as `crs`, of control points as well"
    raise InputError(
        f"the positions lie {off / 1000.0:.0f} km from where the photos record that they were taken, in the median of "
        f"{counted(len(given), 'photo')}",
        where="`crs`",
        hint=f"{hint}; if the positions are right as they are, say so: `trusted`",
    )


def _median_distance(table: FloatArray, crs: CRS, true: FloatArray) -> float:
    """Median distance in metres of positions (N, 2) in a CRS from longitudes and latitudes (N, 2); inf outside it."""
    found = Transform(crs, horizontal(geographic(crs)))(table)
    (lon, lat), (lon_true, lat_true) = np.radians(found).T, np.radians(true).T
    # The shorter way across the meridian of 180 degrees.
    east = (np.remainder(lon - lon_true + np.pi, 2.0 * np.pi) - np.pi) * np.cos(lat_true)
    distance = EARTH_RADIUS * np.hypot(east, lat - lat_true)
    return float(np.median(np.where(np.isfinite(distance), distance, np.inf)))
