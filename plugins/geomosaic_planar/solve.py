"""Least squares of the kinds that are linear in their coefficients."""

from __future__ import annotations

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.types import FloatArray
from geomosaic_planar.terms import AXES, article, basis, derivatives

WORST_CONDITION = 1e6
SURE = 3.0
"""Logarithm of the ratio of likelihoods from which control is taken for mirrored; e³ is about 20 to 1."""


def least_squares(
    design: FloatArray, right: FloatArray, label: str, where: str | None
) -> tuple[FloatArray, float, FloatArray]:
    """Least squares by singular values; solution, condition, cofactors."""
    length = np.linalg.norm(design, axis=0)
    length = np.where(length > 0.0, length, 1.0)
    left, singular, turned = np.linalg.svd(design / length, full_matrices=False)
    if singular[-1] * WORST_CONDITION < singular[0]:
        raise SolveError(
            f"the control points do not determine {article(label)} {label} transformation: they lie on a "
            "line or curve, or too many of them on one place",
            where=where,
            mend="spread the points over the image, or choose a simpler kind",
        )
    root = turned.T / singular
    solution = ((root @ (left.T @ right)).T / length).T
    return solution, float(singular[0] / singular[-1]), (root @ root.T) / np.outer(length, length)


def conformal(
    uv: FloatArray, image: FloatArray, root: FloatArray, axes: str | None, where: str | None
) -> tuple[tuple[FloatArray, float, FloatArray], str]:
    """Conformal coefficients, and the handedness of the image's axes.

    Where it is not given, both are fitted. Axes are left-handed (rows downwards) unless the other fit is better beyond
    chance: two points, or points on a line, fit either way and say nothing.
    """
    tried = {}
    right = (image * root[:, None]).ravel()
    for each in AXES if axes is None else (axes,):
        design = (derivatives("conformal", 1, np.zeros(4), uv, each)[0] * root[:, None, None]).reshape(-1, 4)
        solved = least_squares(design, right, "conformal", where)
        left = right - design @ solved[0]
        # Not below what rounding leaves, so that exact points on a line do not decide.
        tried[each] = solved, float(left @ left) + 1e-20 * float(right @ right)
    if axes is not None:
        return tried[axes][0], axes
    redundancy = 2 * len(uv) - 4
    gain = 0.5 * redundancy * np.log(tried["left"][1] / max(tried["right"][1], 1e-300)) if redundancy else 0.0
    chosen = "right" if gain > SURE else "left"
    return tried[chosen][0], chosen


def linear(
    order: int, uv: FloatArray, image: FloatArray, root: FloatArray, label: str, where: str | None
) -> tuple[FloatArray, float, FloatArray]:
    """Affine and polynomial coefficients."""
    # Columns and rows share one design: solve it once for both.
    terms = basis(order, uv)
    solution, condition, cofactors = least_squares(terms * root[:, None], image * root[:, None], label, where)
    both = np.kron(np.eye(2), cofactors).astype(np.float64)
    return solution.T.ravel(), condition, both
