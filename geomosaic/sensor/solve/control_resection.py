"""Resection of one image from its control points, wrong ones found and left out.

Near its solution the image is linear in the parameters, so that a fit to any choice of points costs one small linear
solution. Wrong points are found as in any control (`geomosaic.estimation.blunders`): a trimmed start, then data
snooping. A point is left out only where no other could be the wrong one in its place.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Generic

import numpy as np

from geomosaic.errors import GeomosaicWarning, SolveError, listed
from geomosaic.estimation.blunders.confusion import confusion_causes
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
from geomosaic.sensor.plugin import ControlBlunder, SensorModel
from geomosaic.sensor.solve.adjust import Model, Resection, resect
from geomosaic.sensor.solve.newton import jacobian
from geomosaic.types import AnyArray, BoolArray, FloatArray, IntArray

# Searches at most, each linearised at the solution without the points that the one before has rejected.
ROUNDS = 5
# Points of an image up to which it is asked whether another could be the wrong one: more of them leave no doubt.
MOST_COMPARED = 60
# Points more than a model needs, from which on one of them that is badly wrong stands out.
ENOUGH = 6
# Points named in one message.
MOST_NAMED = 6


@dataclass(frozen=True, eq=False)
class ControlResection(Generic[Model]):
    """Sensor model fitted to the control points that do not contradict each other.

    Attributes
    ----------
    solved : Resection
        Of the points used, in their order.
    used : bool array (N,)
        Points that took part.
    residuals : array (N, 2)
        Measured minus computed (col, row) of all points, pixels; NaN for points that the model does not see.
    left_out : tuple of ControlBlunder
        Points that contradict the others, the largest first.
    undecided : str
        Contradiction of points that do not tell which of them is wrong, so that all are used; '' for none.
    """

    solved: Resection[Model]
    used: BoolArray
    residuals: FloatArray
    left_out: tuple[ControlBlunder, ...]
    undecided: str

    def warn(self, where: str) -> None:
        """Warning that names the points left out, or says that the points do not tell which is wrong.

        Parameters
        ----------
        where : str
            Image.
        """
        if self.left_out:
            one = len(self.left_out) == 1
            what = f"{len(self.left_out)} of {len(self.used)} control points contradict{'s' * one} the others and "
            what += f"{'is' if one else 'are'} left out: {listed(self.left_out, MOST_NAMED, '; ')}"
            warnings.warn(f"{where}: {what}", GeomosaicWarning, stacklevel=3)
        if self.undecided:
            warnings.warn(f"{where}: {self.undecided}", GeomosaicWarning, stacklevel=3)

    def summary(self, names: Sequence[str]) -> str:
        """Number of the points and size of their residuals, for the notes of a model.

        Parameters
        ----------
        names : sequence of str (N,)
        """
        length = np.where(self.used, np.hypot(*self.residuals.T), np.nan)
        worst, rms = int(np.nanargmax(length)), total_rms(self.residuals[self.used])
        count = f"{self.used.sum()} of {len(names)}" if self.left_out else f"{len(names)}"
        return f"{count} control points: RMS {rms:.2f} px, worst {length[worst]:.2f} px at {names[worst]}"


def resect_control(
    model: Model,
    xyz: FloatArray,
    colrow: FloatArray,
    sigmas_px: FloatArray | float | None = None,
    ids: Sequence[str] = (),
    *,
    priors: FloatArray | None = None,
    suspects: BoolArray | None = None,
) -> ControlResection[Model]:
    """Resection of a model from control points, wrong ones left out; the same as `resect` where none is.

    Parameters
    ----------
    model, xyz, colrow, priors
        As for `resect`.
    sigmas_px : float or array (N,), optional
        Standard deviations of the measurements, pixels. No point is judged by a smaller scatter than these; without
        them by that of the others alone.
    ids : sequence of str, optional
        Names of the N points; their numbers from 1 unless given.
    suspects : bool array (N,), optional
        Points without which the search begins, and that stay out where the points are too few to be judged.

    Raises
    ------
    SolveError
        As `resect`.
    """
    points, image = np.asarray(xyz, dtype=np.float64), np.asarray(colrow, dtype=np.float64)
    sigma = np.array(np.broadcast_to(1.0 if sigmas_px is None else sigmas_px, (len(points),)), dtype=np.float64)
    given = model.parameters
    start = Unknowns(given.names, given.values, given.steps, given.sigmas if priors is None else priors)

    def solve(kept: BoolArray) -> Resection[Model]:
        return resect(model, points[kept], image[kept], None if sigmas_px is None else sigma[kept], priors=priors)

    def judge(at: Model) -> Judgement:
        return judge_points(at, points, image, sigma, start, known_sigmas=sigmas_px is not None)

    wrong, refused = np.zeros(len(points), dtype=np.bool_) if suspects is None else suspects, None
    try:
        solved = solve(~wrong)
        judged = judge(solved.model)
    except SolveError as error:  # a gross error can leave the fit without a solution
        refused, judged = error, judge(model)
    for _ in range(ROUNDS):
        if np.array_equal(judged.wrong, wrong) or not judged.able:
            break
        wrong, refused = judged.wrong, None
        solved = solve(~wrong)
        judged = judge(solved.model)
    if refused is not None:
        raise refused
    names = tuple(map(str, ids)) or tuple(str(number) for number in range(1, len(points) + 1))
    computed = solved.model.ground_to_image(points)
    residuals = image - computed
    used = ~wrong & np.isfinite(residuals).all(axis=1)
    rows = np.flatnonzero(~used)
    causes = confusion_causes(names, image, computed, sigma, rows)
    left_out = [
        ControlBlunder(names[row], (float(residuals[row, 0]), float(residuals[row, 1])), cause)
        for row, cause in zip(rows.tolist(), causes, strict=True)
    ]
    left_out.sort(key=lambda one: -np.nan_to_num(one.length, nan=np.inf))
    undecided = judged.text(names, residuals) if np.array_equal(judged.wrong, wrong) else ""
    return ControlResection(solved, used, residuals, tuple(left_out), undecided)


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
