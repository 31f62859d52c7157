"""Local frames and rotations: east-north-up, meridian convergence, grid scale, rotation matrices.

`r1`, `r2`, `r3` turn the *axes* (ground to image) right-handed about x, y, z, as in R = R3(κ)·R2(φ)·R1(ω).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from pyproj import CRS, Proj

from geomosaic.errors import InputError
from geomosaic.geo.crs import geocentric, geographic, has_heights, horizontal, longitude_latitude_crs
from geomosaic.geo.transform import Transform
from geomosaic.types import FloatArray


def r1(angle: float) -> FloatArray:
    """Rotation of the axes about x.

    Parameters
    ----------
    angle : float
        Radians, right-handed.

    Returns
    -------
    array (3, 3)
    """
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])


def r2(angle: float) -> FloatArray:
    """Rotation of the axes about y.

    Parameters
    ----------
    angle : float
        Radians, right-handed.

    Returns
    -------
    array (3, 3)
    """
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])


def r3(angle: float) -> FloatArray:
    """Rotation of the axes about z.

    Parameters
    ----------
    angle : float
        Radians, right-handed.

    Returns
    -------
    array (3, 3)
    """
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def nearest_rotation(matrix: FloatArray) -> FloatArray:
    """Rotation nearest to a matrix (3, 3) by least squares, by singular values (Wahba 1965).

    Parameters
    ----------
    matrix : array (3, 3)
    """
    u, _, v = np.linalg.svd(matrix)
    rotation: FloatArray = u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v
    return rotation


def require_rotation(
    matrix: FloatArray, what: str, where: str, most: float = 1e-5, hint: str | None = None
) -> FloatArray:
    """Rotation nearest to a matrix (3, 3) of a file, which must be one but for the digits it is printed with.

    Parameters
    ----------
    matrix : array (3, 3)
    what, where : str
        Named in errors.
    most : float
        Largest deviation from orthonormal rows.
    hint : str, optional
        What to do about it; else it is for the reader of the file to say.

    Raises
    ------
    InputError
        It is none, or mirrors.
    """
    off = float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    if off > most or np.linalg.det(matrix) < 0.0:
        what = f"{what} is no rotation: its rows are off orthonormal by {off:.1e}, or mirrored"
        raise InputError(what, where=where, hint=hint)
    return nearest_rotation(matrix)


def omega_phi_kappa(omega: float, phi: float, kappa: float) -> FloatArray:
    """Ground→image rotation R3(κ)·R2(φ)·R1(ω).

    Parameters
    ----------
    omega, phi, kappa : float
        Radians.

    Returns
    -------
    array (3, 3)
        Its rows are the image axes in the ground frame.
    """
    return r3(kappa) @ r2(phi) @ r1(omega)


def angles_of(rotation: FloatArray) -> tuple[float, float, float]:
    """Omega, phi, kappa of a ground→image rotation, the inverse of `omega_phi_kappa`.

    Parameters
    ----------
    rotation : array (3, 3)

    Returns
    -------
    omega, phi, kappa : float
        Radians; kappa is 0 where phi is ±90°.
    """
    m = np.asarray(rotation, dtype=np.float64)
    phi = float(np.arctan2(m[2, 0], np.hypot(m[2, 1], m[2, 2])))
    # Gimbal lock: omega and kappa turn about the same axis, so that only their sum or difference is known.
    if np.hypot(m[2, 1], m[2, 2]) < 1e-14:
        return float(np.arctan2(m[0, 1], m[1, 1]) * (1.0 if m[2, 0] > 0 else -1.0)), phi, 0.0
    return float(np.arctan2(-m[2, 1], m[2, 2])), phi, float(np.arctan2(-m[1, 0], m[0, 0]))


def angle_axis(vector: FloatArray) -> FloatArray:
    """Rotation matrix of a rotation vector, by the formula of Rodrigues.

    Parameters
    ----------
    vector : array (3,)
        Along the axis, its length the angle in radians.

    Returns
    -------
    array (3, 3)
    """
    v = np.asarray(vector, dtype=np.float64)
    angle = float(np.linalg.norm(v))
    if angle < 1e-300:
        return np.eye(3)
    x, y, z = v / angle
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation: FloatArray = np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * (k @ k)
    return rotation


def cross_matrices(vectors: FloatArray) -> FloatArray:
    """Matrices (N, 3, 3) whose products with b are v × b, of vectors v (N, 3).

    Parameters
    ----------
    vectors : array (N, 3)
    """
    zero = np.zeros(len(vectors))
    x, y, z = vectors.T
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


def enu_axes(longitude: float, latitude: float) -> FloatArray:
    """Rotation from geocentric axes to local east, north, up.

    Parameters
    ----------
    longitude, latitude : float
        Degrees, geodetic.

    Returns
    -------
    array (3, 3)
        Rows are the unit vectors E, N, U in the geocentric frame.
    """
    lon, lat = np.radians(longitude), np.radians(latitude)
    sl, cl, sp, cp = np.sin(lon), np.cos(lon), np.sin(lat), np.cos(lat)
    return np.array([[-sl, cl, 0.0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]])


@dataclass(frozen=True)
class MapPlace:
    """Place of a map: its longitude and latitude, and the projection's convergence and scale there.

    Attributes
    ----------
    longitude, latitude : float
        Degrees, on the datum of the map CRS.
    convergence : float
        Meridian convergence in degrees: the azimuth of grid north, clockwise from true north (PROJ's sign).
    scale : float
        Point scale factor of the projection (1 on the ellipsoid); the root of the scale of areas where not conformal.
    scales : tuple of float
        Least and greatest point scale factor over all directions.
    """

    longitude: float
    latitude: float
    convergence: float
    scale: float
    scales: tuple[float, float] = (1.0, 1.0)


def map_place(crs: CRS, x: float, y: float) -> MapPlace:
    """Longitude, latitude, meridian convergence and point scale at a place of a map.

    Parameters
    ----------
    crs : CRS
        Of the map; a vertical part is ignored.
    x, y : float
        Map coordinates, in units of `crs`.

    Returns
    -------
    MapPlace
        Convergence 0 and scale 1 where `crs` is not projected.
    """
    # The convergence is measured, not taken from formulas: a step to grid north is followed on the ellipsoid. So it
    # holds for every projection, axis order and unit.
    flat = horizontal(crs)
    longitude, latitude = _on_ellipsoid(crs, np.array([[x, y]]))[0]
    if not flat.is_projected:
        return MapPlace(float(longitude), float(latitude), 0.0, 1.0)
    factors = Proj(flat).get_factors(longitude, latitude)
    scale = float(np.sqrt(factors.areal_scale))
    # Map units: long against the rounding of coordinates, short against the curvature of the meridian's image.
    step = 10.0
    ends = _on_ellipsoid(crs, np.array([[x, y - step], [x, y + step]]))
    ellipsoid = flat.get_geod()
    there, back, _ = ellipsoid.inv(*ends[0], *ends[1]) if ellipsoid else (0.0, 180.0, 0.0)
    # The azimuth turns along the step; at its middle it is the mean of both ends.
    turn = (back + 180.0 - there + 180.0) % 360.0 - 180.0
    convergence = float(there + turn / 2)
    if not np.isfinite(convergence):
        raise InputError(
            f"{x:.10g}, {y:.10g} is no place in '{crs.name}'",
            hint="check the CRS of the coordinates, and that x is east and y north",
        )
    convergence -= 360.0 * round(convergence / 360.0)
    scales = float(factors.tissot_semiminor), float(factors.tissot_semimajor)
    return MapPlace(float(longitude), float(latitude), convergence, scale, scales)


def _on_ellipsoid(crs: CRS, xy: FloatArray) -> FloatArray:
    """Longitude and latitude in degrees, (N, 2)."""
    flat = horizontal(crs)
    if not has_heights(crs):
        return Transform(flat, longitude_latitude_crs(flat))(xy)
    # PROJ looks long for an operation. The one to geocentric coordinates is needed for every camera anyway.
    ecef = geocentric(crs)
    xyz = Transform(crs, ecef)(np.column_stack([xy, np.zeros(len(xy))]))
    return Transform(ecef, geographic(ecef))(xyz)[:, :2]


@dataclass(frozen=True)
class LocalFrame:
    """East, north, up at an origin, in metres, tied to a geocentric CRS; or the axes of a map taken for a flat Earth.

    Attributes
    ----------
    crs : CRS
        Geocentric, or the map.
    origin : array (3,)
        In `crs`.
    axes : array (3, 3)
        Rows are the unit vectors east, north, up.
    """

    crs: CRS
    origin: FloatArray
    axes: FloatArray

    @classmethod
    def at(cls, ground: CRS, xyz: FloatArray) -> LocalFrame:
        """Frame at one point (3,) of a 3-D CRS."""
        ecef = geocentric(ground)
        point = np.asarray(xyz, dtype=np.float64).reshape(1, 3)
        origin = Transform(ground, ecef)(point)[0]
        longitude, latitude, _ = Transform(ecef, geographic(ecef))(origin[None])[0]
        return cls(ecef, origin, enu_axes(longitude, latitude))

    @classmethod
    def of_map(cls, crs: CRS, xyz: FloatArray, where: str) -> LocalFrame:
        """Axes of a map at one point: the planar treatment of textbooks, wrong by the Earth's and the map's curvature.

        Parameters
        ----------
        crs : CRS
            Map, with one unit for all axes.
        xyz : array (3,)
            In `crs`.
        where : str
            Named in errors.

        Raises
        ------
        InputError
            The CRS is not a map, or measures heights in another unit.
        """
        flat = horizontal(crs)
        if crs.is_geocentric or flat.is_geographic:
            what = f"'{crs.name}' has {'degrees' if flat.is_geographic else 'no plane'}"
            raise InputError(
                f"the planar treatment needs a map, but {what}",
                where=where,
                hint="name a projected CRS, or use treatment = 'rigorous'",
            )
        if len({axis.unit_conversion_factor for axis in crs.axis_info}) > 1:
            units = " and ".join(sorted({axis.unit_name for axis in crs.axis_info}))
            raise InputError(f"'{crs.name}' mixes {units}", where=where, hint="use treatment = 'rigorous'")
        return cls(crs, np.asarray(xyz, dtype=np.float64), np.eye(3))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {"crs": self.crs.to_wkt(), "origin": self.origin.tolist(), "axes": self.axes.tolist()}

    @classmethod
    def from_dict(cls, state: Mapping[str, Any]) -> LocalFrame:
        """Frame of a state that holds what `to_dict` gives."""
        return cls(CRS.from_wkt(state["crs"]), np.array(state["origin"]), np.array(state["axes"]))

    def to_enu(self, xyz: FloatArray) -> FloatArray:
        """Geocentric (N, 3) to east, north, up in metres (N, 3)."""
        return (np.asarray(xyz) - self.origin) @ self.axes.T

    def to_geocentric(self, enu: FloatArray) -> FloatArray:
        """East, north, up (N, 3) to geocentric metres (N, 3)."""
        return np.asarray(enu) @ self.axes + self.origin
