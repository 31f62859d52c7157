"""Weighted observation equations and their least squares solution, dense.

    v = w − A·dx,   |v|² least

Rows are over their standard deviations (whitened), and columns are brought to length one before anything is solved:
metres, degrees and pixels then count alike, and condition numbers say something about geometry. Equations are solved by
singular values; those of many images, which are sparse, are a `network.Network`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.types import FloatArray

# Share of the largest singular value below which a direction is not determined: some hundred roundings.
RANK = 1e-13


@dataclass(frozen=True, eq=False)
class Equations:
    """Weighted observation equations v = w − A·dx.

    Attributes
    ----------
    design : array (R, U)
        A: derivatives of the computed observations by the unknowns, each row over its standard deviation.
    misclosure : array (R,)
        w: measured minus computed, over the standard deviations.
    """

    design: FloatArray
    misclosure: FloatArray

    @classmethod
    def stacked(cls, *groups: Equations) -> Equations:
        """Equations of several groups of observations of the same unknowns."""
        return cls(np.vstack([one.design for one in groups]), np.concatenate([one.misclosure for one in groups]))

    @property
    def redundancy(self) -> int:
        """Observations less unknowns."""
        rows, unknowns = self.design.shape
        return int(rows - unknowns)

    @cached_property
    def singular_values(self) -> SingularValues:
        """Decomposition of a dense design, computed once."""
        return SingularValues.of(self.design)

    def condition(self) -> tuple[float, FloatArray]:
        """Condition number of the scaled design, and the direction (U,) that is determined worst."""
        if not self.design.shape[1]:
            return 1.0, np.zeros(0)
        return self.singular_values.condition()

    def step(self, damping: float = 0.0) -> FloatArray:
        """Changes (U,) of the unknowns that minimise |w − A·dx|² + damping · |L·dx|², L the lengths of the columns."""
        if not self.design.shape[1]:
            return np.zeros(0)
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
