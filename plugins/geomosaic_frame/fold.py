"""Where a distortion polynomial folds back, and from where it is continued by a straight line instead.

A radial polynomial is fitted inside the image and means nothing far outside. There it usually turns round, so that a
point far off the image comes back into it: the ghost images known from many remappers. The distortion is used as given
up to the radius R and continued linearly along each ray from the centre beyond it, with the slope it has at R: C1, and
the radius never shrinks again.
"""

from __future__ import annotations

import numpy as np

from geomosaic.types import FloatArray

LEAST_SLOPE = 0.05
"""Slope of the continuation where the polynomial would turn: small, but steep enough to be inverted."""


def fold_radius(
    numerator: tuple[float, ...],
    denominator: tuple[float, ...] = (),
    tangential: float = 0.0,
    prism: tuple[float, float] = (0.0, 0.0),
) -> float:
    """Ideal radius R from which a distortion is continued linearly.

    The distorted point, projected on the ray of the ideal one, is ρ(r) = r·N(r²)/D(r²) plus at worst −3·t·r² from
    tangential terms (t = √(p1² + p2²), since their part along the ray is 3·(p2·x + p1·y)·r²) and −(a·r² + b·r⁴) from
    thin prism terms. Its slope is searched for its first zero; R lies just before it, where the slope is 0.05.

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
    n, d = np.polymul(_even(numerator), [1.0, 0.0]), _even(denominator)
    square = np.polymul(d, d)
    slope = np.polysub(np.polymul(np.polyder(n), d), np.polymul(n, np.polyder(d)))
    loss = np.array([4.0 * prism[1], 0.0, 6.0 * tangential + 2.0 * prism[0], 0.0])
    turn = _first_root(np.polysub(slope, np.polymul(loss, square)))
    pole = _first_root(d)
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
    roots = np.roots(polynomial)
    real = np.real(roots[np.abs(np.imag(roots)) < 1e-9 * np.maximum(np.abs(roots), 1e-300)])
    return sorted(float(r) for r in real if r > 0.0)


def _first_root(polynomial: FloatArray) -> float:
    return next(iter(_roots(polynomial)), float("inf"))
