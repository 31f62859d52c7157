"""Repeatable fit to any choice of points, as searches for blunders need it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from math import comb
from typing import Any, Protocol, TypeVar

import numpy as np

from geomosaic.errors import GeomosaicError, SolveError, counted
from geomosaic.estimation.statistics import tail_probability
from geomosaic.types import AnyArray, BoolArray, FloatArray, IntArray


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

    def errors_under(self, selection: AnyArray) -> FloatArray:
        """Errors (N, 2) of all points under the model fitted to a selection, as `errors` gives them."""

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


# Share of good points that the number of samples allows for.
CLEAN = 0.7
# Samples free of blunders that may be expected.
ENOUGH = 4
# Samples: at least, and at most, since each costs a fit.
FEWEST, MOST = 80, 500
# Samples that are concentrated to the end.
BEST = 6
# Points among which the better half is looked for: a start needs no more, and each sample costs fits to them.
POOL = 2000
# Concentration steps at most; the sum of squares falls with each, and a few suffice.
STEPS = 20
# Pixels to which image points are measured at best: what is exact but for rounding has no blunders within.
FINEST = 0.05
# Probability of an error by chance below which a point is not let in.
REJECTED = 0.001


@dataclass(frozen=True, eq=False)
class RobustStart:
    """Set of points that agree with each other, and how well.

    Attributes
    ----------
    inliers : bool array (N,)
        Points whose errors may be chance under a fit to all of them.
    scale : float
        Standard deviation of unit weight from the inliers; not 0.
    freedom : int
        Redundancy it rests on.
    needed : int
        Fewest points the model needs.
    breakdown_point : float
        Share of blunders up to which three of the samples may be expected to be free of them.
    """

    inliers: BoolArray
    scale: float
    freedom: int
    needed: int
    breakdown_point: float


def _points_needed(problem: Refit[Fit]) -> int:
    """Fewest points the model needs, found by trying: all points together may contradict each other too much."""
    random = np.random.default_rng(0)
    count = len(problem)
    for size in range(1, count + 1):
        model = _any_model(problem, size, random)
        if model is None:
            continue
        free = problem.free_parameters(model)
        # A model with more parameters for more points (a spline) fits them all, and no residual tells of a blunder.
        larger = _any_model(problem, min(size + 2, count), random)
        if larger is not None and problem.free_parameters(larger) > free:
            raise SolveError(
                "the fit passes through all of its control points, blunders too",
                hint="look for blunders with a kind of fewer parameters (not tps)",
            )
        # Two equations a point; more where the smallest sample that works has more parameters than equations.
        return max(-(-free // 2), size if free > 2 * size else 0)
    raise SolveError("no sample of the control points determines the model", hint="add points, or spread them")


def _any_model(problem: Refit[Fit], size: int, random: np.random.Generator) -> Any:
    for _ in range(8):
        try:
            return problem.model(random.choice(len(problem), size, replace=False))
        except GeomosaicError:
            continue
    return None


def _check_count(problem: Refit[Fit]) -> int:
    """Fewest points the model needs, refusing fewer than two more."""
    needed, count = _points_needed(problem), len(problem)
    if count < needed + 2:
        raise SolveError(
            f"{counted(count, 'point')} {'is' if count == 1 else 'are'} too few to look for blunders: the kind needs "
            f"{needed}, and two more to show it",
            hint=f"give {needed + 2} points or more, better twice as many",
        )
    return needed


def trimmed_start(problem: Refit[Fit]) -> RobustStart:
    """Points that agree: small samples are fitted and concentrated on the better half, and the best is kept.

    Parameters
    ----------
    problem : Refit

    Raises
    ------
    SolveError
        Too few points to tell blunders from good ones, or a model that passes through all of them.
    """
    needed, count = _check_count(problem), len(problem)
    # The size of the better half with the highest breakdown point (Rousseeuw & van Driessen 2006).
    pool = some_of(count)
    half = (len(pool) + needed + 1) // 2
    # One point more than needed: a conformal fit of two cannot tell a mirrored image.
    size = min(needed + 1, half)
    samples = _samples(count, size)
    tried = _best(problem, samples, pool, half)
    if not tried:
        raise SolveError("no sample of the control points determines the model", hint="spread the points")
    # Most samples hold a blunder, and show it at once: only the better ones are worth the next fit.
    tried = _best(problem, [chosen for _, chosen in tried[: max(BEST, len(tried) // 3)]], pool, half)
    finished = [_concentrate(problem, each[1], pool, half, STEPS) or each for each in tried[:BEST]]
    best = min(finished, key=lambda each: each[0])
    if len(pool) < count:  # of all points the better half, under the fit to that of some
        everyone = np.arange(count)
        best = _concentrate(problem, best[1], everyone, (count + needed + 1) // 2, 1) or best
    inliers, scale, freedom = _forward_search(problem, best[1])
    breakdown_point = 1.0 - min(1.0, 3.0 / len(samples)) ** (1.0 / size)
    return RobustStart(inliers, scale, freedom, needed, 0.5 if comb(count, size) <= len(samples) else breakdown_point)


def some_of(count: int) -> IntArray:
    """Numbers (K,) of `POOL` of so many points, or of all, rising.

    Parameters
    ----------
    count : int
    """
    # At random: of a regular grid of points every nth may lie in one column.
    chosen = np.random.default_rng(0).choice(count, POOL, replace=False) if count > POOL else np.arange(count)
    return np.sort(chosen)


def _samples(count: int, size: int) -> list[IntArray]:
    wanted = int(np.clip(np.ceil(ENOUGH / CLEAN**size), FEWEST, MOST))
    # So few choices are all tried: nothing is left to chance.
    if comb(count, size) <= wanted:
        return [np.array(chosen, dtype=np.int64) for chosen in combinations(range(count), size)]
    random = np.random.default_rng(0)
    return [random.choice(count, size, replace=False) for _ in range(wanted)]


def _best(problem: Refit[Fit], samples: list[IntArray], pool: IntArray, half: int) -> list[tuple[float, IntArray]]:
    """Samples after concentration; the best first."""
    found = (_concentrate(problem, sample, pool, half, 0) for sample in samples)
    return sorted((each for each in found if each is not None), key=lambda each: each[0])


def _lengths(problem: Refit[Fit], chosen: IntArray) -> FloatArray | None:
    """Lengths (N,) of errors under the fit to some points, in standard deviations; None where there is no such fit."""
    try:
        lengths: FloatArray = np.hypot(*problem.errors_under(chosen).T) / problem.sigma
    except GeomosaicError:
        return None
    return np.where(np.isfinite(lengths), lengths, np.inf)


def _concentrate(
    problem: Refit[Fit], chosen: IntArray, pool: IntArray, half: int, steps: int
) -> tuple[float, IntArray] | None:
    """Sum of squares and the better half of a pool after steps of fitting the better half; the sum never grows."""
    best: tuple[float, IntArray] | None = None
    for _ in range(steps + 1):
        lengths = _lengths(problem, chosen)
        if lengths is None:
            return best
        chosen = pool[np.sort(np.argsort(lengths[pool], kind="stable")[:half])]
        total = float((lengths[chosen] ** 2).sum())
        if not np.isfinite(total) or (best is not None and total >= best[0] * (1.0 - 1e-9)):
            return best
        best = total, chosen
    return best


def _forward_search(problem: Refit[Fit], half: IntArray) -> tuple[BoolArray, float, int]:
    """Forward search: points outside are let in, the best first, while their errors of prediction may be chance."""
    # The errors of the best m of N points are smaller than those of all: for normal errors in two axes the mean square
    # of the best share p is 1 + (1 − p) ln(1 − p) / p of the true one. The scale is corrected by it while points are
    # let in, and not at the end, where those outside are taken for blunders.
    count = len(problem)
    # Error-free points have residuals of rounding only, and each would be an outlier to that scale.
    floor = max(FINEST, 1e-9 * problem.magnitude) / float(np.median(problem.sigma))
    inliers = np.zeros(count, dtype=np.bool_)
    inliers[half] = True
    while True:
        fit, statistic = problem.statistics(inliers)
        scale = max(fit.sigma0, floor)
        outside = np.flatnonzero(~inliers)
        if not len(outside):
            break
        share = float(inliers.mean())
        short = np.sqrt(1.0 + (1.0 - share) * np.log(1.0 - share) / share)
        chance = tail_probability(statistic[outside], scale / short, float(fit.redundancy))
        # A tenth at a time: each round improves the scale by which the next are judged.
        order = outside[np.argsort(-chance, kind="stable")][: max(1, len(outside) // 10)]
        chosen = order[np.sort(-chance, kind="stable")[: len(order)] <= -REJECTED]
        if not len(chosen):
            break
        inliers[chosen] = True
    return inliers, scale, fit.redundancy
