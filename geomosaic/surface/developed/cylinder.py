"""The circular cylinder: a tower, a silo, a column. Its development is exact, all lengths on it are true.

u = R·θ is the length of the arc from the zero direction, v the length along the axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from geomosaic.surface.developed.body import Bounds, roots
from geomosaic.types import FloatArray


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
