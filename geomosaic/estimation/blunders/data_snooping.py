"""Data snooping after Baarda (1968) and an M-estimator: two ways that should find the same blunders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic

import numpy as np

from geomosaic.errors import SolveError, counted, listed
from geomosaic.estimation.blunders.least_trimmed_squares import (
    Fit,
    Refit,
    RobustStart,
    error_probabilities,
    trimmed_start,
)
from geomosaic.estimation.statistics import biweight, log_chi_squared_tail
from geomosaic.types import BoolArray, FloatArray, IntArray

# Baarda's usual probability of rejecting a good point, for one test.
ALPHA = 0.001
# Points of which one is rejected, or readmitted, before the next fit: of more, as many as keep this share. The fits of
# thousands of blunders, one at a time, would take hours.
ONE_OF = 1000


@dataclass(frozen=True, eq=False)
class Snooping(Generic[Fit]):
    """Result of data snooping.

    Attributes
    ----------
    blunders : tuple of str
        In the order of their rejection.
    readmitted : tuple of str
        Rejected on the way and readmitted: errors of others had shown in them.
    probability : array (N,)
        Of the error of each point under the last fit, by chance alone.
    alpha : float
        Probability below which a point is rejected.
    scale : float
        Standard deviation of unit weight that the tests used.
    freedom : float
        Redundancy it rests on.
    fit : PointFit
        To the points kept, with leave-one-out errors.
    """

    blunders: tuple[str, ...]
    readmitted: tuple[str, ...]
    probability: FloatArray
    alpha: float
    scale: float
    freedom: float
    fit: Fit


def snoop(problem: Refit[Fit], start: RobustStart, *, alpha: float = ALPHA) -> Snooping[Fit]:
    """Data snooping: the point of least probable error is rejected and the rest fitted again, until all may be chance.

    Parameters
    ----------
    problem : Refit
    start : RobustStart
        Its scale is used, because that of a fit with several blunders hides them all.
    alpha : float
        Probability below which an error is no chance.
    """
    scale, freedom = start.scale, float(start.freedom)
    kept, order = np.ones(len(problem), dtype=np.bool_), list[int]()
    try:
        probability = error_probabilities(problem, kept, scale, freedom)
    except SolveError:  # all points together contradict each other too much for any fit
        kept = start.inliers.copy()
        order = np.flatnonzero(~kept).tolist()
        probability = error_probabilities(problem, kept, scale, freedom)
    while kept.sum() > start.needed + 1:
        # Few at a time: the largest blunder also shows in the residuals of good points (masking, swamping).
        worst = np.argsort(np.where(kept, probability, np.inf), kind="stable")[: max(1, len(kept) // ONE_OF)]
        worst = worst[probability[worst] < alpha]
        if not len(worst):
            break
        try:
            fewer = kept.copy()
            fewer[worst] = False
            probability = error_probabilities(problem, fewer, scale, freedom)
        except SolveError:
            break
        kept = fewer
        order += worst.tolist()
    kept, probability, back = _readmit(problem, kept, probability, alpha, scale, freedom)
    names = tuple(problem.ids[i] for i in order if not kept[i])
    again = tuple(problem.ids[i] for i in back)
    last = problem.fit(kept)
    return Snooping(names, again, probability, alpha, scale, freedom, last)


def _readmit(
    problem: Refit[Fit], kept: BoolArray, probability: FloatArray, alpha: float, scale: float, freedom: float
) -> tuple[BoolArray, FloatArray, list[int]]:
    """Readmission of rejected points, the best first, as long as no point that takes part fails for it."""
    back: list[int] = []
    while not kept.all():
        # What no fit could judge (NaN) is tried first: a fit with it can.
        likely = np.where(kept, -1.0, np.nan_to_num(probability, nan=1.0))
        best = np.argsort(-likely, kind="stable")[: max(1, len(kept) // ONE_OF)]
        best = best[~kept[best] & ~(probability[best] < alpha)]
        if not len(best):
            break
        more = kept.copy()
        more[best] = True
        try:
            found = error_probabilities(problem, more, scale, freedom)
        except SolveError:
            break
        if (found[more] < alpha).any():
            break
        kept, probability = more, found
        back += best.tolist()
    return kept, probability, back


def chance_errors(statistic: FloatArray, freedom: IntArray, alpha: float = ALPHA, unit: float = 1.0) -> BoolArray:
    """Whether errors (N,) may be chance: those of measurements made by a program, whose number makes refits needless.

    Parameters
    ----------
    statistic : array (N,)
        Weighted sums of squares; NaN is no chance.
    freedom : int array (N,)
        Redundant observations in each.
    alpha : float
        Probability below which an error is no chance.
    unit : float
        Variance of unit weight.
    """
    return np.asarray(log_chi_squared_tail(statistic / unit, freedom) >= np.log(alpha))


# Standard deviations at which a point loses all weight: 95 % efficiency for normal errors in two axes.
TUKEY = 5.12
# Weight below which a point takes no part: its standard deviation would be a thousand times the given one.
LEAST_WEIGHT = 1e-6
# Reweightings at most.
ROUNDS = 100
# Largest change of a weight at which the iteration has come to rest.
SETTLED = 1e-6


@dataclass(frozen=True, eq=False)
class MEstimate(Generic[Fit]):
    """Result of iteratively reweighted least squares.

    Attributes
    ----------
    blunders : tuple of str
        Points whose error is no chance, in the order of the control.
    weights : array (N,)
        Tukey's, 0 to 1, at the end.
    residuals : array (N, 2)
        Of all points, pixels, under the weighted fit.
    probability : array (N,)
        Of the error of each point, by chance alone, under the fit to the others that are no blunders.
    scale : float
        Standard deviation of unit weight.
    fit : PointFit
        Least squares on the points that are no blunders, with leave-one-out errors.
    rounds : int
    settled : bool
        Whether the weights came to rest.
    """

    blunders: tuple[str, ...]
    weights: FloatArray
    residuals: FloatArray
    probability: FloatArray
    scale: float
    fit: Fit
    rounds: int
    settled: bool


@dataclass(frozen=True, eq=False)
class BlunderSearch(Generic[Fit]):
    """Result of both methods.

    Attributes
    ----------
    snooping : Snooping
    estimate : MEstimate
    agree : bool
    blunders : tuple of str
        Found by both.
    breakdown_point : float
        Share of blunders that the samples of the start can bear; 0.5 where all samples were tried.
    summary : str
        In a sentence or two.
    distorted : tuple of str
        Rejected by one or both, but explained by a smooth distortion of the image.
    """

    snooping: Snooping[Fit]
    estimate: MEstimate[Fit]
    agree: bool
    blunders: tuple[str, ...]
    breakdown_point: float
    summary: str
    distorted: tuple[str, ...] = ()

    @property
    def suspected(self) -> tuple[str, ...]:
        """Points that at least one of the two methods rejects."""
        return tuple(dict.fromkeys((*self.snooping.blunders, *self.estimate.blunders)))


def search_blunders(problem: Refit[Fit]) -> BlunderSearch[Fit]:
    """Blunders by data snooping and by an M-estimator, and whether the two agree.

    Parameters
    ----------
    problem : Refit

    Raises
    ------
    SolveError
        Too few points, or a model that passes through all of them.
    """
    start = trimmed_start(problem)
    snooping, estimate = snoop(problem, start), _m_estimate(problem, start)
    first, second = set(snooping.blunders), set(estimate.blunders)
    both = tuple(name for name in problem.ids if name in first & second)
    return BlunderSearch(
        snooping, estimate, first == second, both, start.breakdown_point, _summary(problem, first, second, both, start)
    )


def _m_estimate(problem: Refit[Fit], start: RobustStart) -> MEstimate[Fit]:
    """MM-estimate (Yohai 1987): Tukey's weights from a robust start, whose scale is held."""
    scale, freedom = start.scale, float(start.freedom)
    # The scale of the robust start is held: taken anew each round, it would shrink with the weights.
    weights, errors = start.inliers.astype(np.float64), problem.errors(problem.model(start.inliers))
    settled, rounds = False, 0
    while not settled and rounds < ROUNDS:
        rounds += 1
        before, weights = weights, _tukey(np.hypot(*errors.T) / problem.sigma / scale)
        part = weights > LEAST_WEIGHT
        try:
            model = problem.model(part, problem.sigma / np.sqrt(np.where(part, weights, 1.0)))
        except SolveError:  # too few points keep a weight: the last fit stands
            weights = before
            break
        errors = problem.errors(model)
        settled = bool(np.abs(weights - before).max() < SETTLED)
    # From weights to a decision: the same test as data snooping, so that the two methods can be compared.
    kept = (weights > 0.0) & start.inliers
    probability = error_probabilities(problem, kept, scale, freedom)
    for _ in range(10):
        better = probability >= ALPHA
        if (better == kept).all() or better.sum() <= start.needed:
            break
        try:
            probability = error_probabilities(problem, better, scale, freedom)
        except SolveError:
            break
        kept = better
    blunders = tuple(name for name, good in zip(problem.ids, kept, strict=True) if not good)
    fit = problem.fit(kept)
    return MEstimate(blunders, weights, errors, probability, scale, fit, rounds, settled)


def _tukey(lengths: FloatArray) -> FloatArray:
    """Weights of lengths in standard deviations; 0 beyond `TUKEY`, and for points without a place."""
    return biweight(np.where(np.isfinite(lengths), lengths, np.inf) / TUKEY)


def _summary(problem: Refit[Fit], first: set[str], second: set[str], both: tuple[str, ...], start: RobustStart) -> str:
    def names(chosen: set[str]) -> str:
        return listed((name for name in problem.ids if name in chosen), 8)

    if first == second:
        text = (
            f"both methods find {counted(len(both), 'blunder')}: {names(first)}"
            if both
            else ("no blunder: data snooping and the M-estimator keep all points")
        )
    else:
        text = (
            f"the methods disagree: data snooping alone rejects {names(first - second) or 'nothing'}, the M-estimator "
            f"alone {names(second - first) or 'nothing'}, both {names(first & second) or 'nothing'}; look at them"
        )
    if len(first | second) > start.breakdown_point * len(problem):
        text += f"; samples of this kind are sure to show only up to {start.breakdown_point:.0%} of blunders"
    return text
