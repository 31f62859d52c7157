"""The part of the Earth that a map projection shows in one piece."""

from __future__ import annotations

from dataclasses import dataclass

from pyproj import CRS

_CENTRE = (
    "Longitude of natural origin",
    "Longitude of false origin",
    "Longitude of origin",
    "Longitude of projection centre",
)
_AZIMUTHAL = ("Azimuthal", "Orthographic", "Gnomonic", "Oblique", "Perspective", "Stereographic", "Hotine")
FAR = 75.0
"""Degrees from the central meridian to which a transverse Mercator map is drawn; PROJ's series ends a little beyond."""
MERCATOR = 85.06
"""Latitude at which web maps end; the poles are infinitely far."""
OTHER_POLE = 60.0
"""Latitude beyond the equator at which a conic or polar map ends: the other pole is infinitely far, or the rim."""


@dataclass(frozen=True)
class Domain:
    """Degrees, in the projection's own geographic CRS.

    Attributes
    ----------
    centre : float or None
        Longitude of the middle; None where there is no seam, as about a pole.
    reach : float
        Degrees of longitude shown on either side of it.
    south, north : float
        Latitudes shown.
    """

    centre: float | None
    reach: float
    south: float
    north: float


def domain(crs: CRS) -> Domain:
    """Where a map in this CRS is whole.

    Cylindrical, pseudo-cylindrical and conic maps are torn along the meridian opposite to their central one. Where a
    pole is infinitely far, the map ends before it.

    Parameters
    ----------
    crs : CRS
        Geographic or projected.
    """
    operation = crs.coordinate_operation
    if crs.is_geographic or operation is None:
        return Domain(0.0, 180.0, -90.0, 90.0)
    values = {p.name: p.value for p in operation.params}
    method = operation.method_name
    # Longitudes of a map count from its own prime meridian, in the units of its geographic CRS.
    centre = next((float(values[name]) for name in _CENTRE if name in values), 0.0)
    latitude = next((float(v) for name, v in values.items() if name.startswith("Latitude of ")), 0.0)
    if "Polar" in method or abs(latitude) == 90.0:
        return Domain(None, 180.0, -OTHER_POLE, 90.0) if latitude > 0 else Domain(None, 180.0, -90.0, OTHER_POLE)
    if "Transverse Mercator" in method or "Gauss" in method:
        return Domain(centre, FAR, -90.0, 90.0)
    if any(word in method for word in _AZIMUTHAL):
        return Domain(None, 180.0, -90.0, 90.0)
    if "Mercator" in method:
        return Domain(centre, 180.0, -MERCATOR, MERCATOR)
    if any(word in method for word in ("Conic", "Albers", "Bonne")):
        return Domain(centre, 180.0, -OTHER_POLE, 90.0) if latitude >= 0 else Domain(centre, 180.0, -90.0, OTHER_POLE)
    return Domain(centre, 180.0, -90.0, 90.0)
