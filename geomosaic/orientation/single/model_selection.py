"""Selection of models by leave-one-out prediction, and of points by deletion of the worst (Jensen)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import numpy as np

from geomosaic.errors import GeomosaicError, InputError, SolveError, counted, listed
from geomosaic.estimation.blunders.least_trimmed_squares import FINEST
from geomosaic.estimation.statistics import signed_rank_probability, total_rms
from geomosaic.orientation.single.fit import ControlAdjustment, ControlFit, fit_problem
from geomosaic.orientation.single.problem import ControlProblem, registry_build
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.registry import plane_sensor
from geomosaic.types import AnyArray, BoolArray, FloatArray


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
    threshold : float or None
        Total RMS to come below, pixels.
    limits : tuple of float or None
        Largest residuals along columns and rows, pixels.
    reached : bool
    deleted : tuple of DeletedPoint
        In the order of deletion.
    fit : ControlFit
        To the points that remain, leave-one-out errors among it.
    kept : tuple of str
    summary : str
        How it ended, in a sentence.
    """

    threshold: float | None
    limits: tuple[float, float] | None
    reached: bool
    deleted: tuple[DeletedPoint, ...]
    fit: ControlFit
    kept: tuple[str, ...]
    summary: str


def delete_points(
    problem: ControlAdjustment, threshold: float | None = None, limits: tuple[float, float] | None = None
) -> Deletion:
    """Deletion of the worst point, fit after fit, until the total RMS is below a threshold and residuals within limits.

    Parameters
    ----------
    problem : ControlAdjustment
    threshold : float, optional
        Total RMS in pixels. While it is not reached, the point of the longest residual is the worst.
    limits : tuple of float, optional
        Largest residuals along columns and along rows in pixels, as both axes are judged by Bellman, Deakin and
        Rollings (1993). The worst point is the one that exceeds its limit by the largest factor.

    Returns
    -------
    Deletion
        `reached` is false where that would take more points than the kind can spare.

    Raises
    ------
    InputError
        A threshold or limit is not a positive number, or there is none.
    SolveError
        The points do not determine the model, or it passes through all of them.
    """
    # The RMS falls with every deletion whether or not the fit gets better, so deletion ends while one point more than
    # the kind needs is left: see the leave-one-out errors of the fit, and compare with data snooping.
    given = [*(() if threshold is None else (threshold,)), *(limits or ())]
    if not given or not all(np.isfinite(value) and value > 0.0 for value in given):
        shown = " and ".join(f"{value:g}" for value in given) or "nothing"
        raise InputError(
            f"a threshold of {shown} is not a positive number of pixels", hint="give pixels above 0, such as 2"
        )
    fit = fit_problem(problem)
    _need_residuals(fit)
    kept, rows = np.arange(len(problem)), list[DeletedPoint]()
    # One point more than needed stays: a fit through all of its points has an RMS of 0 whatever they are.
    while (worst := _worst(fit, threshold, limits)) is not None and len(kept) > _least_points(fit) + 1:
        rest = np.delete(kept, worst)
        try:
            after = fit_problem(problem.subset(rest))
        except SolveError as error:
            stuck = f"without '{problem.ids[kept[worst]]}' the points do not determine the fit: {error.what}"
            return _ended(problem, kept, rows, (threshold, limits), stuck)
        col, row = fit.residuals[worst].tolist()
        name = problem.ids[kept[worst]]
        rows.append(DeletedPoint(len(rows) + 1, name, (col, row), fit.rms_total, after.rms_total, len(rest)))
        kept, fit = rest, after
    return _ended(problem, kept, rows, (threshold, limits), None)


def _worst(fit: ControlFit, threshold: float | None, limits: tuple[float, float] | None) -> int | None:
    """Point to be deleted next; None where threshold and limits are kept."""
    if limits is not None:
        excess = (np.abs(fit.residuals) / np.array(limits)).max(axis=1)
        if not excess.max() <= 1.0:
            return int(np.argmax(excess))
    if threshold is not None and not fit.rms_total < threshold:
        return int(np.argmax(fit.lengths))
    return None


