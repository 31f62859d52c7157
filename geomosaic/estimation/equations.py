"""Weighted observation equations and their least squares solution, dense or sparse.

    v = w − A·dx,   |v|² least

Rows are over their standard deviations (whitened), and columns are brought to length one before anything is solved:
metres, degrees and pixels then count alike, and condition numbers say something about geometry. Dense equations are
solved by singular values, sparse ones by a factorisation of their normal equations AᵀA.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.types import FloatArray, IntArray

# Of Lanczos' iteration; it ends sooner where the eigenvalue has six digits.
ITERATIONS = 60
# Share of the largest singular value below which a direction is not determined: some hundred roundings.
RANK = 1e-13
# Added to the diagonal of a singular normal matrix, so that inverse iteration finds the direction it loses.
BESIDE = 1e-12


@dataclass(frozen=True, eq=False)
class Equations:
    """Weighted observation equations v = w − A·dx.

    Attributes
    ----------
    design : array or sparse array (R, U)
        A: derivatives of the computed observations by the unknowns, each row over its standard deviation.
    misclosure : array (R,)
        w: measured minus computed, over the standard deviations.
    """

    design: Any
    misclosure: FloatArray

    @classmethod
    def stacked(cls, *groups: Equations) -> Equations:
        """Dense equations of several groups of observations of the same unknowns."""
        return cls(np.vstack([one.design for one in groups]), np.concatenate([one.misclosure for one in groups]))

    @property
    def redundancy(self) -> int:
        """Observations less unknowns."""
        rows, unknowns = self.design.shape
        return int(rows - unknowns)

    @property
    def is_sparse(self) -> bool:
        """Whether the design is a sparse array."""
        return not isinstance(self.design, np.ndarray)

    @cached_property
    def singular_values(self) -> SingularValues:
        """Decomposition of a dense design, computed once."""
        return SingularValues.of(self.design)

    @cached_property
    def normals(self) -> NormalEquations:
        """Factorised normal equations of a sparse design, computed once."""
        return NormalEquations.of(self.design)

    def condition(self) -> tuple[float, FloatArray]:
        """Condition number of the scaled design, and the direction (U,) that is determined worst."""
        if not self.design.shape[1]:
            return 1.0, np.zeros(0)
        return self.normals.condition() if self.is_sparse else self.singular_values.condition()

    def step(self, damping: float = 0.0) -> FloatArray:
        """Changes (U,) of the unknowns that minimise |w − A·dx|² + damping · |L·dx|², L the lengths of the columns."""
        if not self.design.shape[1]:
            return np.zeros(0)
        if self.is_sparse:
            return self.normals.damped(damping).solve(self.design.T @ self.misclosure)
        return self.singular_values.solve(self.misclosure, damping)

    def residuals(self, step: FloatArray) -> FloatArray:
        """Weighted residuals (R,) of linearised equations after a step (U,)."""
        left: FloatArray = self.misclosure - self.design @ step
        return left


@dataclass(frozen=True, eq=False)
class SingularValues:
    """Singular value decomposition of a dense design, A / L = U·S·Vᵀ.

    Attributes
    ----------
    length : array (U,)
        L: lengths of the columns, 1 where a column is zero.
    left : array (R, U)
    singular : array (U,)
    turned : array (U, U)
        Vᵀ: directions in the scaled unknowns, the best determined first.
    """

    length: FloatArray
    left: FloatArray
    singular: FloatArray
    turned: FloatArray

    @classmethod
    def of(cls, design: FloatArray) -> SingularValues:
        """Decomposition of a weighted design (R, U)."""
        # A column of zeros keeps its length of 1: it stays singular, and is named, in place of NaN everywhere.
        length = np.linalg.norm(design, axis=0)
        length = np.where(length > 0.0, length, 1.0)
        try:
            left, singular, turned = np.linalg.svd(design / length, full_matrices=False)
        except np.linalg.LinAlgError:  # a derivative is not finite, such as that of a point on a horizon
            raise SolveError(
                "the observations do not determine the unknowns: an equation has no finite coefficients",
                hint="look for observations that lie on one place or on one line",
            ) from None
        return cls(length, left, singular, turned)

    def solve(self, right: FloatArray, damping: float = 0.0) -> FloatArray:
        """Unknowns (U,) or (U, K) of right-hand sides (R,) or (R, K) in the rows of the design."""
        if damping == 0.0:
            # What is lost to rounding is left out: of all solutions the shortest, where the design has a rank defect.
            known = self.singular > RANK * self.singular[0]
            root = self.turned.T / np.where(known, self.singular, np.inf)
        else:
            root = self.turned.T * (self.singular / (self.singular**2 + damping))
        solution: FloatArray = ((root @ (self.left.T @ right)).T / self.length).T
        return solution

    def condition(self) -> tuple[float, FloatArray]:
        """Condition number, and the direction (U,) in the scaled unknowns that is determined worst."""
        if not self.singular[-1] > 0.0:
            return float("inf"), self.turned[-1]
        return float(self.singular[0] / self.singular[-1]), self.turned[-1]

    def cofactors(self) -> FloatArray:
        """Cofactor matrix (AᵀA)⁻¹ (U, U) of the unknowns."""
        root = self.turned.T / self.singular
        inverse: FloatArray = (root @ root.T) / np.outer(self.length, self.length)
        return inverse


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Factorised normal equations of a sparse design.

    Attributes
    ----------
    factors : SuperLU or None
        None where the factorisation breaks down: a rank defect to the last digit.
    matrix : sparse array (U, U)
        AᵀA with scaled columns.
    length : array (U,)
        Lengths of the columns, 1 where a column is zero.
    """

    factors: Any
    matrix: Any
    length: FloatArray

    @classmethod
    def of(cls, design: Any) -> NormalEquations:
        """Normal equations of a weighted sparse design (R, U)."""
        from scipy.sparse import diags_array

        length = np.sqrt(np.asarray(design.multiply(design).sum(axis=0)).ravel())
        length = np.where(length > 0.0, length, 1.0)
        scaled = design @ diags_array(1.0 / length)
        matrix = (scaled.T @ scaled).tocsc()
        return cls(_factorised(matrix), matrix, length)

    def damped(self, damping: float) -> NormalEquations:
        """Normal equations with a damping added to the diagonal of the scaled matrix."""
        if damping == 0.0:
            return self
        from scipy.sparse import eye_array

        matrix = (self.matrix + damping * eye_array(len(self.length))).tocsc()
        return NormalEquations(_factorised(matrix), matrix, self.length)

    def solve(self, right: FloatArray) -> FloatArray:
        """Unknowns (U,) or (U, K) of right-hand sides Aᵀw in the unknowns, refined once."""
        if self.factors is None:
            return np.full(right.shape, np.nan)
        length = self.length if right.ndim == 1 else self.length[:, None]
        scaled = right / length
        first = self.factors.solve(scaled)
        # Normal equations square the condition number; one refinement gives the lost digits back.
        refined: FloatArray = (first + self.factors.solve(scaled - self.matrix @ first)) / length
        return refined

    def condition(self) -> tuple[float, FloatArray]:
        """Condition number of the scaled design, and the direction (U,) that is determined worst."""
        # By iterations on the normal matrix and on its inverse, from a fixed start: the same on every run.
        size = self.matrix.shape[0]
        start = np.random.default_rng(0).normal(size=size)
        if self.factors is None:
            from scipy.sparse import eye_array

            return np.inf, largest_eigenvalue(
                _factorised((self.matrix + BESIDE * eye_array(size)).tocsc()).solve, start
            )[1]
        most, _ = largest_eigenvalue(lambda v: self.matrix @ v, start)
        inverse, direction = largest_eigenvalue(self.factors.solve, start)
        return float(np.sqrt(most * inverse)), direction

    def cofactor_blocks(self, blocks: Iterable[tuple[IntArray, dict[Any, IntArray]]]) -> dict[Any, FloatArray]:
        """Blocks of the inverse: for each (columns, {key: rows}) the array (rows, columns) under its key."""
        found: dict[Any, FloatArray] = {}
        size = len(self.length)
        for columns, wanted in blocks:
            right = np.zeros((size, len(columns)))
            right[columns, np.arange(len(columns))] = 1.0
            solved = self.solve(right)
            for key, rows in wanted.items():
                found[key] = solved[rows]
        return found


