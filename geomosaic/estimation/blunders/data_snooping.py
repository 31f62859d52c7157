"""Data snooping after Baarda (1968), and the probability of each point's error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic

import numpy as np

from geomosaic.errors import InputError, SolveError
from geomosaic.estimation.blunders.least_trimmed_squares import (
    Fit,
    Refit,
    RobustStart,
    error_probabilities,
)
from geomosaic.types import BoolArray, FloatArray

# Baarda's usual probability of rejecting a good point, for one test.
ALPHA = 0.001


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
        Redundancy it rests on; inf where it was given.
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


def snoop(
    problem: Refit[Fit], start: RobustStart, *, alpha: float = ALPHA, sigma0: float | None = None
) -> Snooping[Fit]:
    """Data snooping: the point of least probable error is rejected and the rest fitted again, until all may be chance.

    Parameters
    ----------
    problem : Refit
    start : RobustStart
        Its scale is used, because that of a fit with several blunders hides them all.
    alpha : float
        Probability below which an error is no chance.
    sigma0 : float, optional
        Standard deviation of unit weight, where it is known beforehand (1 where `sigma` are true standard deviations).

    Raises
    ------
    InputError
        `alpha` or `sigma0` out of range.
    """
    if not 0.0 < alpha < 1.0:
        raise InputError(f"a probability of {alpha} is not between 0 and 1")
    if sigma0 is not None and not (np.isfinite(sigma0) and sigma0 > 0.0):
        raise InputError(f"sigma0 {sigma0} is not a positive number")
    scale, freedom = (start.scale, float(start.freedom)) if sigma0 is None else (sigma0, float("inf"))
    kept, order = np.ones(len(problem), dtype=np.bool_), list[int]()
    try:
        probability = error_probabilities(problem, kept, scale, freedom)
    except SolveError:  # all points together contradict each other too much for any fit
        kept = start.inliers.copy()
        order = np.flatnonzero(~kept).tolist()
        probability = error_probabilities(problem, kept, scale, freedom)
    while kept.sum() > start.needed + 1:
        worst = int(np.argmin(np.where(kept, probability, np.inf)))
        if not probability[worst] < alpha:
            break
        try:
            # One at a time: the largest blunder also shows in the residuals of good points (masking, swamping).
            fewer = kept & (np.arange(len(kept)) != worst)
            probability = error_probabilities(problem, fewer, scale, freedom)
        except SolveError:
            break
        kept = fewer
        order.append(worst)
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
        best = int(np.argmax(np.where(kept, -1.0, probability)))
        if probability[best] < alpha:
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
        back.append(best)
    return kept, probability, back