def _least_points(fit: ControlFit) -> int:
    """Fewest control points that determine the parameters of a fit: two equations each."""
    return -(-(2 * len(fit.ids) - fit.redundancy) // 2)


def _need_residuals(fit: ControlFit) -> None:
    """Check of the redundancy: residuals of a fit without any are 0 and tell nothing."""
    if fit.redundancy <= 0:
        raise SolveError(
            "the fit passes through all of its control points: their residuals say nothing about errors",
            hint="look for them with a kind of fewer parameters (not tps), or give more points",
        )


def _ended(
    problem: ControlAdjustment,
    kept: AnyArray,
    rows: list[DeletedPoint],
    criteria: tuple[float | None, tuple[float, float] | None],
    stuck: str | None,
) -> Deletion:
    fit, (threshold, limits) = problem.fit(kept), criteria
    reached = _worst(fit, threshold, limits) is None
    count = f"{counted(len(rows), 'point')} deleted"
    parts = []
    if threshold is not None:
        relation = "below" if fit.rms_total < threshold else "not below"
        parts.append(f"the total RMS of the {len(kept)} left is {fit.rms_total:.3g} px, {relation} {threshold:g} px")
    if limits is not None:
        col, row = np.abs(fit.residuals).max(axis=0).tolist()
        within = "within" if _worst(fit, None, limits) is None else "not within"
        parts.append(
            f"the largest residuals of the {len(kept)} left are {col:.3g} px in columns and {row:.3g} px in rows, "
            f"{within} {limits[0]:g} and {limits[1]:g} px"
        )
    summary = f"{count}: {', and '.join(parts)}"
    if not reached:
        summary += f"; {stuck or 'no more can be spared: one point more than the kind needs is left'}"
    return Deletion(threshold, limits, reached, tuple(rows), fit, fit.ids, summary)


# Options of the sensor of plane transformations for each kind, the simplest first; poly1 is affine.
PLANAR: Mapping[str, Mapping[str, Any]] = {
    "conformal": {"kind": "conformal"},
    "affine": {"kind": "affine"},
    "projective": {"kind": "projective"},
    **{f"poly{order}": {"kind": "polynomial", "order": order} for order in range(2, 6)},
    "tps": {"kind": "tps"},
}
# Probability by chance below which a richer kind's smaller errors count.
SIGNIFICANT = 0.02
# Points below which no test can tell; the gain must then be threefold.
FEW = 6
# Kinds that only a distorted image calls for. None of them is its nature, so that the spline needs no significance
# against the others. Measured over 40 sets each of 20 to 80 points in bumps of 0.2 to 1 px noise, true RMS error with
# and without it: 0.76 and 1.02 px, 0.68 and 0.98 px; in surfaces of third and fourth order at most 4 % are lost,
# in the noisiest bumps of few points up to 10 %.
DISTORTED_MODELS, SPLINE = ("poly3", "poly4", "poly5", "tps"), "tps"
# A point that kinds miss by so many times their median error is left out of the comparison.
OUTLYING = 6.0


@dataclass(frozen=True, eq=False)
class Candidate:
    """Candidate of the selection: one row of its table.

    Attributes
    ----------
    name : str
    parameters : int
        Free ones, in col and row together.
    redundancy : int
    rms : float
        Total RMS of the residuals, pixels.
    leave_one_out : float
        RMS length of the leave-one-out errors, pixels, over the points compared; NaN where it could not be had.
    gain : float
        Probability of errors so much smaller than those of the kind preferred before it, by chance; NaN for the first.
    refused : str
        Why the kind is not possible; empty where it is.
    fit : ControlFit or None
    """

    name: str
    parameters: int
    redundancy: int
    rms: float
    leave_one_out: float
    gain: float
    refused: str
    fit: ControlFit | None


@dataclass(frozen=True, eq=False)
class ModelChoice:
    """Choice of a kind of fit.

    Attributes
    ----------
    name : str
    fit : ControlFit
    table : tuple of Candidate
        The simplest first.
    outliers : tuple of str
        Points that no kind predicts: left out of the comparison, though not of the fits.
    summary : str
        Why, in a sentence.
    """

    name: str
    fit: ControlFit
    table: tuple[Candidate, ...]
    outliers: tuple[str, ...]
    summary: str


def planar_problems(
    request: SensorRequest,
    ids: Sequence[str],
    ground: AnyArray,
    colrow: AnyArray,
    sigma: AnyArray | float | None = None,
) -> dict[str, ControlProblem]:
    """Problems of every kind of `PLANAR`.

    Parameters
    ----------
    request : SensorRequest
        Image, size and CRS.
    ids, ground, colrow, sigma
        See `ControlProblem.of`.
    """
    return {
        name: ControlProblem.of(
            registry_build(plane_sensor(), replace(request, options={**request.options, **options}), ground, colrow),
            ids,
            ground,
            colrow,
            sigma,
        )
        for name, options in PLANAR.items()
    }


def choose_model(problems: Mapping[str, ControlProblem]) -> ModelChoice:
    """Choice among kinds of fit by their leave-one-out errors.

    The kinds are gone through from the simplest. A kind takes the place of the one preferred so far if its
    leave-one-out RMS is smaller, and the errors of the same points are smaller beyond chance (Wilcoxon's signed-rank
    test, 2 %, one-sided); with fewer than six points, which no test can tell apart, if the RMS is less than a third.
    The spline takes the place of a polynomial of third or higher order wherever its leave-one-out RMS is smaller.

    Parameters
    ----------
    problems : mapping of str to ControlProblem
        Of the same points, the simplest kind first.

    Raises
    ------
    SolveError
        No kind leaves a point to judge it by.
    """
    ids = next(iter(problems.values())).ids
    fits: dict[str, ControlFit | str] = {}
    for name, problem in problems.items():
        try:
            fits[name] = fit_problem(problem, omission=True)
        except GeomosaicError as error:
            fits[name] = error.what
    lengths = {
        name: np.hypot(*fit.leave_one_out.T)
        for name, fit in fits.items()
        if not isinstance(fit, str) and np.isfinite(fit.leave_one_out).all(axis=1).sum() >= 0.5 * len(ids)
    }
    if not lengths:
        raise SolveError(
            f"{counted(len(ids), 'control point')} leave{'s' * (len(ids) == 1)} none to choose a kind of fit by",
            hint="give more points, or name the kind; conformal needs 3 to be chosen",
        )
    outliers = _outliers(list(lengths.values()))
    chosen, gains = "", dict[str, float]()
    for name, errors in lengths.items():
        if not chosen:
            chosen = name
            continue
        gains[name] = _gain(lengths[chosen], errors, ~outliers)
        limit = 1.0 if name == SPLINE and chosen in DISTORTED_MODELS else SIGNIFICANT
        if gains[name] < limit:
            chosen = name
    table = tuple(
        _row(name, fit, name in lengths, gains.get(name, float("nan")), ~outliers) for name, fit in fits.items()
    )
    best = cast(ControlFit, fits[chosen])  # what failed has no lengths to be chosen by
    names = tuple(name for name, out in zip(ids, outliers, strict=True) if out)
    return ModelChoice(chosen, best, table, names, _summary(chosen, table, names))


def _outliers(lengths: Sequence[FloatArray]) -> BoolArray:
    """Outliers (N,): points that the better half of the kinds miss by far more than they miss others."""
    # The worse half may miss all points: a blunder bends kinds of many parameters everywhere.
    count = len(lengths[0])
    better = sorted(lengths, key=lambda errors: float(np.nanmedian(errors)))[: -(-len(lengths) // 2)]
    outliers = np.full(count, count >= 8)
    for errors in better:
        outliers &= ~(errors <= OUTLYING * max(float(np.nanmedian(errors)), FINEST))
    return outliers


def _gain(before: FloatArray, after: FloatArray, compared: BoolArray) -> float:
    """Probability by chance of errors (N,) so much smaller than those before; 1 where their RMS is not smaller."""
    both = compared & np.isfinite(before) & np.isfinite(after)
    first, second = before[both], after[both]
    old, new = float(np.sqrt((first**2).mean())), float(np.sqrt((second**2).mean()))
    # Differences of rounding are none.
    if not both.any() or both.sum() < 0.5 * np.isfinite(before).sum() or not new < old or old < 1e-6:
        return 1.0
    if both.sum() < FEW:
        # Of five pairs the smallest probability that the test can give is 1/32, above the limit.
        return 0.0 if new < old / 3.0 else 1.0
    return signed_rank_probability(first - second)


def _row(name: str, fit: ControlFit | str, compared: bool, gain: float, points: BoolArray) -> Candidate:
    if isinstance(fit, str):
        nan = float("nan")
        return Candidate(name, 0, 0, nan, nan, nan, fit, None)
    error = total_rms(fit.leave_one_out[points])
    refused = "" if compared else "it takes all points to determine it: none can be left out to judge it by"
    free = 2 * len(fit.ids) - fit.redundancy
    return Candidate(name, free, fit.redundancy, fit.rms_total, error, gain, refused, fit)


def _summary(chosen: str, table: tuple[Candidate, ...], outliers: tuple[str, ...]) -> str:
    rows = [row for row in table if not row.refused]
    own = next(row for row in rows if row.name == chosen)
    text = f"{chosen}: points left out of the fit are predicted within {own.leave_one_out:.3g} px (RMS)"
    simpler = [row for row in rows if row.parameters < own.parameters]
    if simpler:
        nearest = min(simpler, key=lambda row: row.leave_one_out)
        text += f", by the best simpler kind ({nearest.name}) within {nearest.leave_one_out:.3g} px"
    richer = [row for row in rows if row.parameters > own.parameters]
    if richer:
        nearest = min(richer, key=lambda row: row.leave_one_out)
        verdict = "no better" if nearest.leave_one_out >= own.leave_one_out else "not better beyond chance"
        text += f"; {nearest.name}, with more parameters, is {verdict} ({nearest.leave_one_out:.3g} px)"
    if outliers:
        text += f"; no kind predicts {listed(outliers)}: look at them first"
    return text
