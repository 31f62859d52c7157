"""Domain of a map projection: the part of the Earth that it shows in one piece; longitudes near a meridian."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from pyproj import CRS

from geomosaic.geo.crs import horizontal, in_degrees, longitude_latitude_crs
from geomosaic.geo.grid import Bounds
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import axis_unit
from geomosaic.types import BoolArray, FloatArray

_CENTRE = (
    "Longitude of natural origin",
    "Longitude of false origin",
    "Longitude of origin",
    "Longitude of projection centre",
)
_AZIMUTHAL = ("Azimuthal", "Orthographic", "Gnomonic", "Oblique", "Perspective", "Stereographic", "Hotine")
# Degrees from the central meridian to which a transverse Mercator map is drawn; PROJ's series ends a little beyond.
FAR = 75.0
# Latitude at which web maps end; the poles are infinitely far.
MERCATOR = 85.06
# Latitude beyond the equator at which a conic or polar map ends: the other pole is infinitely far, or the rim.
OTHER_POLE = 60.0

# Map units: what reaches so far may go around a map of the globe, or over its end.
GREAT = 1e7
# Metres between a place and its copy beyond the rim of a map, at least.
APART = 1000.0


@dataclass(frozen=True)
class Domain:
    """Domain of a map projection, in degrees of the projection's own geographic CRS.

    Attributes
    ----------
    centre : float or None
        Longitude of the middle; None where there is no seam, as about a pole.
    reach : float
        Degrees of longitude shown on either side of it.
    south, north : float
        Latitudes shown.
    folds : bool
        Whether the map ends on a curve or in a wedge, beyond which its formulas give places that it shows already.
    """

    centre: float | None
    reach: float
    south: float
    north: float
    folds: bool = False

    @property
    def torn(self) -> bool:
        """Whether left and right show the same meridian, all along both sides: a cylindrical map."""
        return self.centre is not None and self.reach == 180.0 and not self.folds


def domain(crs: CRS) -> Domain:
    """Domain of a map projection: the part of the Earth that a map in this CRS shows in one piece.

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
    # A cone is made for the hemisphere of its standard parallels, wherever its coordinates begin.
    parallels = [float(v) for name, v in values.items() if "standard parallel" in name and name.startswith("Latitude")]
    begins = next((float(v) for name, v in values.items() if name.startswith("Latitude of ")), 0.0)
    latitude = sum(parallels) / len(parallels) if parallels else begins
    if "Polar" in method or abs(latitude) == 90.0:
        return Domain(None, 180.0, -OTHER_POLE, 90.0) if latitude > 0 else Domain(None, 180.0, -90.0, OTHER_POLE)
    if "Transverse Mercator" in method or "Gauss" in method:
        return Domain(centre, FAR, -90.0, 90.0)
    if any(word in method for word in _AZIMUTHAL):
        return Domain(None, 180.0, -90.0, 90.0, folds=True)
    if "Mercator" in method:
        return Domain(centre, 180.0, -MERCATOR, MERCATOR)
    if any(word in method for word in ("Conic", "Albers", "Bonne")):
        south, north = (-OTHER_POLE, 90.0) if latitude >= 0 else (-90.0, OTHER_POLE)
        return Domain(centre, 180.0, south, north, folds=True)
    return Domain(centre, 180.0, -90.0, 90.0, folds="Cylindrical" not in method)


@dataclass(frozen=True)
class DomainBoundary:
    """The curve or wedge in which a map of the globe ends, beyond which its formulas show places once more.

    Attributes
    ----------
    to_degrees, to_map : Transform
        Between the map and longitude and latitude on its own datum: one conversion both ways.
    apart : float
        Map units by which a place may miss itself on the way there and back; one beyond the rim misses by much more.
    """

    to_degrees: Transform
    to_map: Transform
    apart: float

    @classmethod
    def of(cls, crs: CRS) -> DomainBoundary:
        """Boundary of the domain of a projected CRS."""
        flat = horizontal(crs)
        there = Transform(flat, longitude_latitude_crs(flat))
        return cls(there, there.inverse(), APART / axis_unit(flat))

    def beyond(self, xy: FloatArray) -> BoolArray:
        """Which places (N, 2) of the map lie beyond its end."""
        with np.errstate(invalid="ignore"):
            within = np.abs(self.to_map(self.to_degrees(xy)) - xy).max(axis=1) < self.apart
        missed: BoolArray = ~within
        return missed


