"""Mean-shift outlier model: shifts of measurements as additional unknowns, let in one after the other.

Where a measurement is wrong, its shift ∇ (two unknowns) joins the equations: v = e − J·dx − B·∇ (Baarda 1968; Kok 1984
for several at a time). With whitened rows, z = Bᵀv and C = Bᵀ(I − J N⁻¹ Jᵀ)B of the adjustment without any shift say it
all: with the shifts R let in, ∇ = C_RR⁻¹ z_R, the sum of squares falls by z_Rᵀ C_RR⁻¹ z_R, and for a further one

    z' = z − C_·R C_RR⁻¹ z_R,   C' = C − C_·R C_RR⁻¹ C_R·,   T = z'ᵀ C'⁻¹ z'

is what it would fall by next. So subsets are compared without a new adjustment.

The scale of good measurements comes from the data, not from the standard deviations given, so that a model that fits
badly everywhere (tilt, relief, bent film) does not make all of its points wrong. Going in, it is the smaller of two:
the median of the statistics, which a third of blunders leaves nearly as it is, and what is left without the shift under
test. Coming out, it is that of all that is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from geomosaic.estimation.network import Network
from geomosaic.estimation.statistics import log_tail_probability
from geomosaic.types import BoolArray, FloatArray, IntArray

# Share of a measurement's own weight below which others do not check it.
UNCHECKED = 1e-6


@dataclass(frozen=True, eq=False)
class ShiftState:
    """Adjustment with some shifts as unknowns.

    Attributes
    ----------
    statistic : array (H,)
        T of each shift; of one that is in, what the sum of squares would rise by without it. NaN where other
        measurements do not check both of its axes.
    shifts : array (H, 2)
        Size of each, were it let in (or as it is in): pixels, or map units of given coordinates. NaN likewise.
    squares : float
        Weighted sum of squares that is left.
    redundancy : int
    """

    statistic: FloatArray
    shifts: FloatArray
    squares: float
    redundancy: int


@dataclass(frozen=True, eq=False)
class MeanShifts:
    """Mean shifts of a network: of each view, then of given coordinates.

    Attributes
    ----------
    network : Network
        Of points in two dimensions: image positions, then given coordinates (see `Observations.of_coordinates`).
    sigma : array (N,)
        Standard deviations of the image positions, pixels.
    given_sigma : array (S, 2)
        Those of given coordinates: 0 held, inf unknown.
    views : int array (V,)
        Views that can be blunders.
    given : int array (G,)
        Points whose given coordinates can be.
    """

    network: Network
    sigma: FloatArray
    given_sigma: FloatArray
    views: IntArray
    given: IntArray
    _cache: dict[int, FloatArray] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.views) + len(self.given)

    @cached_property
    def _columns(self) -> Any:
        """B (rows, 2H), sparse: unit shifts over the standard deviations of what they shift."""
        from scipy.sparse import coo_array

        shown = self.network.groups[0]
        rows: list[IntArray] = [(2 * self.views[:, None] + np.array([0, 1])).ravel()]
        cols = [np.arange(2 * len(self.views))]
        data: list[FloatArray] = [np.repeat(1.0 / self.sigma[self.views], 2)]
        observed = np.isfinite(self.given_sigma) & (self.given_sigma > 0.0)
        row_of = shown.misclosure.size + np.cumsum(observed).reshape(observed.shape) - 1
        for k, point in enumerate(self.given, start=len(self.views)):
            if observed[point].all():
                rows.append(row_of[point])
                cols.append(2 * k + np.arange(2))
                data.append(1.0 / self.given_sigma[point])
            else:  # held: a shift of the given place against the true one moves all its images the other way
                seen = np.flatnonzero(shown.point == point)
                block = -shown.by_point[seen]
                rows.append(np.broadcast_to(2 * seen[:, None, None] + np.array([[0], [1]]), block.shape).ravel())
                cols.append(np.broadcast_to(2 * k + np.array([[0, 1]]), block.shape).ravel())
                data.append(block.ravel())
        entries = (np.concatenate(data), (np.concatenate(rows), np.concatenate(cols)))
        return coo_array(entries, shape=(len(self.network.misclosure), 2 * len(self))).tocsc()

    @cached_property
    def _base(self) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        """Z (H, 2), blocks of C (H, 2, 2), of BᵀB (H, 2, 2), and the sum of squares, without any shift."""
        n, b, count = self.network, self._columns, len(self.views)
        v = n.residuals(n.step())
        weight = 1.0 / self.sigma[self.views, None, None] ** 2
        blocks, own = np.zeros((len(self), 2, 2)), np.zeros((len(self), 2, 2))
        own[:count], blocks[:count] = weight * np.eye(2), weight * n.redundancy_numbers()[0][self.views]
        # Given coordinates are few, but a held one shifts all images of its point, which are correlated.
        for k in range(count, len(self)):
            one = b[:, 2 * k : 2 * k + 2]
            own[k] = (one.T @ one).toarray()
            turned = (n.design.T @ one).toarray()
            blocks[k] = own[k] - turned.T @ n.solve(turned)
        return (b.T @ v).reshape(-1, 2), blocks, own, float(v @ v)

    def _against(self, shift: int) -> FloatArray:
        """Column of C (2H, 2) of one shift."""
        if shift not in self._cache:
            n, b = self.network, self._columns
            one = b[:, 2 * shift : 2 * shift + 2].toarray()
            one = one - n.design @ n.solve(n.design.T @ one)
            self._cache[shift] = b.T @ one
        return self._cache[shift]

    def state(self, taken: Sequence[int]) -> ShiftState | None:
        """State with some shifts as unknowns; None where they are not separable from each other or the others."""
        z, blocks, own, squares = self._base
        chosen = np.array(taken, dtype=np.int64)
        statistic, shifts = np.full(len(self), np.nan), np.full((len(self), 2), np.nan)
        if len(chosen):
            across = np.hstack([self._against(int(k)) for k in chosen])  # (2H, 2R)
            own_rows = (2 * chosen[:, None] + [0, 1]).ravel()
            inner = across[own_rows]
            size = np.repeat(np.sqrt(np.trace(own[chosen], axis1=1, axis2=2) / 2.0), 2)
            # Scaled to the weight of the measurements themselves, so that the limit is a redundancy number.
            if not np.linalg.eigvalsh(inner / np.outer(size, size))[0] > UNCHECKED:
                return None
            inverse = np.linalg.inv(inner)
            gain = inverse @ z[chosen].ravel()
            squares -= float(z[chosen].ravel() @ gain)
            z = z - (across @ gain).reshape(-1, 2)
            wide = across.reshape(len(self), 2, -1)
            blocks = blocks - np.einsum("hir,rs,hjs->hij", wide, inverse, wide)
            for k, index in enumerate(chosen):
                shifts[index] = gain[2 * k : 2 * k + 2]
                weight = np.linalg.inv(inverse[2 * k : 2 * k + 2, 2 * k : 2 * k + 2])
                statistic[index] = shifts[index] @ weight @ shifts[index]
        checked = self._checked(blocks, own)
        checked[chosen] = False
        solved = np.linalg.solve(blocks[checked], z[checked][:, :, None])[:, :, 0]
        shifts[checked] = solved
        statistic[checked] = (z[checked] * solved).sum(axis=1)
        return ShiftState(statistic, shifts, max(squares, 0.0), self.network.redundancy - 2 * len(chosen))

    def unknowns(self, taken: Sequence[int]) -> FloatArray:
        """Unknowns (U,) of the photos with some shifts as unknowns, which must be separable."""
        n, right = self.network, self.network.misclosure
        if len(taken):
            at = self.state(taken)
            if at is None:
                raise RuntimeError("shifts that are not separable")
            chosen = np.array(taken, dtype=np.int64)
            columns = self._columns[:, (2 * chosen[:, None] + [0, 1]).ravel()]
            right = right - columns @ at.shifts[chosen].ravel()
        return n.solve(n.design.T @ right)[: n.parameters]

    @property
    def share(self) -> FloatArray:
        """Redundancy number (H,) of each: how much of its weight others check, 0 to 1, mean of both axes."""
        _, blocks, own, _ = self._base
        ratio: FloatArray = np.trace(blocks, axis1=1, axis2=2) / np.trace(own, axis1=1, axis2=2)
        return np.clip(ratio, 0.0, 1.0)

    @property
    def held(self) -> FloatArray:
        """How firmly others hold each (H,): T per squared pixel of an error, mean of both axes."""
        firm: FloatArray = np.trace(self._base[1], axis1=1, axis2=2) / 2.0
        return firm

    @staticmethod
    def _checked(blocks: FloatArray, own: FloatArray) -> BoolArray:
        smallest = np.linalg.eigvalsh(blocks)[:, 0]
        enough: BoolArray = smallest > UNCHECKED * np.trace(own, axis1=1, axis2=2) / 2.0
        return enough


# Probability that anything at all is named in a block without a blunder, where errors are normal.
ALPHA = 0.01
# Smallest scale, in pixels over the median standard deviation: below it are the digits of tables.
FLOOR = 0.02
# Of T over the variance, with two degrees of freedom.
MEDIAN = 2.0 * np.log(2.0)
# Differences of the sum of squares, over the variance, that make one shift at most a hundred times likelier.
ALTERNATIVE = 2.0 * np.log(100.0)
# Shifts tried in the place of each that is included.
EXCHANGES = 3
# Redundancy from which on a single shift can be tested with a scale that is not known.
LEAST = 3


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
    floor = FLOOR / float(np.median(shifts.sigma))
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
    most = max(1, shifts.network.redundancy // 4)
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
