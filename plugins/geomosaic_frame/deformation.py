"""Deformation of a scanned film beyond what its fiducial marks tell: parameters of each photo, weighted by the marks.

The transformation between scan and film comes from a least squares fit to n measured marks, and is as uncertain as they
are: with four marks in the corners by as much as a mark itself. Adjusted together with the orientation, it is corrected
by shifts of the pixels

    shift(col, row) = Σ aₖ·Fₖ(col, row, 1)

with fields Fₖ of the kind of the fit that are orthonormal over the marks, Σᵢ Fₖ(markᵢ)·Fₗ(markᵢ) = δₖₗ. Residuals of
the fit are orthogonal to all fields; so the squares of the marks' residuals after a correction are those before and
Σ aₖ². The marks as observations of an adjustment are therefore the same as aₖ = 0 observed with the sigma of a mark.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from geomosaic.types import FloatArray


@dataclass(frozen=True, eq=False)
class Deformation:
    """Correction of the transformation from a film to its scan.

    Attributes
    ----------
    fields : array (U, 2, 3)
        Shifts in pixels of homogeneous (col, row, 1), orthonormal over the marks.
    values : array (U,)
        Their amounts.
    sigma : float
        A-priori standard deviation of each amount: that of a measured coordinate of a mark, pixels.
    """

    fields: FloatArray
    values: FloatArray
    sigma: float

    @classmethod
    def of_marks(cls, colrow: FloatArray, kind: str, sigma: float) -> Self:
        """No correction yet.

        Parameters
        ----------
        colrow : array (N, 2)
            The measured marks, pixels.
        kind : str
            'conformal' or 'affine', as the transformation.
        sigma : float
            Standard deviation of a measured coordinate, pixels.
        """
        middle = colrow.mean(axis=0)
        about = np.array([[1.0, 0.0, -middle[0]], [0.0, 1.0, -middle[1]], [0.0, 0.0, 1.0]])
        x, y, one = about
        zero = np.zeros(3)
        pairs = [(one, zero), (zero, one), (x, y), (-y, x)]
        if kind == "affine":
            pairs[2:] = [(x, zero), (zero, x), (y, zero), (zero, y)]
        plain = np.array(pairs)
        homogeneous = np.column_stack([colrow, np.ones(len(colrow))])
        design = np.einsum("uij,nj->niu", plain, homogeneous).reshape(-1, len(plain))
        fields = np.einsum("uij,uk->kij", plain, np.linalg.inv(np.linalg.qr(design)[1]))
        return cls(fields, np.zeros(len(fields)), sigma)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the amounts among the parameters of a photo."""
        return tuple(f"film_{index + 1}" for index in range(len(self.values)))

    @cached_property
    def matrix(self) -> FloatArray:
        """Homogeneous pixels as the marks give them → pixels (3, 3)."""
        corrected = np.eye(3)
        corrected[:2] += np.tensordot(self.values, self.fields, axes=1)
        return corrected

    def with_values(self, values: FloatArray) -> Self:
        """Correction of other amounts (U,)."""
        return replace(self, values=np.array(values, dtype=np.float64))

    def by_values(self, colrow: FloatArray) -> FloatArray:
        """Derivatives (N, 2, U) of corrected pixels (N, 2) by the amounts."""
        before = np.linalg.solve(self.matrix, np.column_stack([colrow, np.ones(len(colrow))]).T)
        out: FloatArray = np.einsum("uij,jn->niu", self.fields, before)
        return out

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {"fields": self.fields.tolist(), "values": self.values.tolist(), "sigma": self.sigma}

    @classmethod
    def from_dict(cls, state: Mapping[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""
        return cls(np.array(state["fields"]), np.array(state["values"]), float(state["sigma"]))
