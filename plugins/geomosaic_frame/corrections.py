"""Which corrections of the rays a photo gets, and what they are worth."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError, SensorInputError
from geomosaic.geo.crs import geographic, horizontal
from geomosaic.geo.local_frames import is_free, map_place
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import height_unit
from geomosaic.sensor.inputs import flag
from geomosaic.types import FloatArray
from geomosaic_frame.camera import Camera
from geomosaic_frame.camera_capabilities import Inside
from geomosaic_frame.refraction import Bending, curvature_shift, refraction_constant, refraction_shift

HIGHEST = 20_000.0
"""Metres up to which the standard atmosphere's formula is used."""
WORTH = 0.5
"""Pixels from which on a correction that was not asked for is told."""


def bending_of(
    options: Mapping[str, Any], crs: CRS, position: FloatArray, ground: float | None, treatment: str, where: str
) -> tuple[Bending, list[str]]:
    """Bending of the rays that the inputs `refraction` and `curvature` ask for, and what is to be said of it.

    Parameters
    ----------
    options : mapping
    crs : CRS
        3-D.
    position : array (3,)
        Projection centre in `crs`.
    ground : float or None
        Mean height of the ground in the vertical datum of `crs`.
    treatment : str
        'rigorous' or 'planar'.
    where : str
        Named in errors.
    """
    refraction, curvature = flag(options, "refraction", where), flag(options, "curvature", where)
    if not refraction and not curvature:
        return Bending(), []
    if is_free(crs) or flag(options, "upwards", where):
        raise SensorInputError(
            "refraction and curvature are about photos from above, not about things in front of the camera",
            name="refraction",
            where=where,
            hint="leave them out",
        )
    if curvature and treatment != "planar":
        raise SensorInputError(
            "curvature corrects the planar treatment; the rigorous one has the Earth's curvature in its coordinates",
            name="curvature",
            where=where,
            hint="leave it out, or set treatment = 'planar'",
        )
    if ground is None:
        raise SensorInputError(
            f"{'refraction' if refraction else 'curvature'} depends on the height of the ground, which is not known",
            name="ground_height",
            where=where,
            hint="give ground_height, the mean height of the ground under the photo in the vertical datum of the "
            "positions",
        )
    top, bottom = _metres(crs, position, ground)
    if not bottom < top <= HIGHEST:
        raise InputError(
            f"a camera at {top:.0f} m above ground at {bottom:.0f} m is outside the standard atmosphere's formula",
            where=where,
            hint=f"it holds up to {HIGHEST:.0f} m; check the heights and their unit",
        )
    k = refraction_constant(top, bottom) if refraction else 0.0
    a = (top - bottom) / (2.0 * earth_radius(crs, position)) if curvature else 0.0
    said = []
    if refraction:
        said.append(f"refraction of the standard atmosphere: {1e6 * k:.1f} µrad at 45° from the nadir")
    if curvature:
        said.append(f"curvature of the Earth corrected for ground {top - bottom:.0f} m below the camera")
    return Bending(k, a), said


def untold(camera: Inside, crs: CRS, position: FloatArray, ground: float | None, treatment: str) -> list[str]:
    """What the corrections that were not asked for would be worth on film, where that is half a pixel or more."""
    if ground is None or is_free(crs) or isinstance(camera, Camera):
        return []
    from geomosaic_frame.film import FilmCamera

    if not isinstance(camera, FilmCamera):
        return []
    top, bottom = _metres(crs, position, ground)
    if not 0.0 <= bottom < top <= HIGHEST:
        return []
    constant, radius = camera.lens.constant, camera.reach()
    pixels = max(camera.focal) / constant / 1000.0
    said = []
    moved = float(refraction_shift(np.array(radius), constant, top, bottom)) * pixels
    if moved >= WORTH:
        said.append(f"refraction is not corrected; it moves the corners by {moved:.1f} px (refraction = true)")
    if treatment == "planar":
        moved = float(curvature_shift(np.array(radius), constant, top - bottom, earth_radius(crs, position))) * pixels
        if moved >= WORTH:
            said.append(f"curvature is not corrected; it moves the corners by {moved:.1f} px (curvature = true)")
    return said


def earth_radius(crs: CRS, position: FloatArray) -> float:
    """Gauss's mean radius of curvature of the ellipsoid at a place, in metres."""
    ellipsoid = crs.ellipsoid
    a, b = (ellipsoid.semi_major_metre, ellipsoid.semi_minor_metre) if ellipsoid else (6378137.0, 6356752.3)
    latitude = np.radians(map_place(horizontal(crs), position[0], position[1]).latitude)
    e2 = 1.0 - (b / a) ** 2
    return float(b / (1.0 - e2 * np.sin(latitude) ** 2))


def _metres(crs: CRS, position: FloatArray, ground: float) -> tuple[float, float]:
    """Heights of camera and ground in metres."""
    level = geographic(crs) if crs.is_geocentric else crs
    height = float(Transform(crs, level)(position[None])[0, 2]) if crs.is_geocentric else float(position[2])
    unit = height_unit(level)
    return height * unit, ground * unit
