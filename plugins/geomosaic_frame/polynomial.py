"""Polynomial lens distortion: Brown's model and OpenCV's rational one.

    u = x·N/D + 2·p1·x·y + p2·(r² + 2x²) + s1·r² + s2·r⁴
    v = y·N/D + p1·(r² + 2y²) + 2·p2·x·y + s3·r² + s4·r⁴
    N = 1 + k1·r² + k2·r⁴ + k3·r⁶,   D = 1 + k4·r² + k5·r⁴ + k6·r⁶

x right, y down, ideal; u, v distorted (Brown 1966; OpenCV `calib3d`, whose p1 goes with 2xy in u; OpenSfM `brown` is
the same with D = 1 and s = 0). Beyond the fold radius R (`distortion.fold_radius`) all terms go on linearly along the
ray: with r = |(x, y)|, ρ(r) = r·N/D becomes ρ(R) + ρ'(R)·(r − R), terms of degree two are multiplied by
R·(2r − R)/r², and those of degree four by R³·(4r − 3R)/r⁴.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from geomosaic.types import BoolArray, FloatArray
from geomosaic_frame.distortion import Columns, Perspective, Slopes, fold_radius, newton_inverse

TABLE = 257


def _series(u: FloatArray | float, c: tuple[float, ...]) -> Any:
    """1 + c₁u + c₂u² + ..., by Horner's rule."""
    total: Any = 0.0
    for value in reversed(c):
        total = (total + value) * u
    return total + 1.0


def _series_slope(u: FloatArray | float, c: tuple[float, ...]) -> Any:
    """Derivative of `_series` by u."""
    total: Any = 0.0
    for power in range(len(c), 0, -1):
        total = total * u + power * c[power - 1]
    return total


