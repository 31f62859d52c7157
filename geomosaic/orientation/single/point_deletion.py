"""Point deletion (Jensen, geometric correction): the worst point out, fit again, until the RMS is small enough."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.errors import InputError, SolveError
from geomosaic.orientation.single.fit import ControlAdjustment, ControlFit, fit_problem
from geomosaic.orientation.single.problem import Build
from geomosaic.types import AnyArray


@dataclass(frozen=True)
class DeletedPoint:
    """Deleted point: one row of the table of deletions.

    Attributes
    ----------
    order : int
        1 for the point deleted first.
    id : str
    residual : tuple of float
        Of col and row in the last fit that had it, pixels.
    rms_before, rms_after : float
        Total RMS of the control points with and without it, pixels.
    left : int
        Points that remain.
    """

    order: int
    id: str
    residual: tuple[float, float]
    rms_before: float
    rms_after: float
    left: int


@dataclass(frozen=True, eq=False)
class Deletion:
    """Result of point deletion.

    Attributes
    ----------
    threshold : float
        Total RMS to come below, pixels.
    reached : bool
    deleted : tuple of DeletedPoint
        In the order of deletion.
    fit : ControlFit
        To the points that remain, leave-one-out errors among it.
    kept : tuple of str
    summary : str
        How it ended, in a sentence.
    """

    threshold: float
    reached: bool
    deleted: tuple[DeletedPoint, ...]
    fit: ControlFit
    kept: tuple[str, ...]
    summary: str


def delete_points(
    build: Build,
    ids: Sequence[str],
    ground: AnyArray,
    colrow: AnyArray,
    sigma: AnyArray | float | None = None,
    *,
    threshold: float,
) -> Deletion:
    """Deletion of the point of largest residual, fit after fit, until the total RMS is below a threshold.

    Parameters
    ----------
    build, ids, ground, colrow, sigma
        See `fit.fit_control`.
    threshold : float
        Total RMS in pixels.

    Returns
    -------
    Deletion
        `reached` is false where the threshold would take more points than the kind can spare.

    Raises
    ------
    InputError
        The threshold is not a positive number.
    SolveError
        The points do not determine the model, or it passes through all of them.
    """
    # The RMS falls with every deletion whether or not the fit gets better, so deletion ends while one point more than
    # the kind needs is left: see the leave-one-out errors of the fit, and compare with data snooping.
    if not (np.isfinite(threshold) and threshold > 0.0):
        raise InputError(f"a threshold of {threshold} is not a positive number of pixels")
    problem = ControlAdjustment.of(build, ids, ground, colrow, sigma)
    fit = fit_problem(problem)
    _need_residuals(fit)
    kept, rows = np.arange(len(problem)), list[DeletedPoint]()
    # One point more than needed stays: a fit through all of its points has an RMS of 0 whatever they are.
    while not fit.rms_total < threshold and len(kept) > least_points(fit) + 1:
        worst = int(np.argmax(fit.lengths))
        rest = np.delete(kept, worst)
        try:
            after = fit_problem(problem.subset(rest))
        except SolveError as error:
            summary = f"without '{problem.ids[kept[worst]]}' the points do not determine the fit: {error.what}"
            return _ended(problem, kept, rows, threshold, summary)
        col, row = fit.residuals[worst].tolist()
        name = problem.ids[kept[worst]]
        rows.append(DeletedPoint(len(rows) + 1, name, (col, row), fit.rms_total, after.rms_total, len(rest)))
        kept, fit = rest, after
    return _ended(problem, kept, rows, threshold, None)


def least_points(fit: ControlFit) -> int:
    """Fewest control points that determine the parameters of a fit: two equations each.

    Parameters
    ----------
    fit : ControlFit
    """
    return -(-(2 * len(fit.ids) - fit.redundancy) // 2)


def _need_residuals(fit: ControlFit) -> None:
    """Check of the redundancy: residuals of a fit without any are 0 and tell nothing."""
    if fit.redundancy <= 0:
        raise SolveError(
            "the fit passes through all of its control points: their residuals say nothing about errors",
            hint="look for them with a kind of fewer parameters (not tps), or give more points",
        )


def _ended(
    problem: ControlAdjustment, kept: AnyArray, rows: list[DeletedPoint], threshold: float, stuck: str | None
) -> Deletion:
    fit = problem.fit(kept)
    reached = fit.rms_total < threshold
    count = f"{len(rows)} point{'s' * (len(rows) != 1)} deleted"
    if reached:
        summary = f"{count}: the total RMS of the {len(kept)} left is {fit.rms_total:.3g} px, below {threshold:g} px"
    else:
        why = stuck or "no more can be spared: one point more than the kind needs is left"
        summary = f"{count}, and the total RMS of {fit.rms_total:.3g} px is not below {threshold:g} px; {why}"
    return Deletion(threshold, reached, tuple(rows), fit, fit.ids, summary)
