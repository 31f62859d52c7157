"""Plane transformations ground to image on normalised coordinates, and their inverses.

u = (x − x₀)/s and v = (y − y₀)/s bring the ground to about [−1, 1]; with one scale s for both axes a conformal map
stays conformal. Coefficients are in pixels (those of a projective denominator have no unit).

conformal    X = a·u − b·v + TX, Y = a·v + b·u + TY (Wolf & Dewitt, equation 9-1); col = X, and row = −Y where the
             image's axes are left-handed (rows count downwards: they are turned to a right-handed system first, as the
             text asks) or row = Y where they are right-handed (rows upwards, or the image mirrored)
affine       polynomial of order 1
projective   col = (a0 + a1·u + a2·v)/w, row = (b0 + b1·u + b2·v)/w, w = 1 + c1·u + c2·v; seen where w > 0
polynomial   col = Σ aᵢⱼ uⁱ vʲ, row = Σ bᵢⱼ uⁱ vʲ over i + j ≤ order
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import numpy as np

from geomosaic.types import FloatArray, IntArray

KINDS = ("conformal", "affine", "projective", "polynomial", "tps")
# Handedness of (col, row) as the ground is seen in them.
AXES = ("left", "right")
MAX_ORDER = 5
SIGN = {"left": -1.0, "right": 1.0}


def article(label: str) -> str:
    """Indefinite article of a kind in a message: 'an' before affine, else 'a'.

    Parameters
    ----------
    label : str
    """
    return "an" if label.startswith("a") else "a"


def _exponents(order: int) -> list[tuple[int, int]]:
    """Exponents of the monomials, by degree: 1, u, v, u², u·v, v², ..."""
    return [(degree - j, j) for degree in range(order + 1) for j in range(degree + 1)]


def parameter_names(kind: str, order: int, nodes: int = 0) -> tuple[str, ...]:
    """Names of the coefficients, in their order.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    order : int
        Degree of a polynomial; 1 for affine.
    nodes : int
        Of a spline, whose parameters are the image coordinates of its nodes.
    """
    if kind == "tps":
        return tuple(f"{axis}{i + 1}" for axis in ("col", "row") for i in range(nodes))
    if kind == "conformal":
        return ("a", "b", "tx", "ty")
    if kind == "projective":
        return ("a0", "a1", "a2", "b0", "b1", "b2", "c1", "c2")
    powers = _exponents(order)
    return tuple(f"a{i}{j}" for i, j in powers) + tuple(f"b{i}{j}" for i, j in powers)


def least_points(kind: str, order: int) -> int:
    """Least number of control points that determine a transformation.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    order : int
        Degree of a polynomial; 1 for affine.

    Returns
    -------
    int
        Half the number of coefficients, rounded up: each point gives two observations.
    """
    if kind == "tps":
        return 3
    return -(-len(parameter_names(kind, order)) // 2)


@cache
def _indices(order: int) -> tuple[IntArray, IntArray]:
    """Powers of u and of v of every term."""
    i, j = np.array(_exponents(order)).T
    return i, j


def _powers(order: int, uv: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Powers 1, x, x², ... of u and of v, (order + 1, N) each."""
    powers = np.ones((order + 1, 2, len(uv)))
    for k in range(order):
        np.multiply(powers[k], uv.T, out=powers[k + 1])
    return powers[:, 0], powers[:, 1]


def basis(order: int, uv: FloatArray) -> FloatArray:
    """Monomials of normalised ground.

    Parameters
    ----------
    order : int
        Degree of the polynomial.
    uv : array (N, 2)
        Normalised ground.

    Returns
    -------
    array (N, T)
        In the order of `_exponents`.
    """
    (i, j), (u, v) = _indices(order), _powers(order, uv)
    return (u[i] * v[j]).T


