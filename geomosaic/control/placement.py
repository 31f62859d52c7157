"""Whether ground coordinates fit their CRS, and what they look like when they do not."""

from __future__ import annotations

import numpy as np
from pyproj import CRS

from geomosaic.control.finding import Advice, listed, named
from geomosaic.control.handed import swapped
from geomosaic.control.points import ImageControl
from geomosaic.geo.area import Area, area_of_use, beyond, longitude_latitude
from geomosaic.geo.crs import horizontal
from geomosaic.types import BoolArray, FloatArray

MARGIN = 1.0
"""Degrees beyond the area of use that still count as inside."""
ZONE = 12.0
"""Degrees beyond it, in longitude, that look like a neighbouring zone."""
FOOT = 0.3048
SMALLEST = 1e-4
"""Units of a projection; no photo has pixels as small on the ground."""


def _inside(xy: FloatArray, crs: CRS, area: Area) -> BoolArray:
    return np.asarray((beyond(longitude_latitude(xy, crs), area) <= MARGIN).all(axis=1))


def misplaced(control: ImageControl, near: tuple[float, float] | None = None, within: float = 1.0) -> list[Advice]:
    """Find ground coordinates that do not fit their CRS.

    Parameters
    ----------
    control : ImageControl
    near : tuple of float, optional
        Longitude and latitude in degrees of a place near the image (EXIF, a DEM, the map). Coordinates of one zone are
        valid in every other: only this tells them apart.
    within : float
        Degrees that the points may lie from it.

    Returns
    -------
    list of Advice
        At most one. Nothing for a CRS that is not tied to the Earth.
    """
    crs, xy = control.crs, control.xy
    if crs.is_geocentric or horizontal(crs).geodetic_crs is None or not len(control):
        return []
    area = area_of_use(crs)
    if near is not None:
        area = (near[0] - within, near[1] - within, near[0] + within, near[1] + within)
    if _tiny(control):
        what = f"the points ({xy[0, 0]:.10g}, {xy[0, 1]:.10g}, ...) look like degrees, and '{crs.name}' is metric"
        mend = "give the control's CRS as a geographic one, such as EPSG:4326"
        return [Advice("degrees-in-metres", "error", what, control.names, mend)]
    if area is None:
        return []
    out = ~_inside(xy, crs, area)
    if not out.any():
        return []
    names = named(control, out)
    reach = f"near {near[0]:g}, {near[1]:g}" if near else f"in the area of use of '{crs.name}'"
    if out.mean() <= 0.5:
        what = f"{len(names)} of {len(control)} points do{'es' * (len(names) == 1)} not lie {reach}: {listed(names)}"
        return [Advice("outside-crs-area", "error", what, names, "look for a digit lost or exchanged in them")]
    code, looks, mend = _cause(control, area, near)
    at = f"{xy[0, 0]:.10g}, {xy[0, 1]:.10g}"
    return [Advice(code, "error", f"the points ({at}, ...) do not lie {reach}: {looks}", names, mend)]


def has_places(control: ImageControl) -> bool:
    """Whether all points may lie somewhere on the Earth: no latitude is beyond a pole."""
    return not (control.crs.is_geographic and bool((np.abs(control.xy[:, 1]) > 90.0).any()))


def _tiny(control: ImageControl) -> bool:
    """Say whether numbers are small enough for degrees, and pixels too small for metres."""
    xy = np.abs(control.xy)
    small = (xy <= [180.0, 90.0]).all() or (xy <= [90.0, 180.0]).all()
    pixel = np.ptp(control.xy, axis=0).max() / max(float(np.ptp(control.colrow, axis=0).max()), 1.0)
    return bool(control.crs.is_projected and small and pixel < SMALLEST)


def _cause(control: ImageControl, area: Area, near: tuple[float, float] | None) -> tuple[str, str, str]:
    crs, xy = control.crs, control.xy
    if _inside(xy[:, ::-1], crs, area).mean() > 0.9:
        code, mend = swapped(control)
        return code, "they do with the axes exchanged", mend
    if crs.is_geographic and (np.abs(xy) > 400.0).any(axis=1).mean() > 0.5:
        return "metres-in-degrees", "they look like metres of a projection", "give the projected CRS they are in"
    if near is not None and (zone := _zone(control, area)):
        return "wrong-zone", f"they do in {zone}", f"give {zone} as the CRS of the control"
    miss = beyond(longitude_latitude(xy, crs), area)
    side = not np.isnan(miss).any() and bool((np.median(miss, axis=0) <= [ZONE, MARGIN]).all())
    metre = abs(crs.axis_info[0].unit_conversion_factor - 1.0) < 1e-9
    units = ((FOOT, "feet"), (1000.0, "kilometres")) if metre else ((1 / FOOT, "metres"),)
    unit = next((name for factor, name in units if crs.is_projected and _inside(xy * factor, crs, area).all()), None)
    # A place some zones aside is, taken for feet, often inside too: in a metric zone the zone is the likelier slip.
    if unit and not (side and unit == "feet" and crs.utm_zone):
        return "wrong-unit", f"they look like {unit}", "convert them, or give the CRS that counts in their unit"
    if side:
        mend = "give the CRS of the zone they are in" + (f"; or convert them, if they are {unit}" if unit else "")
        return "wrong-zone", "they look like those of a neighbouring zone", mend
    return "outside-crs-area", "no usual slip explains it", "check the CRS of the control; is it a local system?"


def _zone(control: ImageControl, area: Area) -> str | None:
    """Return the UTM zone on WGS 84 in which coordinates lie in an area."""
    if control.crs.utm_zone is None:
        return None
    for code in (base + zone for base in (32600, 32700) for zone in range(1, 61)):
        if _inside(control.xy, CRS.from_epsg(code), area).mean() > 0.9:
            return f"EPSG:{code}"
    return None
