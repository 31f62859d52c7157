"""CRS without a place on the Earth: a local Cartesian frame, and developed surfaces.

Each is a compound CRS of a plane engineering CRS and a vertical one, so that it splits into a map and its heights like
any other. Metres, right-handed.
"""

from __future__ import annotations

from functools import lru_cache

from pyproj import CRS

# What users write in place of a CRS for the local frame.
LOCAL = "local"
VERTICAL = 'VERTCRS["{name}",VDATUM["{datum}"],CS[vertical,1],AXIS["({z})",up,LENGTHUNIT["metre",1]]]'
_PLANE = (
    'ENGCRS["{name}",EDATUM["{datum}"],CS[Cartesian,2],'
    'AXIS["({x})",east,ORDER[1]],AXIS["({y})",north,ORDER[2]],LENGTHUNIT["metre",1]]'
)


@lru_cache(maxsize=1)
def local_frame_crs() -> CRS:
    """CRS of a local Cartesian frame: x, y, z in metres, wherever it stands."""
    return _joined("local frame", "origin of the local frame", "height in the local frame", ("X", "Y", "Z"))


def _joined(name: str, datum: str, above: str, axes: tuple[str, str, str]) -> CRS:
    """CRS of a plane and of heights above it."""
    x, y, z = axes
    plane, heights = _PLANE.format(name=name, datum=datum, x=x, y=y), VERTICAL.format(name=above, datum=datum, z=z)
    return CRS.from_wkt(f'COMPOUNDCRS["{name} + {above}",{plane},{heights}]')


@lru_cache(maxsize=2)
def image_frame_crs(unit: str) -> CRS:
    """CRS of the plane of an image without a CRS, two-dimensional.

    Parameters
    ----------
    unit : str
        Name of its unit: 'pixel', or 'unit' where a geotransform says of it no more than its place.
    """
    plane = _PLANE.format(name="frame of an image", datum="origin of the image", x="X", y="Y")
    return CRS.from_wkt(plane.replace('"metre"', f'"{unit}"'))


@lru_cache(maxsize=16)
def developed_crs(kind: str) -> CRS:
    """CRS of a developed surface: u, v on it and the offset h along its normal.

    Parameters
    ----------
    kind : str
        Of surface, such as 'cylinder'; part of the names.

    Returns
    -------
    CRS
        Compound, metres, not tied to the Earth.
    """
    return _joined(f"developed {kind}", f"developed {kind}", f"offset from the {kind}", ("U", "V", "H"))
