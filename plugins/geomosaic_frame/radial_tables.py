"""Radial distortion of calibration certificates: tables and polynomials, in millimetres.

Both give g(r), the millimetres to be added to the radius of a measured image point, and go on linearly where the table
ends or the polynomial starts to run away.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Protocol, Self

import numpy as np

from geomosaic.types import BoolArray, FloatArray
from geomosaic_frame.distortion import Columns, Perspective, Slopes, inverse_slopes
from geomosaic_frame.polynomial import Brown

# |dg/dr| up to which a polynomial is used.
STRAIGHT = 0.2


class Radial(Protocol):
    """Correction of a radius in mm."""

    @property
    def end(self) -> float:
        """Radius in mm from which on the correction goes on linearly; inf without end."""

    def correction(self, r: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distortion g in mm and dg/dr at radii (N,) in mm."""

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""


@dataclass(frozen=True)
class RadialTable:
    """Radial distortion at tabulated radii, with a cubic spline between them.

    The spline is odd, g(−r) = −g(r), as the correction of a lens is, and one cubic over the last two intervals
    (not-a-knot): the correction of a lens is bent where its table ends, which a natural spline is not.

    Attributes
    ----------
    radii : tuple of float
        mm, rising; without 0.
    values : tuple of float
        mm, to be added to the measured radius.
    """

    radii: tuple[float, ...]
    values: tuple[float, ...]
    _x: FloatArray = field(init=False, repr=False, compare=False)
    _y: FloatArray = field(init=False, repr=False, compare=False)
    _bend: FloatArray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        x, y = np.array([0.0, *self.radii]), np.array([0.0, *self.values])
        h = np.diff(x)
        rise = np.diff(y) / h
        # Second derivatives of the spline; 0 in the middle of an odd function.
        system, right = np.eye(len(x)), np.zeros(len(x))
        for i in range(1, len(x) - 1):
            system[i, i - 1 : i + 2] = h[i - 1], 2.0 * (h[i - 1] + h[i]), h[i]
            right[i] = 6.0 * (rise[i] - rise[i - 1])
        if len(h) > 1:
            system[-1, -3:] = h[-1], -(h[-1] + h[-2]), h[-2]
        for name, value in (("_x", x), ("_y", y), ("_bend", np.linalg.solve(system, right))):
            object.__setattr__(self, name, value)

    @property
    def end(self) -> float:
        """Last radius of the table in mm."""
        return self.radii[-1]

    def correction(self, r: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distortion g in mm and dg/dr at radii (N,) in mm."""
        x, y, bend = self._x, self._y, self._bend
        inside = np.minimum(r, self.end)
        i = np.clip(np.searchsorted(x, np.nan_to_num(inside)) - 1, 0, len(x) - 2)
        h = x[i + 1] - x[i]
        a, b = (x[i + 1] - inside) / h, (inside - x[i]) / h
        g = a * y[i] + b * y[i + 1] + ((a**3 - a) * bend[i] + (b**3 - b) * bend[i + 1]) * h**2 / 6.0
        slope = (y[i + 1] - y[i]) / h + ((3.0 * b**2 - 1.0) * bend[i + 1] - (3.0 * a**2 - 1.0) * bend[i]) * h / 6.0
        return g + slope * (r - inside), slope

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {"kind": "table", "radii": list(self.radii), "values": list(self.values)}


@dataclass(frozen=True)
class RadialPolynomial:
    """Radial distortion g(r) = k0·r + k1·r³ + k2·r⁵ + ..., in mm.

    Attributes
    ----------
    k : tuple of float
        k0 without unit, k1 in mm⁻², k2 in mm⁻⁴, ...
    """

    k: tuple[float, ...]
    _end: float = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        r = np.geomspace(1e-2, 1e5, 4001)
        # Radii of all cameras and far beyond, 0.01 mm to 100 m, in equal ratios: a fold may lie at any of them.
        wild = np.abs(self._polynomial(r)[1]) > STRAIGHT
        object.__setattr__(self, "_end", float(r[np.argmax(wild)]) if wild.any() else np.inf)

    def _polynomial(self, r: FloatArray) -> tuple[FloatArray, FloatArray]:
        u = r * r
        total, slope = np.zeros_like(r), np.zeros_like(r)
        for power in range(len(self.k) - 1, -1, -1):
            total = total * u + self.k[power]
            slope = slope * u + (2 * power + 1) * self.k[power]
        return total * r, slope

    @property
    def end(self) -> float:
        """Radius in mm beyond which the polynomial is not used."""
        return self._end

    def correction(self, r: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Distortion g in mm and dg/dr at radii (N,) in mm."""
        inside = np.minimum(r, self._end)
        g, slope = self._polynomial(inside)
        return (g + slope * (r - inside) if np.isfinite(self._end) else g), slope

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {"kind": "polynomial", "k": list(self.k)}


def radial_from_dict(state: Mapping[str, Any]) -> Radial:
    """Radial distortion of a saved state.

    Parameters
    ----------
    state : mapping
        As `to_dict` of a table or polynomial gives it.
    """
    if state["kind"] == "table":
        return RadialTable(tuple(state["radii"]), tuple(state["values"]))
    return RadialPolynomial(tuple(state["k"]))


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

    def _slopes(self, x: FloatArray, y: FloatArray) -> Slopes:
        return inverse_slopes(self.formula._slopes(*self.formula._undistort(x, y)))

    @property
    def coefficients(self) -> dict[str, float]:
        """Those of the formula."""
        return self.formula.coefficients

    def with_coefficients(self, values: Mapping[str, float]) -> Self:
        """Lens with other values of the coefficients."""
        return replace(self, formula=self.formula.with_coefficients(values))

    def _coefficient_slopes(self, x: FloatArray, y: FloatArray) -> FloatArray:
        # formula(measured) = ideal stays as it is: what a coefficient adds, the measured image takes back.
        added = self.formula._coefficient_slopes(*self.formula._undistort(x, y))
        slopes: FloatArray = -np.einsum("ijn,njk->nik", np.reshape(self._slopes(x, y), (2, 2, -1)), added)
        return slopes

    def in_calibrated_range(self, u: FloatArray, v: FloatArray) -> BoolArray:
        """Whether the polynomial is used there as given, not its continuation (N,)."""
        return np.hypot(u, v) <= self.formula.fold

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {"model": "corrections", "formula": self.formula.to_dict()}
