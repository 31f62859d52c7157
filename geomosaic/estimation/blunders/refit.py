"""Repeatable fit to any choice of points, as searches for blunders need it."""

from __future__ import annotations

from typing import Any, Protocol, TypeVar

from geomosaic.estimation.statistics import tail_probability
from geomosaic.types import AnyArray, BoolArray, FloatArray


class PointFit(Protocol):
    """Least squares fit to points, as far as a search asks about it."""

    @property
    def sigma0(self) -> float:
        """Standard deviation of unit weight."""

    @property
    def redundancy(self) -> int:
        """Observations less unknowns."""


Fit = TypeVar("Fit", bound=PointFit, covariant=True)


class Refit(Protocol[Fit]):
    """Points with a model that is fitted to any choice of them.

    Fits raise `SolveError` where the points chosen do not determine the model.
    """

    @property
    def ids(self) -> tuple[str, ...]:
        """Names of the N points."""

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations (N,) of their image coordinates, pixels; relative ones will do."""

    @property
    def magnitude(self) -> float:
        """Largest absolute image coordinate, pixels: what rounding is relative to."""

    def __len__(self) -> int: ...

    def model(self, selection: AnyArray | None = None, sigma: FloatArray | None = None) -> Any:
        """Model fitted to a bool (N,) or int (K,) selection; `sigma` (N,) replaces that of all points."""

    def free_parameters(self, model: Any) -> int:
        """Number of parameters that were estimated."""

    def errors(self, model: Any) -> FloatArray:
        """Measured minus computed (N, 2) of all points, pixels; NaN where a model does not see one."""

    def fit(self, kept: AnyArray) -> Fit:
        """Fit to a selection, with all its statistics."""

    def statistics(self, kept: BoolArray) -> tuple[Fit, FloatArray]:
        """Fit to a selection, and how much each point (N,) contradicts it, see `Cofactors.deletion_statistic`."""


def error_probabilities(problem: Refit[Fit], kept: BoolArray, scale: float, freedom: float) -> FloatArray:
    """Probability (N,) of the error of each point by chance, under the fit to the points kept (N,).

    Parameters
    ----------
    problem : Refit
    kept : bool array (N,)
    scale, freedom : float
        Standard deviation of unit weight, and the redundancy it rests on (inf where it is known).
    """
    return tail_probability(problem.statistics(kept)[1], scale, freedom)
