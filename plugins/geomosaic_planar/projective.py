"""The projective transformation by least squares on residuals in pixels."""

from __future__ import annotations

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.types import FloatArray
from geomosaic_planar.solve import WORST_CONDITION, least_squares
from geomosaic_planar.terms import derivatives, evaluate

ROUNDS = 50


def projective(
    uv: FloatArray, image: FloatArray, root: FloatArray, where: str | None
) -> tuple[FloatArray, float, FloatArray]:
    """Direct linear start, then Gauss-Newton on the true residuals in pixels."""
    values = _direct_linear(uv, image, root, where)
    for _ in range(ROUNDS):
        residuals = (image - evaluate("projective", 1, values, uv)) * root[:, None]
        design = (derivatives("projective", 1, values, uv)[0] * root[:, None, None]).reshape(-1, 8)
        step, condition, cofactors = least_squares(design, residuals.ravel(), "projective", where)
        before = float((residuals**2).sum())
        factor = 1.0
        while factor > 1e-6:
            trial = values + factor * step
            after = float((((image - evaluate("projective", 1, trial, uv)) * root[:, None]) ** 2).sum())
            if after <= before * (1.0 + 1e-12) or np.abs(design @ step).max() < 1e-9:
                break
            factor *= 0.5  # also where a point came to lie behind the horizon and `after` is NaN
        else:
            break
        values = trial
        if np.abs(design @ step).max() < 1e-11 * max(1.0, float(np.abs(image).max())):
            break
    return values, condition, cofactors


def _direct_linear(uv: FloatArray, image: FloatArray, root: FloatArray, where: str | None) -> FloatArray:
    """Projective coefficients of least algebraic error (Hartley & Zisserman, section 4.1, both sides normalised)."""
    middle = image.mean(axis=0)
    size = float(np.abs(image - middle).max()) or 1.0
    q = (image - middle) / size
    one = np.column_stack([np.ones(len(uv)), uv])
    zero = np.zeros_like(one)
    rows = np.vstack([np.hstack([one, zero, -q[:, :1] * one]), np.hstack([zero, one, -q[:, 1:] * one])])
    # Four points give eight rows, and the ninth direction is the solution.
    _, singular, turned = np.linalg.svd(rows * np.tile(root, 2)[:, None], full_matrices=len(rows) < 9)
    if singular[7] * WORST_CONDITION < singular[0]:
        raise SolveError(
            "the control points do not determine a projective transformation: three of four lie on a line, or too "
            "many on one place",
            where=where,
            mend="give four points or more, no three of the four on one line, or choose affine",
        )
    col, row, bottom = turned[-1].reshape(3, 3)
    w = one @ bottom
    if not ((w > 0.0).all() or (w < 0.0).all()):
        raise SolveError(
            "the control points lie on both sides of the horizon of the projective transformation they call for",
            where=where,
            mend="look for swapped or wrong points",
        )
    col, row = col * size + middle[0] * bottom, row * size + middle[1] * bottom
    values: FloatArray = np.concatenate([col, row, bottom[1:]]) / bottom[0]
    return values
