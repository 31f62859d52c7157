"""Control points whose coordinates cannot be in the CRS that is named: refused before anything is computed."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from pyproj import CRS

from geomosaic.block.block import ControlPoint
from geomosaic.control.placement import misplaced
from geomosaic.errors import InputError
from geomosaic.geo.crs import horizontal
from geomosaic.project.planar.control_check import image_control

CERTAIN = ("degrees-in-metres", "metres-in-degrees", "latitude-longitude-swapped", "swapped-axes")
"""Slips that leave no doubt; a place beyond the area of use may be meant."""

_SHARED = "bring the points into the CRS of the positions (crs under [exterior]), which is theirs too"
_MENDS = {
    "degrees-in-metres": f"{_SHARED}; or, where both are in degrees, name that CRS, such as EPSG:4326",
    "metres-in-degrees": f"{_SHARED}; or, where both are in a projection, name that",
}


def refuse_misplaced(points: Sequence[ControlPoint], crs: CRS, path: Path) -> None:
    """Refuse coordinates in another unit than the CRS, or with exchanged axes.

    Raises
    ------
    InputError
        Says what they look like, and the mend.
    """
    once = list({point.id: point for point in points}.values())
    for advice in misplaced(image_control(once, horizontal(crs), str(path))):
        if advice.code in CERTAIN and len(advice.points) > len(once) / 2:
            raise InputError(advice.what, where=str(path), mend=_MENDS.get(advice.code, advice.mend))
