"""Plane transformations from control points, by least squares on normalised coordinates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.types import FloatArray
from geomosaic_planar.terms import derivatives, evaluate, exponents, least_points, parameter_names

WORST_CONDITION = 1e8
ROUNDS = 50


@dataclass(frozen=True)
class PlanarFit:
    """A plane transformation and how well it fits.

    Attributes
    ----------
    kind, order : str, int
    centre : array (2,)
        Mean of the points on the map.
    scale : float
        Map units; the points reach |u|, |v| ≤ 1.
    values : array (P,)
        Coefficients for normalised ground coordinates.
    residuals : array (N, 2)
        Measured minus computed (col, row) in pixels.
    covariance : array (P, P)
        Of the coefficients, scaled by sigma0²; NaN without redundancy.
    sigma0 : float
        Standard deviation of an observation of weight 1, in pixels; NaN without redundancy.
    condition : float
        Of the design matrix with columns of length one.
    """

    kind: str
    order: int
    centre: FloatArray
    scale: float
    values: FloatArray
    residuals: FloatArray
    covariance: FloatArray
    sigma0: float
    condition: float


def fit_planar(
    kind: str,
    xy: FloatArray,
    colrow: FloatArray,
    weights: FloatArray | None = None,
    *,
    order: int = 1,
    where: str | None = None,
) -> PlanarFit:
    """Fit a plane transformation ground → image.

    Parameters
    ----------
    kind : str
        'conformal', 'affine', 'projective' or 'polynomial'.
    xy : array (N, 2)
        Map positions.
    colrow : array (N, 2)
        Measured image positions in pixels.
    weights : array (N,), optional
        1 / σ² of the measurements; all 1 when left out.
    order : int
        Degree of a polynomial, 1 to 5.
    where : str, optional
        Named in errors.

    Raises
    ------
    SolveError
        Too few points, or points that do not determine the transformation: on a line, on one place, ...
    """
    ground, image = np.asarray(xy, dtype=np.float64), np.asarray(colrow, dtype=np.float64)
    if ground.shape != image.shape or ground.ndim != 2 or ground.shape[1] != 2:
        raise ValueError(f"shapes {ground.shape} and {image.shape} are not both (N, 2)")
    if not (np.isfinite(ground).all() and np.isfinite(image).all()):
        raise SolveError("a control point has a coordinate that is not a number", where=where)
    count, needed = len(ground), least_points(kind, order)
    label = f"{kind} of order {order}" if kind == "polynomial" else kind
    if count < needed:
        raise SolveError(
            f"{count} control points do not determine a {label} transformation, which needs {needed}",
            where=where,
            mend="add points or choose a simpler kind: conformal needs 2, affine 3, projective 4",
        )
    root = np.ones(count) if weights is None else np.sqrt(np.asarray(weights, dtype=np.float64))
    if not (np.isfinite(root) & (root > 0.0)).all():
        raise SolveError("weights of control points must be positive numbers", where=where)
    # The mean lies inside the points, so a projective denominator that is positive at all of them is so there.
    centre = ground.mean(axis=0)
    scale = float(np.abs(ground - centre).max())
    if scale == 0.0:
        raise SolveError("all control points lie on one place", where=where, mend="spread them over the image")
    uv = (ground - centre) / scale
    solved = (
        _projective(uv, image, root, where)
        if kind == "projective"
        else _linear(kind, order, uv, image, root, label, where)
    )
    values, condition, cofactors = solved
    residuals = image - evaluate(kind, order, values, uv)
    redundancy = 2 * count - len(values)
    weighted = residuals * root[:, None]
    sigma0 = float(np.sqrt((weighted**2).sum() / redundancy)) if redundancy > 0 else float("nan")
    return PlanarFit(kind, order, centre, scale, values, residuals, cofactors * sigma0**2, sigma0, condition)


def _solve(
    design: FloatArray, right: FloatArray, label: str, where: str | None
) -> tuple[FloatArray, float, FloatArray]:
    """Least squares by singular values; solution, condition, cofactors."""
    length = np.linalg.norm(design, axis=0)
    length = np.where(length > 0.0, length, 1.0)
    left, singular, turned = np.linalg.svd(design / length, full_matrices=False)
    if singular[-1] * WORST_CONDITION < singular[0]:
        raise SolveError(
            f"the control points do not determine a {label} transformation: they lie on a line or curve, or too many "
            "of them on one place",
            where=where,
            mend="spread the points over the image, or choose a simpler kind",
        )
    root = turned.T / singular
    solution = ((root @ (left.T @ right)).T / length).T
    return solution, float(singular[0] / singular[-1]), (root @ root.T) / np.outer(length, length)


def _linear(
    kind: str, order: int, uv: FloatArray, image: FloatArray, root: FloatArray, label: str, where: str | None
) -> tuple[FloatArray, float, FloatArray]:
    """Kinds that are linear in their coefficients."""
    if kind == "conformal":
        unknowns = np.zeros(4)
        design = derivatives(kind, order, unknowns, uv)[0] * root[:, None, None]
        return _solve(design.reshape(-1, 4), (image * root[:, None]).ravel(), label, where)
    # Columns and rows share one design: solve it once for both.
    terms = derivatives(kind, order, np.zeros(len(parameter_names(kind, order))), uv)[0][:, 0, : len(exponents(order))]
    solution, condition, cofactors = _solve(terms * root[:, None], image * root[:, None], label, where)
    both = np.kron(np.eye(2), cofactors).astype(np.float64)
    return solution.T.ravel(), condition, both


def _projective(
    uv: FloatArray, image: FloatArray, root: FloatArray, where: str | None
) -> tuple[FloatArray, float, FloatArray]:
    """Direct linear start, then Gauss-Newton on the true residuals in pixels."""
    values = _direct_linear(uv, image, root, where)
    for _ in range(ROUNDS):
        residuals = (image - evaluate("projective", 1, values, uv)) * root[:, None]
        design = (derivatives("projective", 1, values, uv)[0] * root[:, None, None]).reshape(-1, 8)
        step, condition, cofactors = _solve(design, residuals.ravel(), "projective", where)
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
    _, singular, turned = np.linalg.svd(rows * np.tile(root, 2)[:, None])
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
