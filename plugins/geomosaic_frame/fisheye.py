"""Equidistant fisheye lens of OpenCV (`cv::fisheye`) and OpenSfM (`fisheye`, `fisheye_opencv`).

    θ = angle from the axis,  θ_d = θ·(1 + k1·θ² + k2·θ⁴ + k3·θ⁶ + k4·θ⁸),  (u, v) = θ_d · (x, y) / √(x² + y²)

(Kannala and Brandt 2006.) Angles of 90 degrees and more are seen. Beyond the angle where the polynomial would turn it
goes on linearly (`distortion.fold_radius`); beyond what the image can show, with a margin, directions are not seen at
all, so that nothing right behind the camera is taken for a neighbour of everything around it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np

from geomosaic.types import BoolArray, FloatArray
from geomosaic_frame.distortion import Columns, NamedCoefficients, fold_radius

# Right behind the camera a direction has no azimuth, and all around it would fall on one ring of the image.
WIDEST = float(np.radians(179.0))
ROUNDS = 50
TABLE = 257


@dataclass(frozen=True)
class Fisheye(NamedCoefficients):
    """Equidistant fisheye with four coefficients.

    Attributes
    ----------
    k1, k2, k3, k4 : float
        Of θ², θ⁴, θ⁶, θ⁸; θ in radians.
    limit : float
        Largest angle from the axis that is seen, radians; follows from the image's corners.
    fold : float
        Angle beyond which the polynomial goes on linearly, radians.
    edge : float
        Distorted radius at `fold`.
    """

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    limit: float = field(default=WIDEST, compare=False)
    fold: float = field(init=False, repr=False, compare=False, default=np.inf)

    names = ("k1", "k2", "k3", "k4")

    def __post_init__(self) -> None:
        object.__setattr__(self, "fold", fold_radius((self.k1, self.k2, self.k3, self.k4)))

    @property
    def edge(self) -> float:
        """Distorted radius up to which the polynomial is used as given."""
        return float(self._polynomial(np.array([self.fold]))[0]) if np.isfinite(self.fold) else float("inf")

    def _polynomial(self, t: FloatArray) -> FloatArray:
        s = t * t
        return t * (1.0 + s * (self.k1 + s * (self.k2 + s * (self.k3 + s * self.k4))))

    def _polynomial_slope(self, t: FloatArray) -> FloatArray:
        s = t * t
        return 1.0 + s * (3 * self.k1 + s * (5 * self.k2 + s * (7 * self.k3 + s * 9 * self.k4)))

    def _radius(self, angle: FloatArray) -> FloatArray:
        """θ_d of θ, continued."""
        near = np.minimum(angle, self.fold)
        radius = self._polynomial(near)
        far = angle > self.fold
        if far.any():
            radius[far] += self._polynomial_slope(near[far]) * (angle[far] - self.fold)
        return radius

    def _slope(self, angle: FloatArray) -> FloatArray:
        """Derivative of θ_d by θ, continued."""
        return self._polynomial_slope(np.minimum(angle, self.fold))

    def _angle(self, radius: FloatArray) -> FloatArray:
        """θ of θ_d by Newton's method from a table; not limited."""
        top = float(np.max(radius, initial=0.0, where=np.isfinite(radius)))
        last = 1.0
        while last < 1e6 and self._radius(np.array([last]))[0] < top:
            last *= 2.0
        angles = np.linspace(0.0, last, TABLE)
        # A start from a table, near enough for Newton's method to stay on the rising branch.
        angle = np.interp(radius, self._radius(angles), angles)
        angle[~np.isfinite(radius)] = np.nan
        for _ in range(ROUNDS):
            step = (radius - self._radius(angle)) / self._slope(angle)
            angle = angle + step
            if not (np.abs(step) > 2e-15 * (1.0 + angle)).any():
                break
        return angle

    def project(self, x: FloatArray, y: FloatArray, z: FloatArray) -> Columns:
        """Camera axes (N,) to distorted u, v (N,); NaN beyond the limit."""
        r = np.hypot(x, y)
        angle = np.arctan2(r, z)
        angle[angle > self.limit] = np.nan
        scale = self._radius(angle) / np.maximum(r, 1e-300)
        return x * scale, y * scale

    def unproject(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Distorted u, v (N,) to a unit direction x, y, z (N,); NaN beyond the limit."""
        radius = np.hypot(u, v)
        angle = self._angle(radius)
        angle[angle > self.limit] = np.nan
        scale = np.sin(angle) / np.maximum(radius, 1e-300)
        return u * scale, v * scale, np.cos(angle)

    def derivatives(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Derivatives of (u, v) by (x, y, z), (N, 2, 3)."""
        r2 = x * x + y * y
        r, rho2 = np.sqrt(r2), r2 + z * z
        angle = np.arctan2(r, z)
        angle[angle > self.limit] = np.nan
        slope = self._slope(angle)
        scale = self._radius(angle) / np.maximum(r, 1e-300)
        axis = r2 <= 1e-20 * rho2  # on the axis the scale is 1 / z and flat
        scale = np.where(axis, 1.0 / np.where(axis, z, 1.0), scale)
        turn = np.where(axis, 0.0, (slope * z / rho2 - scale) / np.where(axis, 1.0, r2))
        out = np.empty((len(x), 2, 3))
        out[:, 0, 0], out[:, 0, 1], out[:, 0, 2] = scale + x * x * turn, x * y * turn, -x * slope / rho2
        out[:, 1, 0], out[:, 1, 1], out[:, 1, 2] = x * y * turn, scale + y * y * turn, -y * slope / rho2
        out[np.isnan(angle)] = np.nan
        return out

    def by_coefficients(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Derivatives of (u, v) by the K coefficients, (N, 2, K)."""
        r = np.hypot(x, y)
        angle = np.arctan2(r, z)
        angle[angle > self.limit] = np.nan
        near = np.minimum(angle, self.fold)
        beyond = angle - near
        powers = np.arange(3, 3 + 2 * len(self.names), 2)
        # As in the polynomial lenses the fold is held.
        by_radius = near[:, None] ** powers + powers * near[:, None] ** (powers - 1) * beyond[:, None]
        azimuth = np.column_stack([x, y]) / np.maximum(r, 1e-300)[:, None]
        slopes: FloatArray = azimuth[:, :, None] * by_radius[:, None, :]
        return slopes

    def in_calibrated_range(self, u: FloatArray, v: FloatArray) -> BoolArray:
        """Whether the polynomial is used there as given, not its continuation (N,)."""
        return self._angle(np.hypot(u, v)) <= self.fold

    def for_corners(self, u: FloatArray, v: FloatArray) -> Self:
        """Lens with its limit at the farthest corner, and a quarter more."""
        widest = float(np.max(self._angle(np.hypot(u, v))))
        return replace(self, limit=min(WIDEST, 1.25 * widest + 0.1))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {"model": "fisheye", "k1": self.k1, "k2": self.k2, "k3": self.k3, "k4": self.k4}
