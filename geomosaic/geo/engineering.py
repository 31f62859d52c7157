"""Coordinate systems of a thing, tied to no Earth: the local frame of a survey, the developed surface of a tower.

Both are written as a compound CRS of a plane engineering CRS and a vertical one, so that they split into a map and its
heights like any other. Metres, right-handed.
"""

from __future__ import annotations

from functools import lru_cache

from pyproj import CRS

from geomosaic.geo.crs import horizontal

_PLANE = (
    'ENGCRS["{name}",EDATUM["{datum}"],CS[Cartesian,2],'
    'AXIS["({x})",east,ORDER[1]],AXIS["({y})",north,ORDER[2]],LENGTHUNIT["metre",1]]'
)
_ABOVE = 'VERTCRS["{name}",VDATUM["{datum}"],CS[vertical,1],AXIS["({z})",up,LENGTHUNIT["metre",1]]]'


@lru_cache(maxsize=16)
def local_frame_crs() -> CRS:
    """x, y, z of a local Cartesian frame in metres, wherever it stands."""
    return _joined("local frame", "origin of the local frame", "height in the local frame", ("X", "Y", "Z"))


@lru_cache(maxsize=16)
def developed_crs(kind: str) -> CRS:
    """Developed coordinates u, v of a kind of surface in metres, and the offset h along its normal."""
    return _joined(f"developed {kind}", f"developed {kind}", f"offset from the {kind}", ("U", "V", "H"))


def _joined(name: str, datum: str, above: str, axes: tuple[str, str, str]) -> CRS:
    x, y, z = axes
    plane, heights = _PLANE.format(name=name, datum=datum, x=x, y=y), _ABOVE.format(name=above, datum=datum, z=z)
    return CRS.from_wkt(f'COMPOUNDCRS["{name} + {above}",{plane},{heights}]')


def is_free(crs: CRS) -> bool:
    """Whether a CRS is tied to no Earth: its axes mean nothing but themselves, and none is the plumb line."""
    return bool(horizontal(crs).is_engineering)
