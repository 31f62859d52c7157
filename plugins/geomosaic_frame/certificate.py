"""Distortion as calibration certificates print it: corrections of the measured image, in millimetres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from geomosaic.types import BoolArray, FloatArray
from geomosaic_frame.distortion import Columns, Perspective
from geomosaic_frame.polynomial import Brown


@dataclass(frozen=True)
class Corrections(Perspective):
    """A model whose formula corrects the measured image: ideal = formula(distorted).

    Attributes
    ----------
    formula : Brown
        In units of the focal length, y down.
    """

    formula: Brown

    def __post_init__(self) -> None:
        object.__setattr__(self, "edge", self.formula.fold)

    @classmethod
    def photogrammetric(cls, k: tuple[float, float, float], p: tuple[float, float], focal: float) -> Corrections:
        """Brown's corrections as calibration certificates print them, in mm, y UP, added to the measured coordinates.

            Δx = x·(k1·r² + k2·r⁴ + k3·r⁶) + p1·(r² + 2x²) + 2·p2·x·y
            Δy = y·(k1·r² + k2·r⁴ + k3·r⁶) + 2·p1·x·y + p2·(r² + 2y²)

        with x, y from the principal point (Luhmann et al., Close-Range Photogrammetry, 3.3).

        Parameters
        ----------
        k : tuple of float
            mm⁻², mm⁻⁴, mm⁻⁶.
        p : tuple of float
            mm⁻¹.
        focal : float
            mm.
        """
        k1, k2, k3 = k[0] * focal**2, k[1] * focal**4, k[2] * focal**6
        # y = −v turns the signs of what goes with an odd power of y; the place of p1 and p2 differs from OpenCV's.
        return cls(Brown(k1, k2, k3, p1=-p[1] * focal, p2=p[0] * focal))

    def _distort(self, x: FloatArray, y: FloatArray) -> Columns:
        return self.formula._undistort(x, y)

    def _undistort(self, u: FloatArray, v: FloatArray) -> Columns:
        return self.formula._distort(u, v)

    def _slopes(self, x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        xu, xv, yu, yv = self.formula._slopes(*self.formula._undistort(x, y))
        det = xu * yv - xv * yu
        return yv / det, -xv / det, -yu / det, xu / det

    def trusted(self, u: FloatArray, v: FloatArray) -> BoolArray:
        """Whether the polynomial is used there as given, not its continuation (N,)."""
        inside: BoolArray = np.hypot(u, v) <= self.formula.fold
        return inside

    def for_corners(self, u: FloatArray, v: FloatArray) -> Self:
        """Return itself."""
        return self

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {"model": "corrections", "formula": self.formula.to_dict()}
