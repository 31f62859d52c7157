"""The ellipsoid whose three axes all differ: a dome over an oval, in plan.

Its parallels are no circles, and lengths of its meridians differ, so that of the projections of `ellipsoid.py` only the
plan is defined on it: u = x', v = y' of the upper half, seen along z'.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from geomosaic.surface.developed.base import Bounds, roots
from geomosaic.types import FloatArray

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
        """Body axes (N, 3) to developed (N, 3); NaN where the lower half is nearest."""
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
        """Nearest points (N, 3) of the surface.

        xᵢ = pᵢ·aᵢ² / (aᵢ² + t), where Σ (pᵢ·aᵢ / (aᵢ² + t))² = 1. From t = −min aᵢ² upwards that sum falls; its root is
        bracketed, halved, and made exact by Newton's method (Eberly, Distance from a Point to an Ellipse, an Ellipsoid,
        or a Hyperellipsoid, 2013).
        """
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
