"""Corrections of rays: refraction in the atmosphere and the curvature of the Earth.

Both move an image point along the line to the nadir, by an amount that depends on the angle α from the nadir. So they
are one map of directions: horizontal components are multiplied by q, with t = tan²α,

    q = (1 + K·(1 + t)) / (1 + a·t)

Refraction: the camera sees a point farther from the nadir than it is, by K·tan α; in a vertical photo by
Δr = K·(r + r³/c²). Snell's law in level layers of air gives K as the mean refractive index between ground and camera
less that at the camera. With n − 1 proportional to the density ρ, and the weight of the air being its pressure p,

    K = 2.26e-4 m³/kg · ((p(h) − p(H)) / (g·(H − h)) − ρ(H))

with H and h the heights of camera and ground, p and ρ of the ICAO standard atmosphere. To 9 km that is Saastamoinen's
K = 13e-6·(H − h)·(1 − 0.02·(2·H + h)), in km (Photogrammetric Engineering 38 (1972), p. 799; Manual of Photogrammetry).

Curvature: at the distance D a point lies D²/2R lower than the map has it, so it is seen nearer to the nadir; in a
vertical photo by Δr = (H − h)·r³ / (2·R·c²), a = (H − h)/(2·R).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError, SensorInputError
from geomosaic.geo.crs import geographic, horizontal, is_local
from geomosaic.geo.local_frames import map_place
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import height_unit
from geomosaic.sensor.inputs import flag, number
from geomosaic.types import FloatArray

Columns = tuple[FloatArray, FloatArray, FloatArray]

# (n − 1)/ρ of air in the middle of the visible light, m³/kg.
GLADSTONE_DALE = 2.26e-4
GRAVITY = 9.80665
# tan² of the nadir angle beyond which the correction is that at 80°: neither formula holds near the horizon.
STEEPEST = float(np.tan(np.radians(80.0)) ** 2)


def refraction_constant(height: float, ground: float) -> float:
    """Refraction constant K of the standard atmosphere: angle by which a ray 45° from the nadir is seen too far out.

    Parameters
    ----------
    height, ground : float
        Of camera and ground above sea level in metres, up to 20 km. Heights above the ellipsoid do as well: 50 m are
        0.5 µrad at most.

    Returns
    -------
    float
        Radians.
    """
    (above, density), (below, _) = _atmosphere(height), _atmosphere(ground)
    return GLADSTONE_DALE * ((below - above) / (GRAVITY * (height - ground)) - density)


def _atmosphere(height: float) -> tuple[float, float]:
    """Pressure in Pa and density in kg/m³ of the ICAO standard atmosphere, from the sea to 20 km."""
    base = 1.0 - 2.25577e-5 * min(height, 11000.0)
    thin = float(np.exp(-max(height - 11000.0, 0.0) / 6341.62))
    return 101325.0 * base**5.25588 * thin, 1.225 * base**4.25588 * thin


def refraction_shift(radius: FloatArray, constant: float, height: float, ground: float) -> FloatArray:
    """Radial displacement by refraction in a vertical photo, Δr = K·(r + r³/c²), outwards.

    Parameters
    ----------
    radius : array (N,)
        Distance from the principal point in mm.
    constant : float
        Camera constant in mm.
    height, ground : float
        Of camera and ground above sea level in metres.

    Returns
    -------
    array
        Micrometres, of the shape of `radius`.
    """
    r = np.asarray(radius, dtype=np.float64)
    return 1000.0 * refraction_constant(height, ground) * (r + r**3 / constant**2)


def curvature_shift(radius: FloatArray, constant: float, above: float, earth: float) -> FloatArray:
    """Radial displacement by the Earth's curvature in a vertical photo, Δr = (H − h)·r³ / (2·R·c²), inwards.

    Parameters
    ----------
    radius : array (N,)
        Distance from the principal point in mm.
    constant : float
        Camera constant in mm.
    above : float
        Flying height above ground in metres.
    earth : float
        Radius of the Earth in metres.

    Returns
    -------
    array
        Micrometres, of the shape of `radius`.
    """
    r = np.asarray(radius, dtype=np.float64)
    return 1000.0 * above * r**3 / (2.0 * earth * constant**2)


@dataclass(frozen=True)
class RayCorrection:
    """Correction of rays for refraction and curvature: a map of directions about the vertical through the camera.

    Directions are in east, north, up, or map axes.

    Attributes
    ----------
    refraction : float
        K in radians; 0 for none.
    curvature : float
        a = flying height / (2 · Earth's radius); 0 for none.
    """

    refraction: float = 0.0
    curvature: float = 0.0

    @property
    def none(self) -> bool:
        """Whether rays are straight."""
        return self.refraction == 0.0 and self.curvature == 0.0

    def _factor(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Factor q and dq/dt at t = tan²α; beyond 80° both stay."""
        # Held constant and not cut off, so that rays near the horizon still have a direction and its inverse.
        capped = np.minimum(t, STEEPEST)
        top, bottom = 1.0 + self.refraction * (1.0 + capped), 1.0 + self.curvature * capped
        slope = (self.refraction * bottom - self.curvature * top) / bottom**2
        return top / bottom, np.where(t < STEEPEST, slope, 0.0)

    def seen(self, east: FloatArray, north: FloatArray, up: FloatArray) -> Columns:
        """Vectors from the camera to the ground, (N,) each, to the directions in which they are seen.

        Parameters
        ----------
        east, north, up : array (N,)
            From the camera to the ground, metres.
        """
        q = self._factor(_tangent_squared(east, north, up))[0]
        return q * east, q * north, up

    def true(self, directions: FloatArray) -> FloatArray:
        """Directions in which the ground is seen (N, 3) to where it is; not normalised."""
        east, north, up = np.asarray(directions, dtype=np.float64).T
        seen = _tangent_squared(east, north, up)
        t = seen.copy()
        for _ in range(20):  # t·q(t)² = tan² of the angle seen; q is 1 but for less than a hundredth
            q = self._factor(t)[0]
            moved = seen / q**2
            done = not (np.abs(moved - t) > 1e-16 * (1.0 + np.abs(t))).any()
            t = moved
            if done:
                break
        q = self._factor(t)[0]
        return np.column_stack([east / q, north / q, up])

    def slopes(self, east: FloatArray, north: FloatArray, up: FloatArray) -> FloatArray:
        """Derivatives of `seen` by (east, north, up), (N, 3, 3).

        Parameters
        ----------
        east, north, up : array (N,)
            From the camera to the ground, metres.
        """
        t = _tangent_squared(east, north, up)
        q, slope = self._factor(t)
        with np.errstate(divide="ignore", invalid="ignore"):
            by = np.column_stack([2.0 * east / up**2, 2.0 * north / up**2, -2.0 * t / up]) * slope[:, None]
        # On the horizon up is 0 and the quotient infinite, but q is constant there.
        by[slope == 0.0] = 0.0
        out = np.zeros((len(q), 3, 3))
        out[:, 0] = east[:, None] * by
        out[:, 1] = north[:, None] * by
        out[:, 0, 0] += q
        out[:, 1, 1] += q
        out[:, 2, 2] = 1.0
        return out

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {"refraction": self.refraction, "curvature": self.curvature}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Correction of a state, as `to_dict` gives it; a state without either is straight."""
        return cls(float(state.get("refraction", 0.0)), float(state.get("curvature", 0.0)))


def _tangent_squared(east: FloatArray, north: FloatArray, up: FloatArray) -> FloatArray:
    """tan² of the angle from the vertical, cut where it exceeds anything that matters; NaN of NaN."""
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        t = (east**2 + north**2) / up**2
    return np.minimum(np.where(up == 0.0, np.inf, t), 1e6 * STEEPEST)


# Metres up to which the standard atmosphere's formula is used.
HIGHEST = 20_000.0
# µrad; from any height K stays below 120.
MOST_REFRACTION = 500.0


def requested_correction(
    options: Mapping[str, Any], crs: CRS, position: FloatArray, ground: float | None, flat: bool, where: str
) -> tuple[RayCorrection, list[str]]:
    """Correction of the rays that the options `refraction` and `curvature` ask for, with notes.

    Parameters
    ----------
    options : mapping
    crs : CRS
        3-D.
    position : array (3,)
        Projection centre in `crs`.
    ground : float or None
        Mean height of the ground in the vertical datum of `crs`.
    flat : bool
        Whether the map is taken for a flat Earth, the planar treatment.
    where : str
        Named in errors.

    Returns
    -------
    correction : RayCorrection
    notes : list of str
        Size of each correction.

    Raises
    ------
    InputError
        A correction is asked for where it has no meaning, or the heights are unknown or out of range.
    """
    given, curvature = options.get("refraction"), flag(options, "curvature", where)
    known = None if given is None or isinstance(given, bool) else number(given, "refraction", where)
    refraction = bool(given) if known is None else known != 0.0
    if not refraction and not curvature:
        return RayCorrection(), []
    if is_local(crs) or flag(options, "upwards", where):
        raise SensorInputError(
            "refraction and curvature apply to photos from above, not to objects in front of the camera",
            name="refraction",
            where=where,
            hint="leave them out",
        )
    if curvature and not flat:
        raise SensorInputError(
            "curvature corrects the planar treatment; the rigorous one has the Earth's curvature in its coordinates",
            name="curvature",
            where=where,
            hint="leave it out, or set treatment = 'planar'",
        )
    if known is not None and not 0.0 <= known <= MOST_REFRACTION:
        raise SensorInputError(
            f"a refraction constant of {known:g} µrad is none of the Earth's atmosphere",
            name="refraction",
            where=where,
            hint=f"give K, the angle at 45° from the nadir, in µrad, up to {MOST_REFRACTION:g}; or true",
        )
    if known is not None and not curvature:
        return RayCorrection(1e-6 * known, 0.0), [f"refraction as given: {known:.1f} µrad at 45° from the nadir"]
    if ground is None:
        raise SensorInputError(
            f"{'refraction' if refraction else 'curvature'} depends on the height of the ground, which is not known",
            name="ground_height",
            where=where,
            hint="give ground_height, the mean height of the ground under the photo in the vertical datum of the "
            "positions",
        )
    top, bottom = heights_in_metres(crs, position, ground)
    if not bottom < top <= HIGHEST:
        raise InputError(
            f"a camera at {top:.0f} m above ground at {bottom:.0f} m is outside the standard atmosphere's formula",
            where=where,
            hint=f"it holds up to {HIGHEST:.0f} m; check the heights and their unit",
        )
    k = 1e-6 * known if known is not None else refraction_constant(top, bottom) if refraction else 0.0
    a = (top - bottom) / (2.0 * earth_radius(crs, position)) if curvature else 0.0
    notes = []
    if refraction:
        source = "of the standard atmosphere" if known is None else "as given"
        notes.append(f"refraction {source}: {1e6 * k:.1f} µrad at 45° from the nadir")
    if curvature:
        notes.append(f"curvature of the Earth corrected for ground {top - bottom:.0f} m below the camera")
    return RayCorrection(k, a), notes


def earth_radius(crs: CRS, position: FloatArray) -> float:
    """Gaussian mean radius of curvature of the ellipsoid, b / (1 − e²·sin²φ).

    Parameters
    ----------
    crs : CRS
        With the ellipsoid; WGS 84's where it has none.
    position : array (2,) or (3,)
        In `crs`.

    Returns
    -------
    float
        Metres.
    """
    ellipsoid = crs.ellipsoid
    a, b = (ellipsoid.semi_major_metre, ellipsoid.semi_minor_metre) if ellipsoid else (6378137.0, 6356752.3)
    latitude = np.radians(map_place(horizontal(crs), position[0], position[1]).latitude)
    e2 = 1.0 - (b / a) ** 2
    return float(b / (1.0 - e2 * np.sin(latitude) ** 2))


def heights_in_metres(crs: CRS, position: FloatArray, ground: float) -> tuple[float, float]:
    """Heights of camera and ground in metres.

    Parameters
    ----------
    crs : CRS
        3-D.
    position : array (3,)
        Projection centre in `crs`.
    ground : float
        In the unit and vertical datum of `crs`.
    """
    level = geographic(crs) if crs.is_geocentric else crs
    height = float(Transform(crs, level)(position[None])[0, 2]) if crs.is_geocentric else float(position[2])
    unit = height_unit(level)
    return height * unit, ground * unit
