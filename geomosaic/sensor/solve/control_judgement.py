"""Judgement on the control points of one image: which are wrong, and what they do not decide.

Near its solution an image is linear in the parameters, so that a fit to any choice of points costs one small linear
solution. Wrong points are found as in any control (`geomosaic.estimation.blunders`): a trimmed start, then data
snooping. A point is left out only where no other could be the wrong one in its place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from geomosaic.errors import SolveError, listed
from geomosaic.estimation.blunders.data_snooping import ALPHA, snoop
from geomosaic.estimation.blunders.least_trimmed_squares import RobustStart, error_probabilities, trimmed_start
from geomosaic.estimation.equations import Equations
from geomosaic.estimation.solver import Unknowns
from geomosaic.estimation.statistics import (
    PRIOR_REDUNDANCY,
    Cofactors,
    log_chi_squared_tail,
    sigma0_of,
    tail_probability,
    total_rms,
)
from geomosaic.sensor.plugin import SensorModel
from geomosaic.sensor.solve.newton import jacobian
from geomosaic.types import AnyArray, BoolArray, FloatArray, IntArray

# Points of an image up to which it is asked whether another could be the wrong one: more of them leave no doubt.
MOST_COMPARED = 60
# Points more than a model needs, from which on one of them that is badly wrong stands out.
ENOUGH = 6
# Points named in one message.
MOST_NAMED = 6


@dataclass(frozen=True, eq=False)
class LinearFit:
    """Linear least squares fit: its values (U,), with what a search for blunders asks (`PointFit`)."""

    values: FloatArray
    cofactors: Cofactors
    sigma0: float
    redundancy: int


@dataclass(frozen=True, eq=False)
class LinearControl:
    """Control points of an image that is linear in its U unknowns, for searches for blunders (`blunders.Refit`).

    Attributes
    ----------
    design : array (N, 2, U)
        Derivatives of col and row by the unknowns, pixels per unit.
    offsets : array (N, 2)
        Measured minus computed, pixels.
    sigma : array (N,)
        Standard deviations of the measurements, pixels.
    priors : Equations, optional
        Of unknowns whose a-priori values count as observations.
    """

    design: FloatArray
    offsets: FloatArray
    sigma: FloatArray
    priors: Equations | None = None

    @classmethod
    def at(
        cls, model: SensorModel, xyz: FloatArray, offsets: FloatArray, sigma: FloatArray, start: Unknowns
    ) -> LinearControl:
        """Linearisation at a model that sees all points; `start` has the a-priori values of its parameters."""
        design = jacobian(model, xyz)[0][:, :, start.free]
        priors = start.a_priori(model.parameters.values) if start.observed.any() else None
        # A difference that left the visible part pulls at nothing.
        known = np.isfinite(design).all(axis=(1, 2), keepdims=True)
        return cls(np.where(known, design, 0.0), offsets, sigma, priors)

    def __len__(self) -> int:
        return len(self.offsets)

    @property
    def ids(self) -> tuple[str, ...]:
        """Numbers of the points."""
        return tuple(map(str, range(len(self))))

    @property
    def magnitude(self) -> float:
        """Largest offset, pixels."""
        return float(np.abs(self.offsets).max())

    @cached_property
    def everyone(self) -> tuple[LinearFit, FloatArray]:
        """Fit to all points, and how much each point (N,) contradicts the others."""
        return self.statistics(np.ones(len(self), dtype=np.bool_))

    def _equations(self, chosen: AnyArray, sigma: FloatArray) -> Equations:
        design, offsets = (a[chosen] / sigma[chosen, None, None] for a in (self.design, self.offsets[:, :, None]))
        found = Equations(design.reshape(-1, design.shape[2]), offsets.ravel())
        found = found if self.priors is None else Equations.stacked(found, self.priors)
        if not found.determined:
            raise SolveError("the points chosen do not determine the model", hint="choose more of them")
        return found

    def model(self, selection: AnyArray | None = None, sigma: FloatArray | None = None) -> FloatArray:
        """Unknowns (U,) fitted to a selection."""
        chosen = np.arange(len(self)) if selection is None else selection
        return self._equations(chosen, self.sigma if sigma is None else sigma).step()

    def free_parameters(self, model: FloatArray) -> int:
        """Number of unknowns that the points determine, and not a-priori values: the trace of the hat matrix."""
        if self.priors is None:
            return len(model)
        checked = float(np.trace(self.everyone[0].cofactors.share, axis1=1, axis2=2).sum())
        return int(np.ceil(2 * len(self) - checked - 1e-6))

    def errors(self, model: FloatArray) -> FloatArray:
        """Offsets (N, 2) less what unknowns (U,) explain, pixels."""
        return self.offsets - self.design @ model

    def errors_under(self, selection: AnyArray) -> FloatArray:
        """Errors (N, 2) under the fit to a selection."""
        return self.errors(self.model(selection))

    def fit(self, kept: AnyArray) -> LinearFit:
        """Fit to a selection."""
        equations = self._equations(kept, self.sigma)
        values = equations.step()
        squares = float((equations.residuals(values) ** 2).sum())
        points = len(self.offsets[kept])
        found = Cofactors.of(equations, np.ones(len(values), dtype=np.bool_), points)
        return LinearFit(values, found, sigma0_of(squares, equations.redundancy), equations.redundancy)

    def statistics(self, kept: BoolArray) -> tuple[LinearFit, FloatArray]:
        """Fit to the points kept, and how much each point (N,) contradicts it."""
        fit = self.fit(kept)
        weighted, design = self.errors(fit.values) / self.sigma[:, None], self.design / self.sigma[:, None, None]
        statistic = np.zeros(len(self))
        statistic[kept] = fit.cofactors.deletion_statistic(weighted[kept])
        statistic[~kept] = fit.cofactors.prediction_statistic(weighted[~kept], design[~kept])
        return fit, statistic


@dataclass(frozen=True, eq=False)
class Judgement:
    """Judgement on the control points of an image.

    Attributes
    ----------
    wrong : bool array (N,)
        Points that contradict the others, and that no other point can be wrong in place of.
    probability : array (N,)
        Of the error of each point, by chance alone, under the fit to those that are not wrong.
    rivals : tuple of int
        Points of which one is wrong, and the others do not tell which; the likeliest first.
    chance : float
        Probability of so large a contradiction as all points together show, where they are too few to tell which is
        wrong; 1 where they are not.
    able : bool
        Whether the points are enough to be judged one by one.
    """

    wrong: BoolArray
    probability: FloatArray
    rivals: tuple[int, ...] = ()
    chance: float = 1.0
    able: bool = True

    @classmethod
    def of_none(cls, count: int, *, chance: float = 1.0, able: bool = True) -> Judgement:
        """Judgement that rejects none of so many points."""
        return cls(np.zeros(count, dtype=np.bool_), np.ones(count), (), chance, able)

    def among(self, rows: IntArray, count: int) -> Judgement:
        """Judgement on the points of some rows (N,) as one on all of them."""
        whole = Judgement.of_none(count)
        whole.wrong[rows], whole.probability[rows] = self.wrong, self.probability
        rivals = tuple(int(rows[index]) for index in self.rivals)
        return replace(self, wrong=whole.wrong, probability=whole.probability, rivals=rivals)

    def text(self, names: Sequence[str], residuals: FloatArray) -> str:
        """What the points do not decide; '' where they decide all.

        Parameters
        ----------
        names : sequence of str (N,)
        residuals : array (N, 2)
            Pixels.
        """
        count = len(names) - int(self.wrong.sum())
        if self.rivals:
            which = listed((f"'{names[index]}'" for index in self.rivals), MOST_NAMED)
            return (
                f"one of the control points {which} is wrong, most likely the first, but {count} points are too few to "
                "be sure which: all of them are used; measure these again, or two more points"
            )
        if self.chance < ALPHA:
            return (
                f"the {count} control points contradict each other more than their standard deviations allow (RMS "
                f"{total_rms(residuals):.1f} px, by chance 1 in {1.0 / max(self.chance, 1e-9):,.0f}), and are too few "
                "to tell which of them is wrong, if one is: all are used; measure two more, or give larger sigmas"
            )
        return ""


def judge_points(
    model: SensorModel,
    xyz: FloatArray,
    colrow: FloatArray,
    sigma: FloatArray,
    start: Unknowns,
    *,
    known_sigmas: bool,
) -> Judgement:
    """Judgement on control points, linearised at a model that was fitted to them.

    Parameters
    ----------
    model : SensorModel
    xyz : array (N, 3)
        In `model.crs`.
    colrow : array (N, 2)
        Pixels.
    sigma : array (N,)
        Standard deviations of the measurements, pixels.
    start : Unknowns
        Parameters of the model with their a-priori values and standard deviations.
    known_sigmas : bool
        Whether `sigma` was given; else it is relative.
    """
    offsets = colrow - model.ground_to_image(xyz)
    seen = np.flatnonzero(np.isfinite(offsets).all(axis=1))
    control = LinearControl.at(model, xyz[seen], offsets[seen], sigma[seen], start)
    return judge_control(control, known_sigmas=known_sigmas).among(seen, len(xyz))


def judge_control(control: LinearControl, *, known_sigmas: bool) -> Judgement:
    """Judgement on control points: which contradict the others, and what they do not decide.

    Parameters
    ----------
    control : LinearControl
    known_sigmas : bool
        Whether its standard deviations were given; else they are relative.
    """
    count = len(control)
    if not count:
        return Judgement.of_none(count, able=False)
    try:
        fit, statistic = control.everyone
    except SolveError:
        return Judgement.of_none(count, able=False)
    together = 1.0
    if known_sigmas and fit.redundancy > 0:
        freedom = np.array([fit.redundancy])
        together = float(np.exp(log_chi_squared_tail(freedom * fit.sigma0**2, freedom))[0])
        # Points as good as they were declared need no search.
        if together >= ALPHA and tail_probability(statistic, 1.0, np.inf).min() >= ALPHA:
            return Judgement.of_none(count)
    try:
        start = trimmed_start(control)
    except SolveError:  # fewer than two points more than the model needs
        return Judgement.of_none(count, chance=together, able=False)
    if known_sigmas:
        # What was declared counts as redundant observations, as it does in the covariance (`variance_factor`).
        start = replace(start, scale=max(start.scale, 1.0), freedom=start.freedom + PRIOR_REDUNDANCY)
    found = snoop(control, start)
    wrong = np.isin(np.array(control.ids), np.array(found.blunders, dtype=np.str_))
    rivals = _rivals(control, wrong, start) if count <= MOST_COMPARED else {}
    wrong[list(rivals)] = False
    if together < ALPHA and not (wrong.any() or rivals) and count < start.needed + ENOUGH:
        return Judgement.of_none(count, chance=together)
    either = dict.fromkeys([*rivals, *(other for others in rivals.values() for other in others)])
    return Judgement(wrong, found.probability, tuple(either))


def _rivals(control: LinearControl, wrong: BoolArray, start: RobustStart) -> dict[int, list[int]]:
    """Points that could be wrong in place of one that was rejected: without them it contradicts nothing."""
    found: dict[int, list[int]] = {}
    rejected = np.flatnonzero(wrong)
    for other in np.flatnonzero(~wrong).tolist() if len(rejected) else ():
        kept = ~wrong
        kept[other] = False
        try:
            chance = error_probabilities(control, kept, start.scale, float(start.freedom))[rejected]
        except SolveError:
            chance = np.ones(len(rejected))
        for index in rejected[chance >= ALPHA].tolist():
            found.setdefault(index, []).append(other)
    return found
