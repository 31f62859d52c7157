"""A lens before a sensor whose axes are not at right angles: u' = u + shear·v (Metashape's b2)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geomosaic.types import BoolArray, FloatArray
from geomosaic_frame.distortion import Columns, Lens


@dataclass(frozen=True)
class Sheared:
    """A lens and the shear behind it.

    Attributes
    ----------
    lens : Lens
    shear : float
        Of u per v, without unit.
    """

    lens: Lens
    shear: float

    @property
    def edge(self) -> float:
        """Distorted radius up to which the polynomial is used as given; inf without end."""
        return self.lens.edge

    def project(self, x: FloatArray, y: FloatArray, z: FloatArray) -> Columns:
        """Camera axes in any unit to distorted (u, v); NaN where the lens cannot see."""
        u, v = self.lens.project(x, y, z)
        return u + self.shear * v, v

    def unproject(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Distorted (u, v) to a direction in camera axes, not normalised."""
        return self.lens.unproject(u - self.shear * v, v)

    def derivatives(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Derivatives of (u, v) by (x, y, z), (N, 2, 3)."""
        out = self.lens.derivatives(x, y, z).copy()
        out[:, 0] += self.shear * out[:, 1]
        return out

    def distort(self, xy: FloatArray) -> FloatArray:
        """Ideal (N, 2) to distorted (N, 2)."""
        out: FloatArray = self.lens.distort(xy) @ np.array([[1.0, 0.0], [self.shear, 1.0]])
        return out

    def undistort(self, xy: FloatArray) -> FloatArray:
        """Distorted (N, 2) to ideal (N, 2)."""
        return self.lens.undistort(np.asarray(xy) @ np.array([[1.0, 0.0], [-self.shear, 1.0]]))

    def trusted(self, u: FloatArray, v: FloatArray) -> BoolArray:
        """Whether the polynomial is used there as given, not its continuation (N,)."""
        return self.lens.trusted(u - self.shear * v, v)

    def for_corners(self, u: FloatArray, v: FloatArray) -> Lens:
        """Return the lens told how far the image reaches."""
        return replace(self, lens=self.lens.for_corners(u - self.shear * v, v))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {**self.lens.to_dict(), "shear": self.shear}
