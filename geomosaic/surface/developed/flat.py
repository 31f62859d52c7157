"""The plane: a facade, a wall, a floor. u runs to the right as it is looked at, v up, both from its point."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from geomosaic.surface.developed.body import Bounds
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
