"""Rays that are not straight in the model's axes: atmospheric refraction, and the Earth's curvature in map coordinates.

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

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from geomosaic.types import FloatArray

Columns = tuple[FloatArray, FloatArray, FloatArray]

GLADSTONE_DALE = 2.26e-4
"""(n − 1)/ρ of air in the middle of the visible light, m³/kg."""
GRAVITY = 9.80665
STEEPEST = float(np.tan(np.radians(80.0)) ** 2)
"""tan² of the nadir angle beyond which the correction is that at 80°: neither formula holds near the horizon."""


def refraction_constant(height: float, ground: float) -> float:
    """K of the standard atmosphere in radians: the angle by which a ray 45° from the nadir is seen too far out.

    Parameters
    ----------
    height, ground : float
        Of camera and ground above sea level in metres, up to 20 km. Heights above the ellipsoid do as well: 50 m are
        0.5 µrad at most.
    """
    (above, density), (below, _) = _atmosphere(height), _atmosphere(ground)
    return GLADSTONE_DALE * ((below - above) / (GRAVITY * (height - ground)) - density)


def _atmosphere(height: float) -> tuple[float, float]:
    """Pressure in Pa and density in kg/m³ of the ICAO standard atmosphere, from the sea to 20 km."""
    base = 1.0 - 2.25577e-5 * min(height, 11000.0)
    thin = float(np.exp(-max(height - 11000.0, 0.0) / 6341.62))
    return 101325.0 * base**5.25588 * thin, 1.225 * base**4.25588 * thin


def refraction_shift(radius: FloatArray, constant: float, height: float, ground: float) -> FloatArray:
    """By how much refraction moves a point of a vertical photo outwards, in micrometres.

    Parameters
    ----------
    radius : array
        Distance from the principal point in mm.
    constant : float
        Camera constant in mm.
    height, ground : float
        Of camera and ground above sea level in metres.
    """
    r = np.asarray(radius, dtype=np.float64)
    shift: FloatArray = 1000.0 * refraction_constant(height, ground) * (r + r**3 / constant**2)
    return shift


def curvature_shift(radius: FloatArray, constant: float, above: float, earth: float) -> FloatArray:
    """By how much the Earth's curvature moves a point of a vertical photo inwards, in micrometres.

    Parameters
    ----------
    radius : array
        Distance from the principal point in mm.
    constant : float
        Camera constant in mm.
    above : float
        Flying height above ground in metres.
    earth : float
        Radius of the Earth in metres.
    """
    r = np.asarray(radius, dtype=np.float64)
    shift: FloatArray = 1000.0 * above * r**3 / (2.0 * earth * constant**2)
    return shift


@dataclass(frozen=True)
class Bending:
    """Map of directions in east, north, up (or map axes) about the vertical through the camera.

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
        """Return q and dq/dt at t = tan²α; beyond 80° both stay."""
        capped = np.minimum(t, STEEPEST)
        top, bottom = 1.0 + self.refraction * (1.0 + capped), 1.0 + self.curvature * capped
        slope = (self.refraction * bottom - self.curvature * top) / bottom**2
        return top / bottom, np.where(t < STEEPEST, slope, 0.0)

    def seen(self, east: FloatArray, north: FloatArray, up: FloatArray) -> Columns:
        """Vectors from the camera to the ground, (N,) each, to the directions in which they are seen."""
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
        """Derivatives of `seen` by (east, north, up), (N, 3, 3)."""
        t = _tangent_squared(east, north, up)
        q, slope = self._factor(t)
        with np.errstate(divide="ignore", invalid="ignore"):
            by = np.column_stack([2.0 * east / up**2, 2.0 * north / up**2, -2.0 * t / up]) * slope[:, None]
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
        """Rebuild from `to_dict`; a state without either is straight."""
        return cls(float(state.get("refraction", 0.0)), float(state.get("curvature", 0.0)))


def _tangent_squared(east: FloatArray, north: FloatArray, up: FloatArray) -> FloatArray:
    """tan² of the angle from the vertical, cut where it exceeds anything that matters; NaN of NaN."""
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        t = (east**2 + north**2) / up**2
    return np.minimum(np.where(up == 0.0, np.inf, t), 1e6 * STEEPEST)
