"""Lens modifiers: another centre of distortion, sensor axes that are not at right angles.

s is the principal point of symmetry, counted from the principal point in focal lengths, x right, y down.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geomosaic.types import BoolArray, FloatArray
from geomosaic_frame.distortion import Columns, Lens


@dataclass(frozen=True)
class OffCentre:
    """A perspective lens about another centre.

    Attributes
    ----------
    lens : Lens
        A perspective one: a shift of its image is a shear of the directions.
    centre : tuple of float
        s, in focal lengths.
    """

    lens: Lens
    centre: tuple[float, float]

    @property
    def edge(self) -> float:
        """Distorted radius up to which the polynomial is used as given; inf without end."""
        return self.lens.edge

    def project(self, x: FloatArray, y: FloatArray, z: FloatArray) -> Columns:
        """Camera axes in any unit to distorted (u, v); NaN where the lens cannot see."""
        u, v = self.lens.project(x - self.centre[0] * z, y - self.centre[1] * z, z)
        return u + self.centre[0], v + self.centre[1]

    def unproject(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Distorted (u, v) to a direction in camera axes, not normalised."""
        x, y, z = self.lens.unproject(u - self.centre[0], v - self.centre[1])
        return x + self.centre[0] * z, y + self.centre[1] * z, z

    def derivatives(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Derivatives of (u, v) by (x, y, z), (N, 2, 3)."""
        s, t = self.centre
        out = self.lens.derivatives(x - s * z, y - t * z, z).copy()
        out[:, :, 2] -= s * out[:, :, 0] + t * out[:, :, 1]
        return out

    def distort(self, xy: FloatArray) -> FloatArray:
        """Ideal (N, 2) to distorted (N, 2)."""
        return self.lens.distort(np.asarray(xy) - self.centre) + self.centre

    def undistort(self, xy: FloatArray) -> FloatArray:
        """Distorted (N, 2) to ideal (N, 2)."""
        return self.lens.undistort(np.asarray(xy) - self.centre) + self.centre

    def trusted(self, u: FloatArray, v: FloatArray) -> BoolArray:
        """Whether the polynomial is used there as given, not its continuation (N,)."""
        return self.lens.trusted(u - self.centre[0], v - self.centre[1])

    def for_corners(self, u: FloatArray, v: FloatArray) -> Lens:
        """Return the lens told how far the image reaches."""
        return replace(self, lens=self.lens.for_corners(u - self.centre[0], v - self.centre[1]))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {**self.lens.to_dict(), "centre": list(self.centre)}


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