def _factorised(matrix: Any) -> Any:
    """SuperLU factors of a symmetric matrix, unpivoted to keep the fill-in low; None where it is singular."""
    from scipy.sparse.linalg import splu

    try:
        return splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    except RuntimeError:
        return None


def largest_eigenvalue(apply: Callable[[FloatArray], FloatArray], start: FloatArray) -> tuple[float, FloatArray]:
    """Largest eigenvalue of a positive definite operator, and its vector.

    Parameters
    ----------
    apply : callable
        The operator, of vectors (U,).
    start : array (U,)
        Any vector with a share of the one that is looked for.

    Returns
    -------
    value : float
        Inf where the operator gives numbers that are not finite.
    vector : array (U,)
    """
    from scipy.linalg import eigh_tridiagonal

    # Lanczos (1950), every vector made orthogonal to all before it: a dozen products in place of a power iteration's
    # hundreds, whose vector was still a mixture where two directions are determined equally badly.
    rounds = min(ITERATIONS, len(start))
    basis, diagonal, beside = np.zeros((rounds + 1, len(start))), list[float](), list[float]()
    basis[0] = start / np.linalg.norm(start)
    value, shares = 0.0, np.ones(1)
    for k in range(rounds):
        turned = apply(basis[k])
        if not np.isfinite(turned).all():
            return np.inf, basis[k]
        diagonal.append(float(basis[k] @ turned))
        for _ in range(2):
            turned = turned - basis[: k + 1].T @ (basis[: k + 1] @ turned)
        beside.append(float(np.linalg.norm(turned)))
        values, vectors = eigh_tridiagonal(diagonal, beside[:-1])
        value, shares = float(values[-1]), vectors[:, -1]
        # The error of the value is of the second order in this: it has six digits.
        if beside[-1] * abs(shares[-1]) <= 1e-3 * value:
            break
        basis[k + 1] = turned / beside[-1]
    vector: FloatArray = basis[: len(shares)].T @ shares
    return value, vector