def limits(crs: CRS) -> Bounds:
    """Bounds of the part that a map in a projected CRS shows in one piece.

    Parameters
    ----------
    crs : CRS
        Projected; a vertical part is ignored.

    Returns
    -------
    left, bottom, right, top : float
        In `crs`; infinite where no place of the domain has map coordinates.
    """
    crs = horizontal(crs)
    shown = domain(crs)
    lon = (shown.centre or 0.0) + np.linspace(-1.0, 1.0, 145) * (shown.reach - 1e-9)  # both sides of the seam
    lat = np.linspace(shown.south, shown.north, 73)
    degrees = np.stack(np.meshgrid((lon + 180.0) % 360.0 - 180.0, lat), axis=-1).reshape(-1, 2)
    xy = Transform(longitude_latitude_crs(crs), crs)(degrees)
    xy = xy[np.isfinite(xy).all(axis=1)]
    if not len(xy):
        return -np.inf, -np.inf, np.inf, np.inf
    (left, bottom), (right, top) = xy.min(axis=0).tolist(), xy.max(axis=0).tolist()
    return left, bottom, right, top


def whole_turn(crs: CRS) -> float | None:
    """Whole turn of longitude in units of a geographic CRS (360 degrees, 400 grads).

    Parameters
    ----------
    crs : CRS

    Returns
    -------
    float or None
        None where x is no longitude.
    """
    return 2 * math.pi / axis_unit(crs) if in_degrees(crs) else None


def near(xy: FloatArray, middle: float, turn: float | None) -> FloatArray:
    """Longitudes brought within half a turn of a middle; those that are stay as they are, to the last bit.

    Parameters
    ----------
    xy : array (N, 2)
        Map coordinates; NaN stays NaN.
    middle : float
        Longitude in the same units.
    turn : float or None
        See `whole_turn`; where it is None, x is no longitude and nothing changes.

    Returns
    -------
    array (N, 2)
    """
    if turn is None:
        return xy
    with np.errstate(invalid="ignore"):
        turns = np.rint((xy[:, 0] - middle) / turn)
        away = np.abs(xy[:, 0] - middle) > turn / 2
    return xy - np.column_stack([turn * turns, np.zeros(len(xy))]) if away.any() else xy


# West, south, east, north in degrees.
Area = tuple[float, float, float, float]


def area_of_use(crs: CRS) -> Area | None:
    """Area of use of a CRS; a PROJ string is looked up among the known CRS.

    Parameters
    ----------
    crs : CRS

    Returns
    -------
    (west, south, east, north) or None
        Degrees; west is greater than east where the area crosses the 180th meridian. None where none is known.
    """
    area = crs.area_of_use
    if area is None and (code := crs.to_epsg()) is not None:
        area = CRS.from_epsg(code).area_of_use
    return None if area is None else (area.west, area.south, area.east, area.north)


def longitude_latitude(xy: FloatArray, crs: CRS) -> FloatArray:
    """Longitude and latitude of map places, on the CRS's own datum.

    Parameters
    ----------
    xy : array (N, 2)
        In `crs`.
    crs : CRS
        Projected or geographic.

    Returns
    -------
    array (N, 2)
        Degrees; NaN where the projection has no such place.
    """
    flat = horizontal(crs)
    degrees = Transform(flat, longitude_latitude_crs(flat))(xy)
    # Some inverse projections give numbers for places off the map.
    degrees[np.abs(degrees[:, 1]) > 90.0] = np.nan
    degrees[np.abs(degrees[:, 0]) > 360.0] = np.nan
    return degrees


def beyond(degrees: FloatArray, area: Area) -> FloatArray:
    """Degrees of longitude and latitude by which places miss an area.

    Parameters
    ----------
    degrees : array (N, 2)
        Longitude and latitude.
    area : (west, south, east, north)
        Degrees; it may cross the 180th meridian.

    Returns
    -------
    array (N, 2)
        0 inside, NaN where there is no place.
    """
    west, south, east, north = area
    middle, half = (west + (east - west) % 360.0 / 2, (east - west) % 360.0 / 2) if east != west + 360 else (0.0, 180.0)
    off = np.abs((degrees[:, 0] - middle + 180.0) % 360.0 - 180.0) - half
    return np.maximum(np.column_stack([off, np.abs(degrees[:, 1] - (south + north) / 2) - (north - south) / 2]), 0.0)
