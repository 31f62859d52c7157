"""Range-Doppler equations: time and slant range at which the sensor passes a ground point, and the inverse.

With the sensor at S(t) with velocity V(t), the ground point P is imaged at the zero-Doppler time t:

    (P − S(t)) · V(t) = 0,    R = |P − S(t)|

(Curlander and McDonough, Synthetic Aperture Radar, 1991, section 8.2; Small and Schubert, Guide to ASAR Geocoding, RSL-
ASAR-GC-AD, 2008). With the acceleration A the left side changes with time by (P − S) · A − V · V. Implicitly
∂t/∂P = −V / ((P − S) · A − V · V); and ∂R/∂P = (P − S) / R, as R does not change with t there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.types import FloatArray
from geomosaic_sar.orbit import Orbit

_ROUNDS = 30
_GOAL = 1e-11  # seconds of the last step of Newton's method, whose error is far smaller as it converges quadratically
# Semi-axes of WGS 84, metres.
_EQUATORIAL, _POLAR = 6378137.0, 6356752.314245179


@dataclass(frozen=True, eq=False)
class Passages:
    """Passages of the sensor by N ground points; NaN where it never passes or does not look at them.

    Attributes
    ----------
    times : array (N,)
        Zero-Doppler times, seconds from the epoch of the scene.
    ranges : array (N,)
        Slant ranges, metres.
    positions, velocities, accelerations : array (N, 3)
        Of the sensor at these times; geocentric metres, seconds.
    """

    times: FloatArray
    ranges: FloatArray
    positions: FloatArray
    velocities: FloatArray
    accelerations: FloatArray

    def slopes(self, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives (N, 3) of the times and the ranges by the ground points (N, 3)."""
        line = xyz - self.positions
        change = _dot(line, self.accelerations) - _dot(self.velocities, self.velocities)
        return -self.velocities / change[:, None], line / self.ranges[:, None]


def passages(orbit: Orbit, xyz: FloatArray, side: int, start: float) -> Passages:
    """Passages by ground points, by Newton's method for the zero-Doppler time.

    Parameters
    ----------
    orbit : Orbit
    xyz : array (N, 3)
        Geocentric ground, metres.
    side : int
        1 where the sensor looks to the right of its flight, -1 to the left.
    start : float
        Time from which the search begins, seconds: the middle of the scene.
    """
    points = np.asarray(xyz, dtype=np.float64)
    times = np.full(len(points), start)
    found = np.full(len(points), np.nan)
    active = np.flatnonzero(np.isfinite(points).all(axis=1))
    for _ in range(_ROUNDS):
        if not len(active):
            break
        position, velocity, acceleration = orbit.at(times[active])
        line = points[active] - position
        change = _dot(line, acceleration) - _dot(velocity, velocity)
        with np.errstate(divide="ignore", invalid="ignore"):
            # Where the point is farther than the centre of the orbit's curvature, the sensor flies around it.
            step = np.where(change < 0.0, -_dot(line, velocity) / change, np.nan)
        times[active] += step
        good = orbit.within(times[active])
        done = good & (np.abs(step) < _GOAL)
        found[active[done]] = times[active[done]]
        active = active[good & ~done]
    seen = np.isfinite(found)
    position, velocity, acceleration = orbit.at(np.where(seen, found, start))
    line = points - position
    right = np.cross(velocity, position)
    with np.errstate(invalid="ignore"):
        # The mirror point on the other side of the track has the same range; behind the horizon nothing is seen.
        seen &= (side * _dot(line, right) > 0.0) & (_dot(line, points) < 0.0)
    hidden = ~seen[:, None]
    position, velocity, acceleration = (np.where(hidden, np.nan, a) for a in (position, velocity, acceleration))
    ranges = np.sqrt(_dot(points - position, points - position))
    return Passages(np.where(seen, found, np.nan), ranges, position, velocity, acceleration)


def ground_points(orbit: Orbit, times: FloatArray, ranges: FloatArray, side: int, height: float) -> FloatArray:
    """Ground points at a height that the sensor passes at given times and ranges.

    They are where the sphere of the range and the zero-Doppler plane meet the ellipsoid whose semi-axes are those of
    WGS 84 and the height: within some millimetres the surface of that ellipsoidal height.

    Parameters
    ----------
    orbit : Orbit
    times, ranges : array (N,)
        Seconds from the epoch of the scene, and metres.
    side : int
        As for `passages`.
    height : float
        Ellipsoidal, metres.

    Returns
    -------
    array (N, 3)
        Geocentric, metres; NaN where the range does not reach the ground.
    """
    position, velocity, _ = orbit.at(times)
    distance = np.linalg.norm(position, axis=1)
    up = position / distance[:, None]
    right = np.cross(velocity, up)
    right /= np.linalg.norm(right, axis=1)[:, None]
    axes = np.array([_EQUATORIAL, _EQUATORIAL, _POLAR]) + height
    # Start on a sphere with the radius of the ellipsoid below the sensor, by the law of cosines.
    radius = 1.0 / np.linalg.norm(up / axes, axis=1)
    cosine = (distance**2 + ranges**2 - radius**2) / (2.0 * distance * ranges)
    sine = np.sqrt(np.where(np.abs(cosine) < 1.0, 1.0 - cosine**2, np.nan))
    points: FloatArray = position + ranges[:, None] * (side * sine[:, None] * right - cosine[:, None] * up)
    for _ in range(12):
        line: FloatArray = points - position
        scaled = points / axes**2
        left = np.stack(
            [_dot(line, velocity), 0.5 * (_dot(line, line) - ranges**2), 0.5 * (_dot(points, scaled) - 1.0)], axis=1
        )
        matrix = np.stack([velocity, line, scaled], axis=1)
        good = np.asarray(np.isfinite(matrix).all(axis=(1, 2)))
        matrix[~good] = np.eye(3)
        step = np.linalg.solve(matrix, left[:, :, None])[:, :, 0]
        points = np.where(good[:, None], points - step, np.nan)
        if not (np.abs(step) > 1e-6).any():
            break
    return points


def ellipsoid_incidence(orbit: Orbit, times: FloatArray, ranges: FloatArray, side: int, height: float) -> FloatArray:
    """Angles (N,) between the line of sight and the normal of the ellipsoid, radians; see `ground_points`.

    Parameters
    ----------
    orbit : Orbit
    times, ranges : array (N,)
    side : int
    height : float
    """
    ground = ground_points(orbit, times, ranges, side, height)
    line = orbit.at(times)[0] - ground
    normal = ground / (np.array([_EQUATORIAL, _EQUATORIAL, _POLAR]) + height) ** 2
    return np.asarray(np.arccos(_dot(line, normal) / np.sqrt(_dot(line, line) * _dot(normal, normal))))


def _dot(one: FloatArray, other: FloatArray) -> FloatArray:
    out: FloatArray = np.einsum("ij,ij->i", one, other)
    return out
