"""Sparse normal equations of a block: solution, condition number, cofactors."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from geomosaic.types import FloatArray, IntArray

ITERATIONS = 60


@dataclass(frozen=True, eq=False)
class Normals:
    """Factored normal equations, columns of the design scaled to length one.

    Attributes
    ----------
    factors : SuperLU or None
        None where the factors break down: a rank defect to the last digit.
    matrix : sparse array (U, U)
        Scaled normal matrix.
    length : array (U,)
        Of the columns.
    """

    factors: Any
    matrix: Any
    length: FloatArray

    @classmethod
    def of(cls, design: Any) -> Normals:
        """Factor the normal equations of a weighted design (sparse, equations × unknowns)."""
        from scipy.sparse import diags_array
        from scipy.sparse.linalg import splu

        length = np.sqrt(np.asarray(design.multiply(design).sum(axis=0)).ravel())
        length = np.where(length > 0.0, length, 1.0)
        scaled = design @ diags_array(1.0 / length)
        matrix = (scaled.T @ scaled).tocsc()
        try:
            factors = splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
        except RuntimeError:  # exactly singular
            factors = None
        return cls(factors, matrix, length)

    def solve(self, right: FloatArray) -> FloatArray:
        """Unknowns (U,) or (U, R) of right-hand sides in the unscaled unknowns, refined once."""
        length = self.length if right.ndim == 1 else self.length[:, None]
        scaled = right / length
        first = self.factors.solve(scaled)
        refined: FloatArray = (first + self.factors.solve(scaled - self.matrix @ first)) / length
        return refined

    def condition(self) -> tuple[float, FloatArray]:
        """Condition number of the scaled design, and the direction (U,) that is determined worst.

        By power iteration on the normal matrix and on its inverse, from a fixed start.
        """
        size = self.matrix.shape[0]
        start = np.random.default_rng(0).normal(size=size)
        if self.factors is None:
            return np.inf, _null(self.matrix, start)
        most, _ = _largest(lambda v: self.matrix @ v, start)
        inverse, direction = _largest(self.factors.solve, start)
        return float(np.sqrt(most * inverse)), direction

    def cofactors(self, blocks: Iterable[tuple[IntArray, dict[Any, IntArray]]]) -> dict[Any, FloatArray]:
        """Parts of the inverse: for each (columns, {key: rows}) the array (rows, columns) under its key."""
        found: dict[Any, FloatArray] = {}
        size = len(self.length)
        for columns, wanted in blocks:
            right = np.zeros((size, len(columns)))
            right[columns, np.arange(len(columns))] = 1.0
            solved = self.solve(right)
            for key, rows in wanted.items():
                found[key] = solved[rows]
        return found


def _null(matrix: Any, start: FloatArray) -> FloatArray:
    """Direction (U,) that a singular matrix loses, by inverse iteration a hair beside it."""
    from scipy.sparse import eye_array
    from scipy.sparse.linalg import splu

    beside = splu((matrix + 1e-12 * eye_array(matrix.shape[0])).tocsc())
    return _largest(beside.solve, start)[1]


def _largest(apply: Any, start: FloatArray) -> tuple[float, FloatArray]:
    """Largest eigenvalue of a positive definite operator, and its vector."""
    vector, value = start / np.linalg.norm(start), 0.0
    for _ in range(ITERATIONS):
        turned = apply(vector)
        before, value = value, float(np.linalg.norm(turned))
        if not np.isfinite(value) or value == 0.0:
            return np.inf, vector
        vector = turned / value
        if abs(value - before) < 1e-6 * value:
            break
    return value, vector
