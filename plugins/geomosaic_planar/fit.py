"""Least squares fits of plane transformations to control points."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np

from geomosaic.errors import SolveError, counted
from geomosaic.estimation.equations import Equations
from geomosaic.estimation.solver import Linearised, Problem, Stopping, solve
from geomosaic.estimation.statistics import sigma0_of
from geomosaic.types import FloatArray
from geomosaic_planar import spline
from geomosaic_planar.model import Transformation
from geomosaic_planar.terms import AXES, article, basis, derivatives, evaluate, least_points

# Coordinates are normalised to about ±1, so that points spread over the image stay far below this; what exceeds it is
# a degenerate arrangement and not a matter of units.
WORST_CONDITION = 1e6
# Movements are shares of the image size, and end at its rounding: exact points give exact coefficients.
RULES = Stopping(rounds=50, step=1e-11, near=0.0)
# Logarithm of the ratio of likelihoods from which control is taken for mirrored; e³ is about 20 to 1.
SURE = 3.0


def _need_determined(equations: Equations, label: str, where: str | None) -> None:
    """Check that the control points determine the unknowns."""
    if equations.condition()[0] > WORST_CONDITION:
        raise SolveError(
            f"the control points do not determine {article(label)} {label} transformation: they lie on a "
            "line or curve, or too many of them on one place",
            where=where,
            hint="spread the points over the image, or choose a simpler kind",
        )


def _least_squares(
    design: FloatArray, right: FloatArray, label: str, where: str | None
) -> tuple[FloatArray, float, FloatArray]:
    """Weighted linear least squares by singular values: solution, condition of the design, and cofactors (P, P)."""
    equations = Equations(design, right)
    _need_determined(equations, label, where)
    return equations.step(), equations.condition()[0], equations.parameter_cofactors()


def _conformal(
    uv: FloatArray, image: FloatArray, root: FloatArray, axes: str | None, where: str | None
) -> tuple[tuple[FloatArray, float, FloatArray], str]:
    """Conformal transformation, normalised ground (N, 2) to (col, row), and the handedness of the image's axes.

    `root` (N,) are square roots of the weights; the solution is a, b, tx, ty in pixels, condition and cofactors (4, 4).
    """
    # Where the handedness is not given, both are fitted. Axes are left-handed (rows downwards) unless the other fit is
    # better beyond chance: two points, or points on a line, fit either way and decide nothing.
    tried = {}
    right = (image * root[:, None]).ravel()
    for each in AXES if axes is None else (axes,):
        design = (derivatives("conformal", 1, np.zeros(4), uv, each)[0] * root[:, None, None]).reshape(-1, 4)
        solved = _least_squares(design, right, "conformal", where)
        left = right - design @ solved[0]
        # Not below what rounding leaves, so that exact points on a line do not decide.
        tried[each] = solved, float(left @ left) + 1e-20 * float(right @ right)
    if axes is not None:
        return tried[axes][0], axes
    redundancy = 2 * len(uv) - 4
    gain = 0.5 * redundancy * np.log(tried["left"][1] / max(tried["right"][1], 1e-300)) if redundancy else 0.0
    chosen = "right" if gain > SURE else "left"
    return tried[chosen][0], chosen


def _linear(
    order: int, uv: FloatArray, image: FloatArray, root: FloatArray, label: str, where: str | None
) -> tuple[FloatArray, float, FloatArray]:
    """Affine (order 1) or polynomial transformation: coefficients of col, then of row, condition and cofactors."""
    # Columns and rows share one design: solve it once for both.
    terms = basis(order, uv)
    solution, condition, cofactors = _least_squares(terms * root[:, None], image * root[:, None], label, where)
    both = np.kron(np.eye(2), cofactors).astype(np.float64)
    return solution.T.ravel(), condition, both


@dataclass(frozen=True, eq=False)
class _Projective(Problem[FloatArray]):
    """Residuals of a projective transformation in pixels, weighted."""

    uv: FloatArray
    image: FloatArray
    root: FloatArray
    where: str | None

    def linearise(self, state: FloatArray) -> Equations:
        design = (derivatives("projective", 1, state, self.uv)[0] * self.root[:, None, None]).reshape(-1, 8)
        equations = Equations(design, self._misclosure(state).ravel())
        _need_determined(equations, "projective", self.where)
        return equations

    def squares(self, state: FloatArray) -> float:
        return float((self._misclosure(state) ** 2).sum())

    def moved(self, state: FloatArray, step: FloatArray) -> FloatArray:
        return state + step

    def movement(self, state: FloatArray, trial: FloatArray, equations: Linearised, step: FloatArray) -> float:
        """Largest change of an observation, as a share of the size of the image."""
        moved = cast(Equations, equations).design @ step
        return float(np.abs(moved).max()) / max(1.0, float(np.abs(self.image).max()))

    def _misclosure(self, values: FloatArray) -> FloatArray:
        return (self.image - evaluate("projective", 1, values, self.uv)) * self.root[:, None]


def _projective(
    uv: FloatArray, image: FloatArray, root: FloatArray, where: str | None
) -> tuple[FloatArray, float, FloatArray]:
    """Projective transformation: direct linear start, then least squares of the residuals in pixels.

    The coefficients are a0, a1, a2, b0, b1, b2 in pixels, c1, c2 without unit, with condition and cofactors (8, 8).
    """
    # The direct linear solution minimises an algebraic error, in which distant points weigh more; only the second step
    # minimises what was measured.
    problem = _Projective(uv, image, root, where)
    solution = solve(problem, _direct_linear(uv, image, root, where), RULES)
    equations = cast(Equations, solution.equations)
    return solution.state, equations.condition()[0], equations.parameter_cofactors()


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
            hint="give four points or more, no three of the four on one line, or choose affine",
        )
    col, row, bottom = turned[-1].reshape(3, 3)
    w = one @ bottom
    if not ((w > 0.0).all() or (w < 0.0).all()):
        raise SolveError(
            "the control points lie on both sides of the horizon of the projective transformation they call for",
            where=where,
            hint="look for swapped or wrong points",
        )
    col, row = col * size + middle[0] * bottom, row * size + middle[1] * bottom
    values: FloatArray = np.concatenate([col, row, bottom[1:]]) / bottom[0]
    return values


@dataclass(frozen=True, eq=False, kw_only=True)
class PlanarFit(Transformation):
    """Plane transformation that was fitted to points, and how well it fits.

    Attributes
    ----------
    residuals : array (N, 2)
        Measured minus computed (col, row) in pixels.
    covariance : array (P, P)
        Of the coefficients, scaled by sigma0²; NaN without redundancy.
    sigma0 : float
        Standard deviation of an observation of weight 1, in pixels; NaN without redundancy.
    condition : float
        Of the design matrix with columns of length one; of a spline, of its matrix.
    """

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
    axes: str | None = None,
    where: str | None = None,
) -> PlanarFit:
    """Plane transformation ground → image by least squares.

    Parameters
    ----------
    kind : str
        'conformal', 'affine', 'projective', 'polynomial' or 'tps'.
    xy : array (N, 2)
        Map positions.
    colrow : array (N, 2)
        Measured image positions in pixels.
    weights : array (N,), optional
        1 / σ² of the measurements; all 1 when left out. A spline passes through all points whatever their weights.
    order : int
        Degree of a polynomial, 1 to 5.
    axes : str, optional
        Handedness of the image's axes for a conformal fit: 'left' (rows downwards), 'right' (rows upwards, or a
        mirrored image); recognised when left out.
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
        raise SolveError(
            "a control point has a coordinate that is not a number",
            where=where,
            hint="correct it, or leave the point out",
        )
    count, needed = len(ground), least_points(kind, order)
    label = f"{kind} of order {order}" if kind == "polynomial" else kind
    if count < needed:
        raise SolveError(
            f"{counted(count, 'control point')} do{'es' * (count == 1)} not determine {article(label)} "
            f"{label} transformation, which needs {needed}",
            where=where,
            hint="add points or choose a simpler kind: conformal needs 2, affine and tps 3, projective 4",
        )
    root = np.ones(count) if weights is None else np.sqrt(np.asarray(weights, dtype=np.float64))
    if not (np.isfinite(root) & (root > 0.0)).all():
        raise SolveError(
            "weights of control points must be positive numbers",
            where=where,
            hint="give numbers above 0, or leave the point out",
        )
    # The mean lies inside the points, so a projective denominator that is positive at all of them is so there.
    centre = ground.mean(axis=0)
    # Map coordinates of millions would leave few digits for the powers of a polynomial; normalised ones stay within ±1.
    scale = float(np.abs(ground - centre).max())
    if scale == 0.0:
        raise SolveError("all control points lie on one place", where=where, hint="spread them over the image")
    uv = (ground - centre) / scale
    if kind == "tps":
        return _spline(uv, image, centre, scale, where)
    handed = "left"
    if kind == "conformal":
        solved, handed = _conformal(uv, image, root, axes, where)
    elif kind == "projective":
        solved = _projective(uv, image, root, where)
    else:
        solved = _linear(order, uv, image, root, label, where)
    values, condition, cofactors = solved
    residuals = image - evaluate(kind, order, values, uv, handed)
    redundancy = 2 * count - len(values)
    weighted = residuals * root[:, None]
    sigma0 = sigma0_of((weighted**2).sum(), redundancy)
    covariance = cofactors * sigma0**2
    return PlanarFit(
        kind, order, centre, scale, values, handed,
        residuals=residuals, covariance=covariance, sigma0=sigma0, condition=condition,
    )  # fmt: skip


def _spline(uv: FloatArray, image: FloatArray, centre: FloatArray, scale: float, where: str | None) -> PlanarFit:
    """Spline through all points: nothing is left to estimate an error by."""
    spline.check_nodes(uv, where)
    solved = spline.solve(uv, image, where)
    residuals = image - spline.evaluate(uv, solved.coefficients, uv)
    values = image.T.ravel()
    unknown = np.broadcast_to(np.nan, (len(values), len(values)))
    return PlanarFit(
        "tps", 1, centre, scale, values, "left", uv, solved,
        residuals=residuals, covariance=unknown, sigma0=float("nan"), condition=solved.condition,
    )  # fmt: skip
