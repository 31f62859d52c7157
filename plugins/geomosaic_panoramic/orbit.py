"""Circular orbit of a satellite over the turning Earth, as poses.

In inertial axes the satellite runs on a circle of radius r with the angular speed n = √(GM / r³). At latitude φ of a
sphere the azimuth of that motion is asin(cos i / cos φ) for inclination i, measured at the ascending pass (Vallado,
Fundamentals of Astrodynamics, on launch azimuth). The Earth turns below it by ω = 7.292115e-5 rad/s, which is what
skews the image. The body's axes: down to the ellipsoid, forward along the inertial velocity: no yaw hides the skew.
"""

from __future__ import annotations

import math

import numpy as np

from geomosaic.errors import InputError
from geomosaic.geo.crs import geographic
from geomosaic.geo.local_frames import LocalFrame, enu_axes
from geomosaic.geo.transform import Transform
from geomosaic.types import FloatArray
from geomosaic_panoramic.trajectory import Poses

GM = 3.986004418e14
"""Earth's gravitational constant, m³/s² (WGS 84)."""
SPIN = 7.292115e-5
"""Angular speed of the Earth, rad/s (WGS 84)."""
STEP = 0.25
"""Seconds between poses: the curve through them then keeps to the circle within 0.01 mm."""


def inertial_azimuth(inclination: float, latitude: float, *, ascending: bool) -> float:
    """Azimuth of the inertial motion on a circular orbit.

    asin(cos i / cos φ), see the head of this module.

    Parameters
    ----------
    inclination : float
        Radians.
    latitude : float
        Geocentric, radians.
    ascending : bool
        Whether the satellite flies north.

    Returns
    -------
    float
        Radians, clockwise from north.

    Raises
    ------
    InputError
        The orbit does not reach that latitude.
    """
    sine = math.cos(inclination) / math.cos(latitude)
    if abs(sine) > 1.0:
        raise InputError(
            f"an orbit of inclination {math.degrees(inclination):g} degrees does not reach the latitude "
            f"{math.degrees(latitude):.2f}",
            hint="check inclination and position",
        )
    return math.asin(sine) if ascending else math.pi - math.asin(sine)


def angular_speed(radius: float) -> float:
    """Angular speed on a circular orbit, √(GM / r³).

    Parameters
    ----------
    radius : float
        Metres from the Earth's centre.

    Returns
    -------
    float
        Radians per second.
    """
    return math.sqrt(GM / radius**3)


def orbit_poses(frame: LocalFrame, inclination: float, ascending: bool, seconds: float, half: float) -> Poses:
    """Poses of a satellite on a circular orbit through the origin of a frame at τ = 0.

    Parameters
    ----------
    frame : LocalFrame
    inclination : float
        Radians.
    ascending : bool
        Whether it flies north.
    seconds : float
        Of one unit of τ.
    half : float
        τ at the end of the image; the poses reach a tenth beyond.

    Returns
    -------
    Poses

    Raises
    ------
    InputError
        The orbit does not reach the latitude of the frame.
    """
    start = frame.origin
    # A circular orbit through the given position: its height stays that of the middle of the image.
    radius = float(np.linalg.norm(start))
    up = start / radius
    latitude, longitude = math.asin(up[2]), math.degrees(math.atan2(up[1], up[0]))
    azimuth = inertial_azimuth(inclination, latitude, ascending=ascending)
    east, north, _ = enu_axes(longitude, math.degrees(latitude))
    ahead = math.sin(azimuth) * east + math.cos(azimuth) * north
    reach = 1.1 * half + 1.0
    count = 2 * max(2, math.ceil(reach * seconds / STEP)) + 1
    tau = np.linspace(-reach, reach, count)
    t = tau * seconds
    n = angular_speed(radius)
    c, s = np.cos(n * t)[:, None], np.sin(n * t)[:, None]
    places = _turned(radius * (c * up + s * ahead), -SPIN * t)
    # The inertial velocity, not that over the ground: no yaw steering follows the turning Earth.
    forward = _turned(c * ahead - s * up, -SPIN * t)
    lonlat = Transform(frame.crs, geographic(frame.crs))(places)
    down = -np.stack([enu_axes(longitude, latitude)[2] for longitude, latitude in lonlat[:, :2]])
    right = np.cross(down, forward)
    right /= np.linalg.norm(right, axis=1)[:, None]
    axes = np.stack([np.cross(right, down), right, down], axis=1)
    return Poses(tau, frame.to_enu(places), axes @ frame.axes.T)


def _turned(xyz: FloatArray, angle: FloatArray) -> FloatArray:
    """Vectors (N, 3) rotated about the Earth's axis by angles (N,): inertial to Earth-fixed where the angle is −ω·t."""
    c, s = np.cos(angle), np.sin(angle)
    return np.column_stack([c * xyz[:, 0] - s * xyz[:, 1], s * xyz[:, 0] + c * xyz[:, 1], xyz[:, 2]])
