"""Ellipsoids: of revolution and sphere with five developments, and the ellipsoid whose three axes all differ.

| projection | u, v | keeps |
|---|---|---|
| equidistant | a·θ, arc of the meridian from the equator | lengths along meridians and along the equator |
| equal-area | a·θ, q (`meridian`) | areas |
| dome-equidistant | ρ·(cos θ, sin θ), ρ the arc from the pole | lengths along meridians: distances from the pole |
| dome-equal-area | the same, ρ = √(2·a·(q(pole) − q)) | areas |
| dome-plan | the same, ρ = a·cos β | the plan: what lies above one another is one place; upper half only |

β is the parametric latitude: the meridian is (a·cos β, c·sin β). The length of the arc from the equator is the elliptic
integral c·E(β | 1 − a²/c²); the area between the equator and β is 2π·a·q, q = ∫ √(c² + (a² − c²)·s²) ds to s = sin β.

Its parallels are no circles, and lengths of its meridians differ, so that of the projections of `ellipsoid.py` only the
plan is defined on it: u = x', v = y' of the upper half, seen along z'.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from geomosaic.surface.developed.primitives import Bounds, roots
from geomosaic.types import FloatArray


def arc(latitude: FloatArray, a: float, c: float) -> FloatArray:
    """Length of the meridian from the equator.

    Parameters
    ----------
    latitude : array (N,)
        Parametric latitudes, radians.
    a, c : float
        Semi-axes across and along the axis of revolution, metres.

    Returns
    -------
    array (N,)
        Metres, south negative.
    """
    if a == c:
        return a * np.asarray(latitude, dtype=np.float64)
    from scipy.special import ellipeinc

    length: FloatArray = c * ellipeinc(latitude, 1.0 - (a / c) ** 2)
    return length


def latitude_of_arc(length: FloatArray, a: float, c: float) -> FloatArray:
    """Parametric latitudes at lengths of the meridian, the inverse of `arc` by Newton's rule.

    Parameters
    ----------
    length : array (N,)
        Metres from the equator.
    a, c : float
        Semi-axes across and along the axis of revolution, metres.

    Returns
    -------
    array (N,)
        Radians; NaN beyond the poles.
    """
    quarter = float(arc(np.array(np.pi / 2), a, c))
    # What is beyond the pole by rounding alone is the pole.
    given = np.where(np.abs(length) <= quarter * (1 + 1e-12), np.clip(length, -quarter, quarter), np.nan)
    latitude = given * (np.pi / 2 / quarter)
    for _ in range(0 if a == c else 12):
        slope = np.hypot(a * np.sin(latitude), c * np.cos(latitude))
        latitude = np.clip(latitude - (arc(latitude, a, c) - given) / slope, -np.pi / 2, np.pi / 2)
    return latitude


def area(sine: FloatArray, a: float, c: float) -> FloatArray:
    """Area of the zone between the equator and a parallel, divided by 2π·a.

    Parameters
    ----------
    sine : array (N,)
        Sines of parametric latitudes.
    a, c : float
        Semi-axes across and along the axis of revolution, metres.

    Returns
    -------
    array (N,)
        q in metres, south negative.
    """
    s = np.asarray(sine, dtype=np.float64)
    root = np.sqrt(c * c + (a * a - c * c) * s * s)
    k = np.sqrt(abs(a * a - c * c))
    if k * k < 1e-14 * a * c:  # a sphere, to rounding
        return s * root
    tail = (np.arcsinh if a > c else np.arcsin)(k * s / c)
    q: FloatArray = (s * root + c * c / k * tail) / 2
    return q


def sine_of_area(q: FloatArray, a: float, c: float) -> FloatArray:
    """Sines of parametric latitudes at which `area` is q, its inverse by Newton's rule.

    Parameters
    ----------
    q : array (N,)
        Metres.
    a, c : float
        Semi-axes across and along the axis of revolution, metres.

    Returns
    -------
    array (N,)
        NaN beyond the poles.
    """
    most = float(area(np.array(1.0), a, c))
    given = np.where(np.abs(q) <= most * (1 + 1e-12), np.clip(q, -most, most), np.nan)
    sine = given / most
    for _ in range(12):
        slope = np.sqrt(c * c + (a * a - c * c) * sine * sine)
        sine = np.clip(sine - (area(sine, a, c) - given) / slope, -1.0, 1.0)
    return sine


# Names, and what each keeps.
PROJECTIONS = {
    "equidistant": "lengths along meridians and the equator are true",
    "equal-area": "areas are true",
    "dome-equidistant": "lengths along meridians are true",
    "dome-equal-area": "areas are true",
    "dome-plan": "the plan is true",
}


@dataclass(frozen=True)
class Ellipsoid:
    """An ellipsoid of revolution about z', centred at the origin; a sphere where both semi-axes are alike.

    Attributes
    ----------
    across, along : float
        Semi-axes across and along z', metres.
    projection : str
        One of `PROJECTIONS`.
    """

    across: float
    along: float
    projection: str

    @property
    def kind(self) -> str:
        """'sphere' or 'ellipsoid'."""
        return "sphere" if self.across == self.along else "ellipsoid"

    @property
    def domain(self) -> Bounds:
        """Of the whole surface; a disc lies within its square."""
        a, c = self.across, self.along
        if not self.projection.startswith("dome"):
            top = float(
                arc(np.array(np.pi / 2), a, c) if self.projection == "equidistant" else area(np.array(1.0), a, c)
            )
            return -np.pi * a, -top, np.pi * a, top
        low = 0.0 if self.projection == "dome-plan" else -np.pi / 2
        reach = float(self._from_pole(np.array(low)))
        return -reach, -reach, reach, reach

    def point(self, uvh: FloatArray) -> FloatArray:
        """Developed (N, 3) to body axes (N, 3); NaN beyond the poles or the rim."""
        u, v, h = np.asarray(uvh, dtype=np.float64).T
        theta, sine, cosine = self._place(u, v)
        out, up = self._normal(sine, cosine)
        radius = self.across * cosine + h * out
        return np.column_stack([radius * np.cos(theta), radius * np.sin(theta), self.along * sine + h * up])

    def coordinates(self, xyz: FloatArray) -> FloatArray:
        """Primitive axes (N, 3) to developed (N, 3); NaN near the middle; no place below the equator in a plan."""
        x, y, z = np.asarray(xyz, dtype=np.float64).T
        p, theta = np.hypot(x, y), np.arctan2(y, x)
        latitude = self._latitude(p, z)
        out, up = self._normal(np.sin(latitude), np.cos(latitude))
        h = (p - self.across * np.cos(latitude)) * out + (z - self.along * np.sin(latitude)) * up
        a, c = self.across, self.along
        if self.projection == "equidistant":
            return np.column_stack([a * theta, arc(latitude, a, c), h])
        if self.projection == "equal-area":
            return np.column_stack([a * theta, area(np.sin(latitude), a, c), h])
        radius = self._from_pole(latitude)
        if self.projection == "dome-plan":
            radius = np.where(latitude >= 0.0, radius, np.nan)
        return np.column_stack([radius * np.cos(theta), radius * np.sin(theta), h])

    def normal(self, xyz: FloatArray) -> FloatArray:
        """Normals (N, 3)."""
        x, y, z = np.asarray(xyz, dtype=np.float64).T
        latitude, theta = self._latitude(np.hypot(x, y), z), np.arctan2(y, x)
        out, up = self._normal(np.sin(latitude), np.cos(latitude))
        return np.column_stack([out * np.cos(theta), out * np.sin(theta), up])

    def meetings(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """Distances (N, 2) along rays."""
        axes = np.array([self.across, self.across, self.along])
        o, d = origins / axes, directions / axes
        return roots((d * d).sum(axis=1), (o * d).sum(axis=1), (o * o).sum(axis=1) - 1.0)

    def to_dict(self) -> dict[str, Any]:
        """Kind and sizes as JSON values."""
        return {"kind": "ellipsoid", "semi_axes": [self.across, self.along], "projection": self.projection}

    def _normal(self, sine: FloatArray, cosine: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Outward unit normal across and along the axis, at parametric latitudes."""
        out, up = self.along * cosine, self.across * sine
        length = np.hypot(out, up)
        return out / length, up / length

    def _place(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """θ, and sine and cosine of the parametric latitude, of developed places."""
        a, c = self.across, self.along
        if self.projection == "equidistant":
            latitude = latitude_of_arc(v, a, c)
            return u / a, np.sin(latitude), np.cos(latitude)
        if self.projection == "equal-area":
            sine = sine_of_area(v, a, c)
            return u / a, sine, np.sqrt((1.0 - sine) * (1.0 + sine))
        radius, theta = np.hypot(u, v), np.arctan2(v, u)
        if self.projection == "dome-plan":
            cosine = radius / a
            with np.errstate(invalid="ignore"):
                return theta, np.sqrt((1.0 - cosine) * (1.0 + cosine)), cosine
        if self.projection == "dome-equidistant":
            latitude = latitude_of_arc(float(arc(np.array(np.pi / 2), a, c)) - radius, a, c)
            return theta, np.sin(latitude), np.cos(latitude)
        sine = sine_of_area(float(area(np.array(1.0), a, c)) - radius**2 / (2.0 * a), a, c)
        return theta, sine, np.sqrt((1.0 - sine) * (1.0 + sine))

    def _from_pole(self, latitude: FloatArray) -> FloatArray:
        """Radius in the development of a dome."""
        a, c = self.across, self.along
        if self.projection == "dome-plan":
            return a * np.cos(latitude)
        if self.projection == "dome-equidistant":
            return arc(np.array(np.pi / 2), a, c) - arc(latitude, a, c)
        left = np.maximum(area(np.array(1.0), a, c) - area(np.sin(latitude), a, c), 0.0)
        return np.sqrt(2.0 * a * left)

    def _latitude(self, p: FloatArray, z: FloatArray) -> FloatArray:
        """Parametric latitude of the feet of points, by Newton's method on the distance from the meridian."""
        a, c = self.across, self.along
        latitude = np.arctan2(a * z, c * p)
        if a == c:
            return latitude
        for _ in range(50):
            sine, cosine = np.sin(latitude), np.cos(latitude)
            value = (a * a - c * c) * sine * cosine - p * a * sine + z * c * cosine
            slope = (a * a - c * c) * (cosine**2 - sine**2) - p * a * cosine - z * c * sine
            with np.errstate(invalid="ignore", divide="ignore"):
                step = np.clip(np.where(slope < 0.0, value / slope, np.nan), -0.5, 0.5)
            latitude = np.clip(latitude - step, -np.pi / 2, np.pi / 2)
            if not (np.abs(step) > 1e-15).any():
                break
        return latitude


PLAN = "dome-plan"
_BISECTIONS, _NEWTON = 60, 4


@dataclass(frozen=True)
class Triaxial:
    """An ellipsoid centred at the origin.

    Attributes
    ----------
    semi_axes : tuple of float
        Along x' (the zero direction), y' and z', metres.
    """

    semi_axes: tuple[float, float, float]
    kind = "ellipsoid"

    @property
    def domain(self) -> Bounds:
        """Of the plan; an oval lies within its rectangle."""
        a, b, _ = self.semi_axes
        return -a, -b, a, b

    def point(self, uvh: FloatArray) -> FloatArray:
        """Developed (N, 3) to body axes (N, 3); NaN beyond the rim."""
        u, v, h = np.asarray(uvh, dtype=np.float64).T
        a, b, c = self.semi_axes
        with np.errstate(invalid="ignore"):
            foot = np.column_stack([u, v, c * np.sqrt(1.0 - (u / a) ** 2 - (v / b) ** 2)])
        return np.asarray(foot + h[:, None] * self._outward(foot))

    def coordinates(self, xyz: FloatArray) -> FloatArray:
        """Primitive axes (N, 3) to developed (N, 3); NaN where the lower half is nearest."""
        points = np.asarray(xyz, dtype=np.float64)
        foot = self._foot(points)
        h = ((points - foot) * self._outward(foot)).sum(axis=1)
        foot[foot[:, 2] < 0.0] = np.nan
        return np.column_stack([foot[:, 0], foot[:, 1], h + 0.0 * foot[:, 2]])

    def normal(self, xyz: FloatArray) -> FloatArray:
        """Normals (N, 3)."""
        return self._outward(self._foot(np.asarray(xyz, dtype=np.float64)))

    def meetings(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """Distances (N, 2) along rays."""
        axes = np.array(self.semi_axes)
        o, d = origins / axes, directions / axes
        return roots((d * d).sum(axis=1), (o * d).sum(axis=1), (o * o).sum(axis=1) - 1.0)

    def to_dict(self) -> dict[str, Any]:
        """Kind and sizes as JSON values."""
        return {"kind": self.kind, "semi_axes": list(self.semi_axes), "projection": PLAN}

    def _outward(self, foot: FloatArray) -> FloatArray:
        """Unit gradients (N, 3) of Σ (xᵢ/aᵢ)² at points of the surface."""
        gradient = foot / np.array(self.semi_axes) ** 2
        with np.errstate(invalid="ignore"):
            return np.asarray(gradient / np.linalg.norm(gradient, axis=1)[:, None])

    def _foot(self, points: FloatArray) -> FloatArray:
        """Nearest points (N, 3) of the surface."""
        # xᵢ = pᵢ·aᵢ² / (aᵢ² + t), where Σ (pᵢ·aᵢ / (aᵢ² + t))² = 1. From t = −min aᵢ² upwards that sum falls; its root
        # is bracketed, halved, and made exact by Newton's method (Eberly, Distance from a Point to an Ellipse, an
        # Ellipsoid, or a Hyperellipsoid, 2013).
        axes = np.array(self.semi_axes)
        weight = points * axes
        low = -(float(axes.min()) ** 2) + np.abs(weight[:, int(axes.argmin())])
        high = -(float(axes.min()) ** 2) + np.linalg.norm(weight, axis=1)

        def excess(t: FloatArray) -> FloatArray:
            with np.errstate(divide="ignore", invalid="ignore"):
                return np.asarray(((weight / (axes**2 + t[:, None])) ** 2).sum(axis=1) - 1.0)

        for _ in range(_BISECTIONS):
            t = 0.5 * (low + high)
            over = excess(t) > 0.0
            low, high = np.where(over, t, low), np.where(over, high, t)
        t = 0.5 * (low + high)
        for _ in range(_NEWTON):
            with np.errstate(divide="ignore", invalid="ignore"):
                slope = -2.0 * (weight**2 / (axes**2 + t[:, None]) ** 3).sum(axis=1)
                step = excess(t) / slope
            t = np.where(np.isfinite(step), t - step, t)
        with np.errstate(divide="ignore", invalid="ignore"):
            foot: FloatArray = points * axes**2 / (axes**2 + t[:, None])
        return foot
