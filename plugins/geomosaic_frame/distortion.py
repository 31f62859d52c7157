"""Interface of lenses: directions to the image plane of focal length one; fold radius of a distortion polynomial.

Axes are those of OpenCV and OpenSfM: x right, y DOWN, z forward. An ideal point is (x / z, y / z). Distortion takes it
to the place where the lens puts it, in the same units; focal length and principal point come after (`camera.py`).

A radial polynomial is fitted inside the image and means nothing far outside. There it usually turns round, so that a
point far off the image comes back into it: the ghost images known from many remappers. The distortion is used as given
up to the radius R and continued linearly along each ray from the centre beyond it, with the slope it has at R: C1, and
the radius never shrinks again.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Protocol, Self, cast

import numpy as np

from geomosaic.errors import InputError
from geomosaic.types import BoolArray, FloatArray

# Metres in front of the camera below which a point is not seen; keeps powers of x / z finite.
NEAREST_DEPTH = 1e-9

# Newton steps of an inverse at most.
ROUNDS = 50

Columns = tuple[FloatArray, FloatArray]
# Derivatives of u by x, u by y, v by x, v by y.
Slopes = tuple[FloatArray, FloatArray, FloatArray, FloatArray]


class Lens(Protocol):
    """Lens: directions to the image plane and back; arrays of one column each, (N,)."""

    def project(self, x: FloatArray, y: FloatArray, z: FloatArray) -> Columns:
        """Camera axes (N,) in any unit to distorted u, v (N,); NaN where the lens cannot see.

        Parameters
        ----------
        x, y, z : array (N,)
            Camera axes: right, down, ahead, in any unit.
        """

    def unproject(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Distorted u, v (N,) to a direction x, y, z (N,) in camera axes, not normalised."""

    def derivatives(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Derivatives of (u, v) by (x, y, z), (N, 2, 3).

        Parameters
        ----------
        x, y, z : array (N,)
            Camera axes: right, down, ahead, in any unit.
        """

    def in_calibrated_range(self, u: FloatArray, v: FloatArray) -> BoolArray:
        """Whether the polynomial is used there as given, not its continuation (N,)."""

    def for_corners(self, u: FloatArray, v: FloatArray) -> Lens:
        """Lens that knows how far the image reaches, whose corners are at distorted u, v (N,)."""

    @property
    def coefficients(self) -> dict[str, float]:
        """Coefficients that an adjustment may change, by their keys in camera.toml."""

    def with_coefficients(self, values: Mapping[str, float]) -> Lens:
        """Lens with other values of the coefficients."""

    def by_coefficients(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Derivatives of (u, v) by the K coefficients, (N, 2, K).

        Parameters
        ----------
        x, y, z : array (N,)
            Camera axes: right, down, ahead, in any unit.
        """

    @property
    def edge(self) -> float:
        """Distorted radius up to which the polynomial is used as given; inf without end."""

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""


class NamedCoefficients:
    """Base of the lenses whose coefficients are fields of a dataclass; none unless `names` lists them."""

    names: tuple[str, ...] = ()

    @property
    def coefficients(self) -> dict[str, float]:
        """Coefficients that an adjustment may change, by their keys in camera.toml."""
        return {name: getattr(self, name) for name in self.names}

    def with_coefficients(self, values: Mapping[str, float]) -> Self:
        """Lens with other values of the coefficients."""
        return cast(Self, replace(cast(Any, self), **values)) if values else self


class Perspective(NamedCoefficients):
    """Base of the lenses that distort an ideal perspective image; half a space at most is seen."""

    edge: float = np.inf

    def _distort(self, x: FloatArray, y: FloatArray) -> Columns:
        return x, y

    def _undistort(self, u: FloatArray, v: FloatArray) -> Columns:
        return u, v

    def _slopes(self, x: FloatArray, y: FloatArray) -> Slopes:
        one, zero = np.ones_like(x), np.zeros_like(x)
        return one, zero, zero, one

    def _coefficient_slopes(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Derivatives of (u, v) by the coefficients, (N, 2, K)."""
        return np.empty((len(x), 2, 0))

    def project(self, x: FloatArray, y: FloatArray, z: FloatArray) -> Columns:
        """Camera axes (N,) to distorted u, v (N,); NaN behind the camera."""
        shrink = 1.0 / np.where(z > NEAREST_DEPTH, z, np.nan)
        return self._distort(x * shrink, y * shrink)

    def unproject(self, u: FloatArray, v: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Distorted u, v (N,) to a direction x, y, z (N,) with z = 1."""
        x, y = self._undistort(u, v)
        return x, y, np.ones_like(x)

    def derivatives(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Derivatives of (u, v) by (x, y, z), (N, 2, 3)."""
        shrink = 1.0 / np.where(z > NEAREST_DEPTH, z, np.nan)
        a, b = x * shrink, y * shrink
        ux, uy, vx, vy = self._slopes(a, b)
        out = np.empty((len(a), 2, 3))
        out[:, 0, 0], out[:, 0, 1], out[:, 0, 2] = ux * shrink, uy * shrink, -(ux * a + uy * b) * shrink
        out[:, 1, 0], out[:, 1, 1], out[:, 1, 2] = vx * shrink, vy * shrink, -(vx * a + vy * b) * shrink
        return out

    def by_coefficients(self, x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
        """Derivatives of (u, v) by the K coefficients, (N, 2, K)."""
        shrink = 1.0 / np.where(z > NEAREST_DEPTH, z, np.nan)
        return self._coefficient_slopes(x * shrink, y * shrink)

    def in_calibrated_range(self, u: FloatArray, v: FloatArray) -> BoolArray:
        """Whether the polynomial is used there as given, not its continuation (N,)."""
        return np.ones(len(u), dtype=np.bool_)

    def for_corners(self, u: FloatArray, v: FloatArray) -> Self:
        """The lens itself: its limit does not depend on the image."""
        return self


@dataclass(frozen=True)
class NoDistortion(Perspective):
    """Ideal lens, without distortion."""

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {"model": "none"}


def newton_inverse(
    forward: Callable[[FloatArray, FloatArray], tuple[Columns, Slopes]],
    given: Columns,
    start: Columns,
    unit: float = 1.0,
    goal: tuple[float, float] = (2e-15, 1e-12),
) -> Columns:
    """Inverse of a map of the image plane by Newton's method in two unknowns; NaN where it does not converge.

    Parameters
    ----------
    forward : callable
        Of places (N,) each, to their images and the derivatives of these.
    given : tuple of array (N,)
        Images of the places looked for.
    start : tuple of array (N,)
        Places near enough.
    unit : float
        Size of the coordinates that counts as 1.
    goal : tuple of float
        Last step, and largest miss of the images, of the unit and the coordinates.
    """
    (u, v), (x, y) = given, start
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(ROUNDS):
            (a, b), (ux, uy, vx, vy) = forward(x, y)
            a, b = u - a, v - b
            det = ux * vy - uy * vx
            dx, dy = (vy * a - uy * b) / det, (ux * b - vx * a) / det
            x, y = x + dx, y + dy
            step = np.maximum(np.abs(dx), np.abs(dy)) / (unit + np.maximum(np.abs(x), np.abs(y)))
            if not (step > goal[0]).any():
                break
        a, b = forward(x, y)[0]
        size = unit + np.maximum(np.abs(u), np.abs(v))
        lost = ~(np.maximum(np.abs(a - u), np.abs(b - v)) <= goal[1] * size)
    return np.where(lost, np.nan, x), np.where(lost, np.nan, y)


def inverse_slopes(slopes: Slopes) -> Slopes:
    """Derivatives of the inverse of a map of the image plane.

    Parameters
    ----------
    slopes : tuple of array (N,)
        Derivatives of the map.
    """
    ux, uy, vx, vy = slopes
    det = ux * vy - uy * vx
    return vy / det, -uy / det, -vx / det, ux / det


# Slope of the continuation where the polynomial would turn: small, but steep enough to be inverted.
LEAST_SLOPE = 0.05


# All photos of a camera ask for that of each lens that an adjustment tries.
@lru_cache(maxsize=64)
def fold_radius(
    numerator: tuple[float, ...],
    denominator: tuple[float, ...] = (),
    tangential: float = 0.0,
    prism: tuple[float, float] = (0.0, 0.0),
) -> float:
    """Fold radius: ideal radius R from which a distortion is continued linearly.

    Parameters
    ----------
    numerator, denominator : tuple of float
        Coefficients of r², r⁴, ... of N and D; both start with 1.
    tangential : float
        √(p1² + p2²).
    prism : tuple of float
        √(s1² + s3²), √(s2² + s4²).

    Returns
    -------
    float
        R, or inf where the distortion never folds.
    """
    # The distorted point, projected on the ray of the ideal one, is ρ(r) = r·N(r²)/D(r²) plus at worst −3·t·r² from
    # tangential terms (t = √(p1² + p2²), since their part along the ray is 3·(p2·x + p1·y)·r²) and −(a·r² + b·r⁴) from
    # thin prism terms. Its slope is searched for its first zero; R lies just before it, where the slope is 0.05.
    n, d = np.polymul(_even(numerator), [1.0, 0.0]), _even(denominator)
    square = np.polymul(d, d)
    slope = np.polysub(np.polymul(np.polyder(n), d), np.polymul(n, np.polyder(d)))
    loss = np.array([4.0 * prism[1], 0.0, 6.0 * tangential + 2.0 * prism[0], 0.0])
    turn = _first_root(np.polysub(slope, np.polymul(loss, square)))
    pole = _first_root(d)
    # At a pole the distortion is infinite: the continuation starts a hundredth before it.
    if pole < turn:
        return 0.99 * pole
    if not np.isfinite(turn):
        return float("inf")
    before = [r for r in _roots(np.polysub(slope, np.polymul(np.polyadd(loss, [LEAST_SLOPE]), square))) if r < turn]
    return max(before, default=turn)


def _even(coefficients: tuple[float, ...]) -> FloatArray:
    """Coefficients of 1 + c₁r² + c₂r⁴ + ..., the highest first."""
    out = np.zeros(2 * len(coefficients) + 1)
    out[0], out[2::2] = 1.0, coefficients
    return out[::-1]


def _roots(polynomial: FloatArray) -> list[float]:
    """Positive real roots, ascending."""
    try:
        roots = np.roots(polynomial)
    except np.linalg.LinAlgError:  # products or ratios of the coefficients are no numbers
        raise InputError(
            "the coefficients of the distortion are too large for any lens", hint="check them, and their unit"
        ) from None
    real = np.real(roots[np.abs(np.imag(roots)) < 1e-9 * np.maximum(np.abs(roots), 1e-300)])
    return sorted(float(r) for r in real if r > 0.0)


def _first_root(polynomial: FloatArray) -> float:
    return next(iter(_roots(polynomial)), float("inf"))