class PolynomialLens(Perspective):
    """Polynomial lens distortion: the formulas of this module for any of its coefficient sets."""

    fold: float
    # Power of r² that a radial coefficient goes with; negative in the denominator.
    _powers: Mapping[str, int]
    _numerator: tuple[float, ...]
    _denominator: tuple[float, ...]
    _tangential: tuple[float, float]
    _prism: tuple[float, float, float, float]

    def _prepare(
        self,
        numerator: tuple[float, ...],
        denominator: tuple[float, ...],
        tangential: tuple[float, float],
        prism: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
    ) -> None:
        """Fill in what is derived from the coefficients."""
        while denominator and denominator[-1] == 0.0:
            denominator = denominator[:-1]
        s1, s2, s3, s4 = prism
        t = float(np.hypot(*tangential))
        fold = fold_radius(numerator, denominator, t, (float(np.hypot(s1, s3)), float(np.hypot(s2, s4))))
        derived = {
            "_numerator": numerator,
            "_denominator": denominator,
            "_tangential": tangential,
            "_prism": prism,
            "fold": fold,
        }
        for name, value in derived.items():
            object.__setattr__(self, name, value)
        # Tangential terms shorten the radius by 3·t·r² at worst: within `edge` the polynomial holds all around.
        loss = 3.0 * t * fold**2 if np.isfinite(fold) else 0.0
        object.__setattr__(self, "edge", float(fold * self._factor(fold**2)) - loss if np.isfinite(fold) else np.inf)

    def _factor(self, u: Any) -> Any:
        """N / D at u = r²."""
        top = _series(u, self._numerator)
        return top / _series(u, self._denominator) if self._denominator else top

    def _factor_slope(self, u: Any) -> Any:
        """Derivative of N / D by u."""
        slope = _series_slope(u, self._numerator)
        if not self._denominator:
            return slope
        bottom = _series(u, self._denominator)
        return (slope - _series(u, self._numerator) / bottom * _series_slope(u, self._denominator)) / bottom

    def _factor_by(self, name: str, u: Any) -> tuple[Any, Any]:
        """Derivative of N / D by a radial coefficient at u = r², and its derivative by u."""
        top, dtop = _series(u, self._numerator), _series_slope(u, self._numerator)
        bottom, dbottom = _series(u, self._denominator), _series_slope(u, self._denominator)
        power = self._powers[name]
        if power > 0:
            value = u**power / bottom
            return value, power * u ** (power - 1) / bottom - value * dbottom / bottom
        term, dterm = u**-power, -power * u ** (-power - 1)
        value = -top * term / bottom**2
        return value, -(dtop * term + top * dterm) / bottom**2 - 2.0 * value * dbottom / bottom

    @property
    def _end(self) -> tuple[float, float]:
        """ρ and dρ/dr at the fold radius."""
        r = self.fold
        return float(r * self._factor(r * r)), float(self._factor(r * r) + 2.0 * r * r * self._factor_slope(r * r))

    def _distort(self, x: FloatArray, y: FloatArray) -> Columns:
        u = x * x + y * y
        q = self._factor(u)
        two: Any = 1.0
        four: Any = 1.0
        far = u > self.fold**2
        if far.any():
            q, two, four = q * np.ones_like(u), np.ones_like(u), np.ones_like(u)
            r, end = np.sqrt(u[far]), self.fold
            rho, slope = self._end
            q[far] = (rho + slope * (r - end)) / r
            two[far] = end * (2.0 * r - end) / u[far]
            four[far] = end**3 * (4.0 * r - 3.0 * end) / u[far] ** 2
        a, b = x * q, y * q
        p1, p2 = self._tangential
        if p1 or p2:
            cross = 2.0 * x * y
            a += two * (p1 * cross + p2 * (u + 2.0 * x * x))
            b += two * (p1 * (u + 2.0 * y * y) + p2 * cross)
        s1, s2, s3, s4 = self._prism
        if any(self._prism):
            second, fourth = two * u, four * u * u
            a += s1 * second + s2 * fourth
            b += s3 * second + s4 * fourth
        return a, b

    def _slopes(self, x: FloatArray, y: FloatArray) -> Slopes:
        u = x * x + y * y
        one = np.ones_like(u)
        q, dq = self._factor(u) * one, self._factor_slope(u) * one
        two, dtwo, four, dfour = one.copy(), np.zeros_like(u), one.copy(), np.zeros_like(u)
        far = u > self.fold**2
        if far.any():
            f, end = u[far], self.fold
            r = np.sqrt(f)
            rho, slope = self._end
            q[far] = (rho + slope * (r - end)) / r
            dq[far] = (slope * end - rho) / (2.0 * r * f)  # d/du = d/dr / 2r
            two[far] = end * (2.0 * r - end) / f
            dtwo[far] = end * (end - r) / (r * f * r)
            four[far] = end**3 * (4.0 * r - 3.0 * end) / f**2
            dfour[far] = 6.0 * end**3 * (end - r) / f**3
        p1, p2 = self._tangential
        s1, s2, s3, s4 = self._prism
        tx, ty = 2.0 * p1 * x * y + p2 * (u + 2.0 * x * x), p1 * (u + 2.0 * y * y) + 2.0 * p2 * x * y
        second, fourth = two + u * dtwo, u * (2.0 * four + u * dfour)
        # Everything that depends on u alone, differentiated by u.
        gx = x * dq + tx * dtwo + s1 * second + s2 * fourth
        gy = y * dq + ty * dtwo + s3 * second + s4 * fourth
        return (
            q + 2.0 * x * gx + two * (2.0 * p1 * y + 6.0 * p2 * x),
            2.0 * y * gx + two * (2.0 * p1 * x + 2.0 * p2 * y),
            2.0 * x * gy + two * (2.0 * p1 * x + 2.0 * p2 * y),
            q + 2.0 * y * gy + two * (6.0 * p1 * y + 2.0 * p2 * x),
        )

    def _coefficient_slopes(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Derivatives of (u, v) by the coefficients, (N, 2, K)."""
        # The fold radius depends on the coefficients, too; it is held here, as no image point beyond it should count.
        u = x * x + y * y
        two, four = np.ones_like(u), np.ones_like(u)
        far = u > self.fold**2
        r, end = np.sqrt(u[far]), self.fold
        if far.any():
            two[far] = end * (2.0 * r - end) / u[far]
            four[far] = end**3 * (4.0 * r - 3.0 * end) / u[far] ** 2
        cross, zero = 2.0 * x * y, np.zeros_like(u)
        columns = {
            "p1": (two * cross, two * (u + 2.0 * y * y)),
            "p2": (two * (u + 2.0 * x * x), two * cross),
            "s1": (two * u, zero),
            "s2": (four * u * u, zero),
            "s3": (zero, two * u),
            "s4": (zero, four * u * u),
        }
        for name in self._powers:
            q = self._factor_by(name, u)[0]
            if far.any():
                at_end, slope = self._factor_by(name, end * end)
                q[far] = (end * at_end + (at_end + 2.0 * end * end * slope) * (r - end)) / r
            columns[name] = x * q, y * q
        return np.stack([np.column_stack(columns[name]) for name in self.names], axis=2)

    def _start(self, u: FloatArray, v: FloatArray) -> Columns:
        """Inverse of the radial part alone, from a table."""
        rho = np.hypot(u, v)
        top = float(np.max(rho, initial=0.0, where=np.isfinite(rho)))
        last = 1.0
        while last < self.fold and last * self._factor(last**2) < top and last < 1e9:
            last *= 2.0
        last = min(last, self.fold)
        r = np.linspace(0.0, last, TABLE)
        # From the radial inverse Newton's method stays on the branch inside the fold; from (u, v) it may leave it.
        ideal = np.interp(rho, r * self._factor(r * r), r)
        if np.isfinite(self.fold):
            end, slope = self._end
            ideal = np.where(rho > end, self.fold + (rho - end) / slope, ideal)
        ratio = np.divide(ideal, rho, out=np.ones_like(rho), where=rho > 1e-12)
        return u * ratio, v * ratio

    def _undistort(self, u: FloatArray, v: FloatArray) -> Columns:
        return newton_inverse(lambda x, y: (self._distort(x, y), self._slopes(x, y)), (u, v), self._start(u, v))

    def in_calibrated_range(self, u: FloatArray, v: FloatArray) -> BoolArray:
        """Whether the polynomial is used there as given, not its continuation (N,)."""
        return np.hypot(*self._undistort(u, v)) <= self.fold


@dataclass(frozen=True)
class Brown(PolynomialLens):
    """Brown's model with OpenCV's and OpenSfM's order of p1 and p2; see the module for the formula.

    Attributes
    ----------
    k1, k2, k3 : float
        Radial, of r², r⁴, r⁶.
    p1, p2 : float
        Tangential; p1 goes with 2xy in u.
    k4 : float
        Radial, of r⁸ (Metashape); 0 elsewhere.
    fold : float
        Ideal radius beyond which the distortion goes on linearly.
    """

    k1: float = 0.0
    k2: float = 0.0
    k3: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k4: float = 0.0
    fold: float = field(init=False, repr=False, compare=False, default=np.inf)

    names = ("k1", "k2", "k3", "k4", "p1", "p2")
    _powers = {"k1": 1, "k2": 2, "k3": 3, "k4": 4}

    def __post_init__(self) -> None:
        self._prepare((self.k1, self.k2, self.k3, self.k4), (), (self.p1, self.p2))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        values = asdict(self)
        values.pop("fold")
        if not self.k4:
            values.pop("k4")
        return {"model": "brown", **values}


@dataclass(frozen=True)
class Rational(PolynomialLens):
    """OpenCV's rational model with thin prism terms; see `geomosaic_frame.polynomial` for the formula.

    Attributes
    ----------
    k1, k2, k3 : float
        Radial numerator, of r², r⁴, r⁶.
    p1, p2 : float
        Tangential; p1 goes with 2xy in u.
    k4, k5, k6 : float
        Radial denominator.
    s1, s2, s3, s4 : float
        Thin prism.
    fold : float
        Ideal radius beyond which the distortion goes on linearly.
    """

    k1: float = 0.0
    k2: float = 0.0
    p1: float = 0.0
    p2: float = 0.0
    k3: float = 0.0
    k4: float = 0.0
    k5: float = 0.0
    k6: float = 0.0
    s1: float = 0.0
    s2: float = 0.0
    s3: float = 0.0
    s4: float = 0.0
    fold: float = field(init=False, repr=False, compare=False, default=np.inf)

    names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6", "s1", "s2", "s3", "s4")
    _powers = {"k1": 1, "k2": 2, "k3": 3, "k4": -1, "k5": -2, "k6": -3}

    def __post_init__(self) -> None:
        prism = (self.s1, self.s2, self.s3, self.s4)
        self._prepare((self.k1, self.k2, self.k3), (self.k4, self.k5, self.k6), (self.p1, self.p2), prism)

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        values = asdict(self)
        values.pop("fold")
        return {"model": "opencv", **values}
