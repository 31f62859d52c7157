"""Findings on control points: code, severity, points and how to go on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from pyproj import CRS

from geomosaic.control.points import ControlPoints
from geomosaic.errors import listed
from geomosaic.geo.crs import horizontal
from geomosaic.geo.projection_domain import Area, area_of_use, beyond, longitude_latitude
from geomosaic.geo.units import linear_unit
from geomosaic.types import AnyArray, BoolArray, FloatArray, IntArray

SEVERITIES = ("error", "warning", "note")


@dataclass(frozen=True)
class Diagnostic:
    """Finding on control points: its code, severity, points and remedy.

    Attributes
    ----------
    code : str
        Short and constant, such as 'collinear'.
    severity : str
        'error': a fit would be undetermined or meaningless; 'warning': it would be weak or may be wrong; 'note'.
    what : str
        One sentence.
    points : tuple of str
        Names of the points it is about; empty where it is about all or none.
    hint : str
        What to do.
    """

    code: str
    severity: str
    what: str
    points: tuple[str, ...]
    hint: str

    def __str__(self) -> str:
        return f"{self.severity} ({self.code}): {self.what}\n  hint: {self.hint}"


def point_names(control: ControlPoints, which: AnyArray | Sequence[int]) -> tuple[str, ...]:
    """Names of points by mask (N,) or by indices.

    Parameters
    ----------
    control : ControlPoints
    which : array or sequence of int
        Mask (N,), or indices.
    """
    chosen = np.asarray(which)
    return tuple(control.names[i] for i in (np.flatnonzero(chosen) if chosen.dtype == np.bool_ else chosen))


def leave_out(names: Sequence[str]) -> str:
    """Hint for leaving points out: the parameter `without`, once for each.

    Parameters
    ----------
    names : sequence of str
    """
    return " ".join(f"`without={name}`" for name in names)


def plane_coordinates(control: ControlPoints) -> FloatArray:
    """Ground coordinates (N, 2) about their mean, units of the CRS; longitudes are scaled by cos(latitude).

    Parameters
    ----------
    control : ControlPoints
    """
    xy: FloatArray = control.xy - control.xy.mean(axis=0)
    if control.crs.is_geographic:
        latitude = float(np.median(control.xy[:, 1]))
        if abs(latitude) < 90.0:
            xy = xy * np.array([np.cos(np.radians(latitude)), 1.0])
    return xy


_ALL = 18  # points whose triples are all taken; of more, a fixed random sample
_SAMPLE = 2000
_VOTE = 0.2


def _triples(count: int) -> IntArray:
    if count <= _ALL:
        return np.array(list(combinations(range(count), 3)), dtype=np.int64).reshape(-1, 3)
    random = np.random.default_rng(0)
    return random.integers(count, size=(_SAMPLE, 3), dtype=np.int64)  # one with a point twice has no area


def _linear_part(colrow: FloatArray, ground: FloatArray) -> tuple[float, FloatArray]:
    """Vote of triples of points on whether an image is mirrored, and the linear part of image to ground, (2, 2).

    The vote is -1 where all triples run the other way round in the image (rows downwards) than on the ground (y
    upwards), as they should; 1 where all run the same way round. Blunders, 30 % of them, leave the sign.
    """
    triples = _triples(len(colrow))
    image = colrow[triples[:, 1:]] - colrow[triples[:, :1]]
    apart = ground[triples[:, 1:]] - ground[triples[:, :1]]
    area = np.linalg.det(image)
    usable = np.abs(area) > 0.1 * np.abs(area).max(initial=1e-9)
    if not usable.any():
        return 0.0, np.zeros((2, 2))
    matrices = np.linalg.solve(image[usable], apart[usable]).transpose(0, 2, 1)
    return float(np.sign(np.linalg.det(matrices)).mean()), np.median(matrices, axis=0)


def is_mirrored(control: ControlPoints) -> bool:
    """Whether ground and image (rows downwards) have the same orientation.

    Parameters
    ----------
    control : ControlPoints
    """
    return len(control) >= 3 and _linear_part(control.colrow, plane_coordinates(control))[0] > _VOTE


def mirrored(control: ControlPoints) -> list[Diagnostic]:
    """Finding that the image is mirrored, with its most likely cause if north is about up, down, left or right.

    Parameters
    ----------
    control : ControlPoints
    """
    # Rows or columns that run the wrong way and exchanged axes all mirror an image; they differ by where north is. A
    # radar scene or a film scanned from its back is mirrored rightly: where a program wrote the points (control in a
    # raster) the finding is a note.
    if len(control) < 3:
        return []
    vote, matrix = _linear_part(control.colrow, plane_coordinates(control))
    if vote <= _VOTE:
        return []
    turn = float(np.degrees(np.arctan2(matrix[1, 0] - matrix[0, 1], matrix[0, 0] + matrix[1, 1])))
    if 45.0 < abs(turn) < 135.0:
        code, hint = _swapped(control)
    elif abs(turn) <= 45.0:
        code, hint = "mirrored-rows", "let rows count from the top of the image"
    else:
        code, hint = "mirrored-columns", "let columns count from the left of the image"
    written = all(origin.unit == "GCP" for origin in control.origins)
    what = "the ground is mirrored in the image: it runs the same way round as columns and rows"
    hint = f"{hint}; nothing, where the image is mirrored (radar scene, film scanned from its back)"
    return [Diagnostic(code, "note" if written else "warning", what, (), hint)]


def _swapped(control: ControlPoints) -> tuple[str, str]:
    """Code and hint of exchanged ground axes."""
    if control.crs.is_geographic:
        return "latitude-longitude-swapped", "give longitude as x and latitude as y (or exchange col and row)"
    return "swapped-axes", "exchange x and y (or col and row): x is east, y is north"


# Degrees beyond the area of use that still count as inside.
MARGIN = 1.0
# Degrees beyond it, in longitude, that look like a neighbouring zone.
ZONE = 12.0
FOOT = 0.3048
# Units of a projection; no photo has pixels as small on the ground.
SMALLEST = 1e-4


# Degrees that points may lie from a place that is known to be near.
NEAR = 1.0


def _within_area(xy: FloatArray, crs: CRS, area: Area) -> BoolArray:
    return np.asarray((beyond(longitude_latitude(xy, crs), area) <= MARGIN).all(axis=1))


def misplaced(control: ControlPoints, near: tuple[float, float] | None = None) -> list[Diagnostic]:
    """Ground coordinates that do not fit their CRS.

    Parameters
    ----------
    control : ControlPoints
    near : tuple of float, optional
        Longitude and latitude in degrees of a place near the image (EXIF, a DEM, the map). Coordinates of one zone are
        valid in every other: only this tells them apart. The points may lie `NEAR` degrees from it.

    Returns
    -------
    list of Diagnostic
        At most one. Nothing for a CRS that is not tied to the Earth.
    """
    crs, xy = control.crs, control.xy
    if crs.is_geocentric or horizontal(crs).geodetic_crs is None or not len(control):
        return []
    area = area_of_use(crs)
    if near is not None:
        area = (near[0] - NEAR, near[1] - NEAR, near[0] + NEAR, near[1] + NEAR)
    if _tiny(control):
        what = f"the points ({xy[0, 0]:.10g}, {xy[0, 1]:.10g}, ...) look like degrees, and '{crs.name}' is metric"
        hint = "give the control's CRS as a geographic one, such as EPSG:4326"
        return [Diagnostic("degrees-in-metres", "error", what, control.names, hint)]
    if area is None:
        return []
    out = ~_within_area(xy, crs, area)
    if not out.any():
        return []
    names = point_names(control, out)
    reach = f"near {near[0]:g}, {near[1]:g}" if near else f"in the area of use of '{crs.name}'"
    if out.mean() <= 0.5:
        what = f"{len(names)} of {len(control)} points do{'es' * (len(names) == 1)} not lie {reach}: {listed(names)}"
        return [Diagnostic("outside-crs-area", "error", what, names, "look for a digit lost or exchanged in them")]
    code, looks, hint = _cause(control, area, near)
    at = f"{xy[0, 0]:.10g}, {xy[0, 1]:.10g}"
    return [Diagnostic(code, "error", f"the points ({at}, ...) do not lie {reach}: {looks}", names, hint)]


def has_valid_positions(control: ControlPoints) -> bool:
    """Whether all points can lie on the Earth: no latitude is beyond a pole.

    Parameters
    ----------
    control : ControlPoints
    """
    return not (control.crs.is_geographic and bool((np.abs(control.xy[:, 1]) > 90.0).any()))


def _tiny(control: ControlPoints) -> bool:
    """Whether coordinates look like degrees in a projected CRS: small numbers, and pixels too small for metres."""
    xy = np.abs(control.xy)
    small = (xy <= [180.0, 90.0]).all() or (xy <= [90.0, 180.0]).all()
    pixel = np.ptp(control.xy, axis=0).max() / max(float(np.ptp(control.colrow, axis=0).max()), 1.0)
    return bool(control.crs.is_projected and small and pixel < SMALLEST)


def _cause(control: ControlPoints, area: Area, near: tuple[float, float] | None) -> tuple[str, str, str]:
    crs, xy = control.crs, control.xy
    if _within_area(xy[:, ::-1], crs, area).mean() > 0.9:
        code, hint = _swapped(control)
        return code, "they do with the axes exchanged", hint
    if crs.is_geographic and (np.abs(xy) > 400.0).any(axis=1).mean() > 0.5:
        return "metres-in-degrees", "they look like metres of a projection", "give the projected CRS they are in"
    if near is not None and (zone := _zone(control, area)):
        return "wrong-zone", f"they do in {zone}", f"give {zone} as the CRS of the control"
    miss = beyond(longitude_latitude(xy, crs), area)
    side = not np.isnan(miss).any() and bool((np.median(miss, axis=0) <= [ZONE, MARGIN]).all())
    metre = abs(linear_unit(crs) - 1.0) < 1e-9
    units = ((FOOT, "feet"), (1000.0, "kilometres")) if metre else ((1 / FOOT, "metres"),)
    unit = next(
        (name for factor, name in units if crs.is_projected and _within_area(xy * factor, crs, area).all()), None
    )
    # A place some zones aside is, taken for feet, often inside too: in a metric zone the zone is the likelier slip.
    if unit and not (side and unit == "feet" and crs.utm_zone):
        return "wrong-unit", f"they look like {unit}", "convert them, or give the CRS that counts in their unit"
    if side:
        hint = "give the CRS of the zone they are in" + (f"; or convert them, if they are {unit}" if unit else "")
        return "wrong-zone", "they look like those of a neighbouring zone", hint
    return "outside-crs-area", "no usual slip explains it", "check the CRS of the control; is it a local system?"


def _zone(control: ControlPoints, area: Area) -> str | None:
    """Code of the WGS 84 UTM zone in which the coordinates lie in an area, None if there is none."""
    if control.crs.utm_zone is None:
        return None
    for code in (base + zone for base in (32600, 32700) for zone in range(1, 61)):
        if _within_area(control.xy, CRS.from_epsg(code), area).mean() > 0.9:
            return f"EPSG:{code}"
    return None
