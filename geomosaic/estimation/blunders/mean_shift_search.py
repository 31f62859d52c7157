"""Outlier search: shifts of measurements let in one after the other, and removed where they are not needed.

The scale of good measurements comes from the data, not from the standard deviations given, so that a model that fits
badly everywhere (tilt, relief, bent film) does not make all of its points wrong. Going in, it is the smaller of two:
the median of the statistics, which a third of blunders leaves nearly as it is, and what is left without the shift under
test. Coming out, it is that of all that is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.estimation.blunders.mean_shift import MeanShifts, ShiftState
from geomosaic.estimation.statistics import log_tail_probability
from geomosaic.types import FloatArray

ALPHA = 0.01
"""Probability that anything at all is named in a block without a blunder, where errors are normal."""
FLOOR = 0.02
"""Smallest scale, in pixels over the median standard deviation: below it are the digits of tables."""
MEDIAN = 2.0 * np.log(2.0)
"""Of T over the variance, with two degrees of freedom."""
ALTERNATIVE = 2.0 * np.log(100.0)
"""Differences of the sum of squares, over the variance, that make one shift at most a hundred times likelier."""
EXCHANGES = 3
"""Shifts tried in the place of each that is included."""
LEAST = 3
"""Redundancy from which on a single shift can be tested with a scale that is not known."""


@dataclass(frozen=True, eq=False)
class ShiftSearch:
    """Result of a search for mean shifts.

    Attributes
    ----------
    included : tuple of int
        Shifts that are needed, the largest statistic first.
    alternatives : tuple of tuple of int
        For each of them, others that would do nearly as well in its place.
    state : ShiftState
        With these shifts.
    scale : float
        Standard deviation of unit weight of all that is kept; inf without redundancy.
    """

    included: tuple[int, ...]
    alternatives: tuple[tuple[int, ...], ...]
    state: ShiftState
    scale: float


def search_shifts(shifts: MeanShifts, start: Sequence[int] = ()) -> ShiftSearch:
    """Shifts that measurements need: forward selection, backward elimination, exchanges.

    Parameters
    ----------
    shifts : MeanShifts
    start : sequence of int
        Let in to begin with.
    """
    floor = FLOOR / float(np.median(shifts.network.sigma))
    # Bonferroni: the probability of a false alarm is for the whole block, not for each measurement.
    limit = float(np.log(ALPHA / max(1, len(shifts))))
    included = list(start) if shifts.state(start) is not None else []
    included = _backward(shifts, _forward(shifts, included, floor, limit), floor, limit)
    included = _exchanged(shifts, included, floor, limit)
    at = _known(shifts, included)
    scale = _scale(at, floor)
    included = [included[k] for k in np.argsort(-at.statistic[included], kind="stable")]
    others_of = [
        _alternatives(shifts, included, k, scale if np.isfinite(scale) else floor) for k in range(len(included))
    ]
    return ShiftSearch(tuple(included), tuple(others_of), at, scale)


def _forward(shifts: MeanShifts, included: list[int], floor: float, limit: float) -> list[int]:
    """Forward selection: shifts are let in, the one that is needed most first."""
    at: ShiftState | None = _known(shifts, included)
    # Each shift takes two of the redundancy: half of it is kept to judge by.
    most = max(1, shifts.network.equations.redundancy // 4)
    while at is not None and len(included) < most:
        worst = _worst(at, included, floor, limit)
        at = None if worst is None else shifts.state([*included, worst])
        if worst is not None and at is not None:
            included = [*included, worst]
    return included


def _backward(shifts: MeanShifts, included: list[int], floor: float, limit: float) -> list[int]:
    """Backward elimination of shifts that chance accounts for."""
    while included:
        at = _known(shifts, included)
        chance = _log_chance(at.statistic[included], _scale(at, floor), at.redundancy)
        best = int(np.argmax(chance))
        if not chance[best] >= limit:
            break
        included = [*included[:best], *included[best + 1 :]]
    return included


def _exchanged(shifts: MeanShifts, included: list[int], floor: float, limit: float) -> list[int]:
    """Exchange of shifts for others, where fewer then suffice: several blunders can show in their neighbours."""
    while len(included) > 1:
        scale = _scale(_known(shifts, included), floor)
        others_of = [_alternatives(shifts, included, k, scale)[:EXCHANGES] for k in range(len(included))]
        trials = [[*included[:k], *included[k + 1 :], other] for k, others in enumerate(others_of) for other in others]
        wide = list(included)
        for other in dict.fromkeys(k for others in others_of for k in others):
            wide += [other] if shifts.state([*wide, other]) is not None else []
        found = (_backward(shifts, trial, floor, limit) for trial in [wide, *trials] if shifts.state(trial) is not None)
        shorter = next((trial for trial in found if _closed(shifts, trial, floor, limit, len(included))), None)
        if shorter is None:
            break
        included = shorter
    return included


def _closed(shifts: MeanShifts, trial: list[int], floor: float, limit: float, most: int) -> bool:
    """Whether fewer shifts than `most` leave nothing to be let in."""
    return len(trial) < most and _worst(_known(shifts, trial), trial, floor, limit) is None


def _known(shifts: MeanShifts, included: Sequence[int]) -> ShiftState:
    """State of shifts that are separable; any part of them is, too."""
    at = shifts.state(included)
    if at is None:
        raise RuntimeError("shifts that are not separable")
    return at


def _scale(at: ShiftState, floor: float) -> float:
    """Standard deviation of unit weight of what is kept; inf without redundancy: chance then accounts for anything."""
    return max(float(np.sqrt(at.squares / at.redundancy)), floor) if at.redundancy > 0 else float("inf")


def _worst(at: ShiftState, included: Sequence[int], floor: float, limit: float) -> int | None:
    """The shift that is needed most, where chance does not account for it."""
    statistic = np.where(np.isin(np.arange(len(at.statistic)), included), np.nan, at.statistic)
    if at.redundancy < LEAST or not np.isfinite(statistic).any():
        return None
    worst = int(np.nanargmax(statistic))
    # The scale by the median asks for enough statistics; with few of them the residual scale decides alone.
    middle = max(float(np.sqrt(np.nanmedian(statistic) / MEDIAN)), floor)
    left = max(float(np.sqrt(max(at.squares - statistic[worst], 0.0) / (at.redundancy - 2))), floor)
    by_middle = _log_chance(statistic[worst], middle, at.redundancy) if at.redundancy >= 4 * LEAST else 0.0
    chance = np.minimum(_log_chance(statistic[worst], left, at.redundancy - 2), by_middle)
    return worst if chance < limit else None


def _log_chance(statistic: FloatArray, scale: float, freedom: int) -> FloatArray:
    """Logarithm of the probability of statistics as large; 0 without redundancy: anything may be."""
    return log_tail_probability(statistic, scale, freedom) if freedom >= 1 else np.zeros_like(statistic)


def minimal_detectable(shifts: MeanShifts, found: ShiftSearch) -> float:
    """Error in pixels that brings a measurement to the limit (inner reliability), median over the views.

    Parameters
    ----------
    shifts : MeanShifts
    found : ShiftSearch
    """
    limit, freedom = float(np.log(ALPHA / max(1, len(shifts)))), found.state.redundancy - 2
    if freedom < 1:
        return float("inf")
    wanted = found.scale**2 * freedom * np.expm1(-2.0 * limit / freedom)
    held: FloatArray = shifts.held[: len(shifts.views)]
    # A measurement that no other checks holds nothing: any error of it stays unseen, however large.
    return float(np.median(np.sqrt(wanted / np.where(held > 0.0, held, 1e-300)))) if len(held) else float("inf")


def _alternatives(shifts: MeanShifts, included: Sequence[int], index: int, scale: float) -> tuple[int, ...]:
    """Alternatives to an included shift: others that explain nearly as much."""
    others = [*included[:index], *included[index + 1 :]]
    here = _known(shifts, others).statistic.copy()
    here[others] = np.nan
    near = np.flatnonzero(here > here[included[index]] - ALTERNATIVE * scale**2)
    return tuple(int(k) for k in near[np.argsort(-here[near], kind="stable")] if k != included[index])
