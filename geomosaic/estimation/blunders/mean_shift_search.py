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

from geomosaic.estimation.blunders.mean_shift import Shifts, State
from geomosaic.estimation.statistics import log_tail_probability
from geomosaic.types import FloatArray

ALPHA = 0.01
"""Probability that anything at all is named in a block without a blunder, where errors are normal."""
FLOOR = 0.02
"""Smallest scale, in pixels over the median standard deviation: below it are the digits of tables."""
MEDIAN = 2.0 * np.log(2.0)
"""Of T over the variance, with two degrees of freedom."""
ALIKE = 2.0 * np.log(100.0)
"""Differences of the sum of squares, over the variance, that make one shift at most a hundred times likelier."""
EXCHANGES = 3
"""Shifts tried in the place of each that was taken."""
LEAST = 3
"""Redundancy from which on a single shift can be tested with a scale that is not known."""


@dataclass(frozen=True, eq=False)
class Search:
    """What was found.

    Attributes
    ----------
    taken : tuple of int
        Shifts that are needed, the largest statistic first.
    alike : tuple of tuple of int
        For each of them, others that would do nearly as well in its place.
    state : State
        With these shifts.
    scale : float
        Standard deviation of unit weight of all that is kept; inf without redundancy.
    """

    taken: tuple[int, ...]
    alike: tuple[tuple[int, ...], ...]
    state: State
    scale: float


def search(shifts: Shifts, start: Sequence[int] = ()) -> Search:
    """Find the shifts that measurements need.

    Parameters
    ----------
    shifts : Shifts
    start : sequence of int
        Let in to begin with.
    """
    floor = FLOOR / float(np.median(shifts.network.sigma))
    limit = float(np.log(ALPHA / max(1, len(shifts))))
    taken = list(start) if shifts.state(start) is not None else []
    taken = _fewer(shifts, _more(shifts, taken, floor, limit), floor, limit)
    taken = _exchanged(shifts, taken, floor, limit)
    at = _known(shifts, taken)
    scale = _scale(at, floor)
    taken = [taken[k] for k in np.argsort(-at.statistic[taken], kind="stable")]
    alike = [_alike(shifts, taken, k, scale if np.isfinite(scale) else floor) for k in range(len(taken))]
    return Search(tuple(taken), tuple(alike), at, scale)


def _more(shifts: Shifts, taken: list[int], floor: float, limit: float) -> list[int]:
    """Let shifts in, the one that is needed most first."""
    at: State | None = _known(shifts, taken)
    most = max(1, shifts.network.equations.redundancy // 4)
    while at is not None and len(taken) < most:
        worst = _worst(at, taken, floor, limit)
        at = None if worst is None else shifts.state([*taken, worst])
        if worst is not None and at is not None:
            taken = [*taken, worst]
    return taken


def _fewer(shifts: Shifts, taken: list[int], floor: float, limit: float) -> list[int]:
    """Put out again those that chance accounts for."""
    while taken:
        at = _known(shifts, taken)
        chance = _log_chance(at.statistic[taken], _scale(at, floor), at.redundancy)
        best = int(np.argmax(chance))
        if not chance[best] >= limit:
            break
        taken = [*taken[:best], *taken[best + 1 :]]
    return taken


def _exchanged(shifts: Shifts, taken: list[int], floor: float, limit: float) -> list[int]:
    """Take others in the place of some, where fewer then do: several blunders can be laid to their neighbours."""
    while len(taken) > 1:
        scale = _scale(_known(shifts, taken), floor)
        alike = [_alike(shifts, taken, k, scale)[:EXCHANGES] for k in range(len(taken))]
        trials = [[*taken[:k], *taken[k + 1 :], other] for k, others in enumerate(alike) for other in others]
        wide = list(taken)
        for other in dict.fromkeys(k for others in alike for k in others):
            wide += [other] if shifts.state([*wide, other]) is not None else []
        found = (_fewer(shifts, trial, floor, limit) for trial in [wide, *trials] if shifts.state(trial) is not None)
        shorter = next((trial for trial in found if _closed(shifts, trial, floor, limit, len(taken))), None)
        if shorter is None:
            break
        taken = shorter
    return taken


def _closed(shifts: Shifts, trial: list[int], floor: float, limit: float, most: int) -> bool:
    """Whether fewer shifts than `most` leave nothing to be let in."""
    return len(trial) < most and _worst(_known(shifts, trial), trial, floor, limit) is None


def _known(shifts: Shifts, taken: Sequence[int]) -> State:
    """State of shifts that can be told apart; any part of them can be, too."""
    at = shifts.state(taken)
    if at is None:
        raise RuntimeError("shifts that cannot be told apart")
    return at


def _scale(at: State, floor: float) -> float:
    """Standard deviation of unit weight of what is kept; inf without redundancy: chance then accounts for anything."""
    return max(float(np.sqrt(at.squares / at.redundancy)), floor) if at.redundancy > 0 else float("inf")


def _worst(at: State, taken: Sequence[int], floor: float, limit: float) -> int | None:
    """The shift that is needed most, where chance does not account for it."""
    statistic = np.where(np.isin(np.arange(len(at.statistic)), taken), np.nan, at.statistic)
    if at.redundancy < LEAST or not np.isfinite(statistic).any():
        return None
    worst = int(np.nanargmax(statistic))
    middle = max(float(np.sqrt(np.nanmedian(statistic) / MEDIAN)), floor)
    left = max(float(np.sqrt(max(at.squares - statistic[worst], 0.0) / (at.redundancy - 2))), floor)
    by_middle = _log_chance(statistic[worst], middle, at.redundancy) if at.redundancy >= 4 * LEAST else 0.0
    chance = np.minimum(_log_chance(statistic[worst], left, at.redundancy - 2), by_middle)
    return worst if chance < limit else None


def _log_chance(statistic: FloatArray, scale: float, freedom: int) -> FloatArray:
    """Logarithm of the probability of statistics as large; 0 without redundancy: anything may be."""
    return log_tail_probability(statistic, scale, freedom) if freedom >= 1 else np.zeros_like(statistic)


def detectable(shifts: Shifts, found: Search) -> float:
    """Pixels of an error that brings the statistic of a measurement to the limit; median over the views; or inf."""
    limit, freedom = float(np.log(ALPHA / max(1, len(shifts)))), found.state.redundancy - 2
    if freedom < 1:
        return float("inf")
    wanted = found.scale**2 * freedom * np.expm1(-2.0 * limit / freedom)
    held: FloatArray = shifts.held[: len(shifts.views)]
    return float(np.median(np.sqrt(wanted / np.where(held > 0.0, held, 1e-300)))) if len(held) else float("inf")


def _alike(shifts: Shifts, taken: Sequence[int], index: int, scale: float) -> tuple[int, ...]:
    """Shifts that explain nearly as much as one of those that were taken."""
    others = [*taken[:index], *taken[index + 1 :]]
    here = _known(shifts, others).statistic.copy()
    here[others] = np.nan
    near = np.flatnonzero(here > here[taken[index]] - ALIKE * scale**2)
    return tuple(int(k) for k in near[np.argsort(-here[near], kind="stable")] if k != taken[index])