def _basis_slopes(order: int, uv: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Derivatives of the monomials by normalised ground."""
    (i, j), (u, v) = _indices(order), _powers(order, uv)
    # Index −1 of a power 0 takes the highest power instead; the factor 0 removes it.
    by_u, by_v = i[:, None] * u[i - 1] * v[j], j[:, None] * u[i] * v[j - 1]
    return by_u.T, by_v.T


def slopes(kind: str, order: int, values: FloatArray, uv: FloatArray, axes: str = "left") -> FloatArray:
    """Derivatives of (col, row) by normalised ground.

    Parameters
    ----------
    kind : str
        One of `KINDS`, but not 'tps'.
    order : int
        Degree of a polynomial; 1 for the other kinds.
    values : array (P,)
        Coefficients, see `parameter_names`.
    uv : array (N, 2)
        Normalised ground.
    axes : str
        Handedness of the image's axes, it matters for a conformal map only.

    Returns
    -------
    array (N, 2, 2)
        Pixels per unit of u and v.
    """
    if kind not in ("affine", "polynomial"):
        return derivatives(kind, order, values, uv, axes)[1]
    return np.stack([by @ values.reshape(2, -1).T for by in _basis_slopes(order, uv)], axis=2)


def evaluate(kind: str, order: int, values: FloatArray, uv: FloatArray, axes: str = "left") -> FloatArray:
    """Image of normalised ground.

    Parameters
    ----------
    kind, order, values, uv, axes
        As for `slopes`.

    Returns
    -------
    array (N, 2)
        col, row in pixels; NaN for points that are not finite or lie behind the horizon of a projective map.
    """
    uv = np.where(np.isfinite(uv).all(axis=1, keepdims=True), uv, np.nan)
    u, v = uv.T
    if kind == "conformal":
        a, b, tx, ty = values
        return np.column_stack([a * u - b * v + tx, SIGN[axes] * (a * v + b * u + ty)])
    if kind == "projective":
        w = 1.0 + values[6] * u + values[7] * v
        w = np.where(w > 0.0, w, np.nan)
        return basis(1, uv) @ values[:6].reshape(2, 3).T / w[:, None]
    return basis(order, uv) @ values.reshape(2, -1).T


def derivatives(
    kind: str, order: int, values: FloatArray, uv: FloatArray, axes: str = "left"
) -> tuple[FloatArray, FloatArray]:
    """Derivatives of (col, row) by the coefficients and by normalised ground.

    Parameters
    ----------
    kind, order, values, uv, axes
        As for `slopes`.

    Returns
    -------
    by_values : array (N, 2, P)
    by_uv : array (N, 2, 2)
        Pixels per unit; NaN behind the horizon of a projective map.
    """
    count = len(uv)
    u, v = uv.T
    by_values = np.zeros((count, 2, len(values)))
    if kind == "conformal":
        (a, b), sign = values[:2], SIGN[axes]
        by_values[:, 0, 0], by_values[:, 0, 1], by_values[:, 0, 2] = u, -v, 1.0
        by_values[:, 1, 0], by_values[:, 1, 1], by_values[:, 1, 3] = sign * v, sign * u, sign
        by_uv = np.tile(np.array([[a, -b], [sign * b, sign * a]]), (count, 1, 1))
        by_uv[~np.isfinite(uv).all(axis=1)] = np.nan
        return by_values, by_uv
    if kind == "projective":
        w = 1.0 + values[6] * u + values[7] * v
        # Behind the horizon (w ≤ 0) the quotient is finite but shows ground that is not seen.
        w = np.where(w > 0.0, w, np.nan)[:, None]
        image = evaluate(kind, order, values, uv)
        terms = basis(1, uv) / w
        by_values[:, 0, :3] = by_values[:, 1, 3:6] = terms
        by_values[:, :, 6:] = -image[:, :, None] * (uv / w)[:, None, :]
        by_values[np.isnan(w[:, 0])] = np.nan
        by_uv = (values[:6].reshape(2, 3)[:, 1:] - image[:, :, None] * values[6:]) / w[:, :, None]
        return by_values, by_uv
    terms = basis(order, uv)
    size = terms.shape[1]
    by_values[:, 0, :size] = by_values[:, 1, size:] = terms
    return by_values, slopes(kind, order, values, uv)


ROUNDS = 60
HALVINGS = 6
STALLED = 0.999
# Pixels within which a point counts as found.
NEAR = 1e-3


def projective_inverse(values: FloatArray, colrow: FloatArray) -> FloatArray:
    """Inverse of a projective map, in closed form.

    Parameters
    ----------
    values : array (8,)
        Coefficients, see `parameter_names`.
    colrow : array (N, 2)
        Image points in pixels.

    Returns
    -------
    array (N, 2)
        Normalised ground; NaN beyond the horizon.
    """
    a, c = values[:6].reshape(2, 3), values[6:]
    uv = _solve2(a[None, :, 1:] - colrow[:, :, None] * c, colrow - a[:, 0])
    uv[~np.isfinite(evaluate("projective", 1, values, uv)).all(axis=1)] = np.nan
    return uv


def newton_inverse(
    image: Callable[[FloatArray], FloatArray],
    slopes: Callable[[FloatArray], FloatArray],
    colrow: FloatArray,
    start: FloatArray,
) -> FloatArray:
    """Inverse of a plane transformation by Newton's method, with halved steps.

    Parameters
    ----------
    image, slopes : callable
        Normalised ground (N, 2) to image (N, 2) and to its derivatives (N, 2, 2).
    colrow : array (N, 2)
        Image points in pixels.
    start : array (N, 2)
        Normalised ground to begin at.

    Returns
    -------
    array (N, 2)
        Normalised ground; NaN where the method finds none. Steps that lead farther off the goal are halved; a point
        that comes no nearer is given up.
    """
    uv = start.copy()
    left = colrow - image(uv)
    open_ = np.arange(len(uv))
    for _ in range(ROUNDS):
        here, goal = uv[open_], colrow[open_]
        change = _solve2(slopes(here), left[open_])
        off = np.hypot(*left[open_].T)
        # A step at the rounding of u, v is the end, even where rounding leaves the point no nearer.
        small = (np.abs(change) <= 1e-13 * np.maximum(1.0, np.abs(here))).all(axis=1)
        trial, after = here + change, goal - image(here + change)
        for _ in range(HALVINGS):
            worse = ~(np.hypot(*after.T) <= off) & ~small
            if not worse.any():
                break
            change[worse] *= 0.5
            trial[worse] = here[worse] + change[worse]
            after[worse] = goal[worse] - image(trial[worse])
        now = np.hypot(*after.T)
        better = (now <= off) | small
        uv[open_[better]], left[open_[better]] = trial[better], after[better]
        # A fold of a high order holds the point where it is: another round would not bring it nearer.
        open_ = open_[better & ~small & ~((now > STALLED * off) & (off > NEAR))]
        if not len(open_):
            break
    uv[~(np.abs(left).max(axis=1) < NEAR)] = np.nan
    return uv


def _solve2(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solutions (N, 2) of 2 × 2 systems (N, 2, 2), (N, 2); NaN where singular."""
    (a, b), (c, d) = matrix[:, 0].T, matrix[:, 1].T
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        determinant = a * d - b * c
        x = (d * right[:, 0] - b * right[:, 1]) / determinant
        y = (a * right[:, 1] - c * right[:, 0]) / determinant
    solution = np.column_stack([x, y])
    solution[~np.isfinite(solution).all(axis=1)] = np.nan
    return solution
