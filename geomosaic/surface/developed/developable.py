"""Developable surfaces: plane, circular cylinder and circular cone, whose developments are exact.

u = R·θ is the length of the arc from the zero direction, v the length along the axis.

With s the distance from the apex along the surface and θ the angle about the axis from the zero direction,
u = s·sin(θ·sin α), v = −s·cos(θ·sin α): the apex lies at (0, 0), and the line of the zero direction runs straight down.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from geomosaic.surface.developed.base import Bounds, roots
from geomosaic.types import FloatArray


@dataclass(frozen=True)
class Flat:
    """The plane z' = 0 of its axes."""

    kind = "plane"

    @property
    def domain(self) -> Bounds:
        """All of it."""
        return -np.inf, -np.inf, np.inf, np.inf

    def point(self, uvh: FloatArray) -> FloatArray:
        """Developed (N, 3) to body axes (N, 3): the same."""
        return np.array(uvh, dtype=np.float64)

    def coordinates(self, xyz: FloatArray) -> FloatArray:
        """Body axes (N, 3) to developed (N, 3): the same."""
        return np.array(xyz, dtype=np.float64)

    def normal(self, xyz: FloatArray) -> FloatArray:
        """Normals (N, 3)."""
        return np.tile([0.0, 0.0, 1.0], (len(xyz), 1))

    def meetings(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """Distances (N, 2) along rays; the second is NaN."""
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = -origins[:, 2] / directions[:, 2]
        distance[~np.isfinite(distance)] = np.nan
        return np.column_stack([distance, np.full(len(distance), np.nan)])

    def to_dict(self) -> dict[str, Any]:
        """Kind as JSON values."""
        return {"kind": self.kind}


@dataclass(frozen=True)
class Cylinder:
    """A cylinder about z'.

    Attributes
    ----------
    radius : float
        Metres.
    """

    radius: float
    kind = "cylinder"

    @property
    def domain(self) -> Bounds:
        """One turn, cut opposite the zero direction."""
        return -np.pi * self.radius, -np.inf, np.pi * self.radius, np.inf

    def point(self, uvh: FloatArray) -> FloatArray:
        """Developed (N, 3) to body axes (N, 3); u goes on over the cut, turn after turn."""
        u, v, h = np.asarray(uvh, dtype=np.float64).T
        theta, out = u / self.radius, self.radius + h
        return np.column_stack([out * np.cos(theta), out * np.sin(theta), v])

    def coordinates(self, xyz: FloatArray) -> FloatArray:
        """Body axes (N, 3) to developed (N, 3)."""
        x, y, z = np.asarray(xyz, dtype=np.float64).T
        return np.column_stack([self.radius * np.arctan2(y, x), z, np.hypot(x, y) - self.radius])

    def normal(self, xyz: FloatArray) -> FloatArray:
        """Normals (N, 3)."""
        x, y, _ = np.asarray(xyz, dtype=np.float64).T
        with np.errstate(invalid="ignore"):
            out = np.hypot(x, y)
            return np.column_stack([x / out, y / out, np.zeros_like(x)])

    def meetings(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """Distances (N, 2) along rays."""
        o, d = origins[:, :2], directions[:, :2]
        return roots((d * d).sum(axis=1), (o * d).sum(axis=1), (o * o).sum(axis=1) - self.radius**2)

    def to_dict(self) -> dict[str, Any]:
        """Kind and sizes as JSON values."""
        return {"kind": self.kind, "radius": self.radius}


@dataclass(frozen=True)
class Cone:
    """A cone with its apex at the origin, open towards −z'.

    Attributes
    ----------
    half_angle : float
        Between axis and surface, radians, above 0 and below π/2.
    """

    half_angle: float
    kind = "cone"

    @property
    def domain(self) -> Bounds:
        """No bounds but those of its sector, beyond which `point` is NaN."""
        return -np.inf, -np.inf, np.inf, np.inf

    def point(self, uvh: FloatArray) -> FloatArray:
        """Developed (N, 3) to body axes (N, 3); NaN beyond the sector, which is cut opposite the zero direction."""
        u, v, h = np.asarray(uvh, dtype=np.float64).T
        sine, cosine = np.sin(self.half_angle), np.cos(self.half_angle)
        along, theta = np.hypot(u, v), np.arctan2(u, -v) / sine
        theta = np.where(np.abs(theta) <= np.pi * (1 + 1e-12), theta, np.nan)
        out = along * sine + h * cosine
        down = -along * cosine + h * sine + 0.0 * theta
        return np.column_stack([out * np.cos(theta), out * np.sin(theta), down])

    def coordinates(self, xyz: FloatArray) -> FloatArray:
        """Body axes (N, 3) to developed (N, 3); NaN where the apex is nearest."""
        x, y, z = np.asarray(xyz, dtype=np.float64).T
        sine, cosine, out = np.sin(self.half_angle), np.cos(self.half_angle), np.hypot(x, y)
        along = out * sine - z * cosine
        along = np.where(along >= 0.0, along, np.nan)
        turn = np.arctan2(y, x) * sine
        return np.column_stack([along * np.sin(turn), -along * np.cos(turn), out * cosine + z * sine + 0.0 * along])

    def normal(self, xyz: FloatArray) -> FloatArray:
        """Normals (N, 3); NaN on the axis."""
        x, y, _ = np.asarray(xyz, dtype=np.float64).T
        with np.errstate(invalid="ignore"):
            out = np.hypot(x, y) / np.cos(self.half_angle)
            return np.column_stack([x / out, y / out, np.sin(self.half_angle) + 0.0 * x])

    def meetings(self, origins: FloatArray, directions: FloatArray) -> FloatArray:
        """Distances (N, 2) along rays; crossings of the mirrored cone beyond the apex are NaN."""
        slope = np.tan(self.half_angle) ** 2
        weight = np.array([1.0, 1.0, -slope])
        found = roots(
            (directions**2 * weight).sum(axis=1),
            (origins * directions * weight).sum(axis=1),
            (origins**2 * weight).sum(axis=1),
        )
        with np.errstate(invalid="ignore"):
            found[origins[:, 2:] + found * directions[:, 2:] > 0.0] = np.nan
        return found

    def to_dict(self) -> dict[str, Any]:
        """Kind and sizes as JSON values."""
        return {"kind": self.kind, "half_angle_radians": self.half_angle}
