"""Weighted observation equations of one image or one body, and their least squares solution by singular values.

    v = w − A·dx,   |v|² least

Rows are over their standard deviations (whitened), and columns are brought to length one before anything is solved:
metres, degrees and pixels then count alike, and condition numbers say something about geometry.

These are the same equations, with the same questions asked of them, as those of a `network.Network`, solved another
way. A network eliminates object points and works on normal equations, which square the condition number: of unknowns
of condition 1e6 it gives 9 digits, of 1e7 five, from 1e9 on none, where singular values give 11, 10 and 8. Control of
one image leaves focal length and flying height as near to each other as that (`sensor.solve` names unknowns from 1e9
on). And where there is no point to eliminate there is nothing to gain: a step with its condition number takes 0.04 ms
for 12 points and 6 unknowns, as a network 2.4 ms; 3 and 5 ms for 1,000 points and 20 unknowns.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.types import FloatArray

# Share of the largest singular value below which a direction is not determined: some hundred roundings.
RANK = 1e-13
# Condition number from which on unknowns are not determined: their variances would have no digit.
SINGULAR = 1e12


class _Factors(NamedTuple):
    """Singular value decomposition of a design with columns of length one, A / L = U·S·Vᵀ."""

    length: FloatArray  # L (U,), 1 where a column is zero
    left: FloatArray  # U (R, U)
    singular: FloatArray  # S (U,), the largest first
    turned: FloatArray  # Vᵀ (U, U): directions in the scaled unknowns


@dataclass(frozen=True, eq=False)
class Equations:
    """Weighted observation equations v = w − A·dx.

    Attributes
    ----------
    design : array (R, U)
        A: derivatives of the computed observations by the unknowns, each row over its standard deviation.
    misclosure : array (R,) or (R, K)
        w: measured minus computed, over the standard deviations; K columns are K problems with one design.
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

    @property
    def determined(self) -> bool:
        """Whether the observations are enough for the unknowns, and tell them apart."""
        return self.redundancy >= 0 and self.condition()[0] < SINGULAR

    @cached_property
    def _factors(self) -> _Factors:
        # A column of zeros keeps its length of 1: it stays singular, and is named, in place of NaN everywhere.
        length = np.linalg.norm(self.design, axis=0)
        length = np.where(length > 0.0, length, 1.0)
        try:
            left, singular, turned = np.linalg.svd(self.design / length, full_matrices=False)
        except np.linalg.LinAlgError:  # a derivative is not finite, such as that of a point on a horizon
            raise SolveError(
                "the observations do not determine the unknowns: an equation has no finite coefficients",
                hint="look for observations that lie on one place or on one line",
            ) from None
        return _Factors(length, left, singular, turned)

    def condition(self) -> tuple[float, FloatArray]:
        """Condition number of the scaled design, and the direction (U,) that is determined worst."""
        if not self.design.shape[1]:
            return 1.0, np.zeros(0)
        _, _, singular, turned = self._factors
        return float(singular[0] / singular[-1]) if singular[-1] > 0.0 else float("inf"), turned[-1]

    def step(self, damping: float = 0.0) -> FloatArray:
        """Changes (U,) or (U, K) of the unknowns that minimise |w − A·dx|² + damping · |L·dx|², L the lengths of the
        columns; without damping the shortest of all, where the design has a rank defect.
        """
        if not self.design.shape[1]:
            return np.zeros((0, *self.misclosure.shape[1:]))
        length, left, singular, turned = self._factors
        if damping == 0.0:
            # What is lost to rounding is left out.
            root = turned.T / np.where(singular > RANK * singular[0], singular, np.inf)
        else:
            root = turned.T * (singular / (singular**2 + damping))
        return ((root @ (left.T @ self.misclosure)).T / length).T

    def residuals(self, step: FloatArray) -> FloatArray:
        """Weighted residuals (R,) or (R, K) of linearised equations after a step (U,) or (U, K)."""
        return self.misclosure - self.design @ step

    def parameter_cofactors(self) -> FloatArray:
        """Cofactors (AᵀA)⁻¹ (U, U) of the unknowns."""
        length, _, singular, turned = self._factors
        root = turned.T / singular
        return (root @ root.T) / np.outer(length, length)

    def redundancy_numbers(self, observations: int, size: int = 2) -> FloatArray:
        """Redundancy numbers I − A·(AᵀA)⁻¹·Aᵀ (N, K, K) of the first N observations, of K rows each."""
        if not self.design.shape[1]:
            return np.tile(np.eye(size), (observations, 1, 1))
        own = self._factors.left[: size * observations].reshape(observations, size, -1)
        numbers: FloatArray = np.eye(size) - np.einsum("nip,njp->nij", own, own)
        return numbers
