"""Resection of one image from its control points, wrong ones found and left out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Generic, cast

import numpy as np

from geomosaic.errors import SolveError, listed, warn
from geomosaic.estimation.blunders.exchanged_points import confusion_causes
from geomosaic.estimation.solver import Unknowns
from geomosaic.estimation.statistics import total_rms
from geomosaic.sensor.plugin import ControlBlunder
from geomosaic.sensor.solve.adjust import Model, Resection, resect
from geomosaic.sensor.solve.control_judgement import MOST_NAMED, Judgement, judge_points
from geomosaic.types import BoolArray, FloatArray

# Searches at most, each linearised at the solution without the points that the one before has rejected.
ROUNDS = 5


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
            warn(f"{where}: {what}")
        if self.undecided:
            warn(f"{where}: {self.undecided}")

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

    def noted(self, names: Sequence[str], where: str) -> Model:
        """Fitted model that tells of its points: `summary` among its notes, and `left_out`, of which `warn` warns.

        Parameters
        ----------
        names : sequence of str (N,)
        where : str
            Image.
        """
        self.warn(where)
        model = cast(Any, self.solved.model)
        noted: Model = replace(model, notes=(*model.notes, self.summary(names)), left_out=self.left_out)
        return noted


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
