"""Conflicts of camera parameters with their a-priori values: held where the measurements allow it.

Flat ground from one height bears no focal length: what no parameter describes, as trees in the wind, decides it then.
So such a parameter is held for a trial, and stays held where that changes the residuals little. Its a-priori
standard deviation alone is too weak: thousands of image positions share one small error of the model.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.orientation.block.adjustment import BlockAdjustment
from geomosaic.orientation.block.observations import in_units
from geomosaic.orientation.block.problem import BlockProblem, Priors
from geomosaic.orientation.block.unknowns import BlockState
from geomosaic.types import BoolArray

# A-priori standard deviations that a camera's parameter may move: more is no chance.
FAR = 4.0
# Rise of the RMS of residuals up to which a parameter is held.
RISE = 1.1
# Share of the image positions by which fewer may take part with it.
LOST = 0.01


@dataclass(frozen=True)
class PriorConflict:
    """Camera parameter that came out far from what was known of it.

    Attributes
    ----------
    name : str
    start, wanted : float
        What was known, and where it came when it was free.
    deviations : float
        A-priori standard deviations between the two.
    rms : tuple of float, optional
        Of the image positions, free and held, pixels; None where it stays free.
    """

    name: str
    start: float
    wanted: float
    deviations: float
    rms: tuple[float, float] | None

    @property
    def text(self) -> str:
        """What happened to it, in words."""
        far = f"{self.deviations:.2g} of its a-priori standard deviations"
        if self.rms is None:
            return (
                f"{self.name} came to {self.wanted:.6g} from {self.start:.6g}, {far}, and held the measurements fit "
                "worse: either that was wrong, or what no parameter describes has moved it. Check it, hold it (leave "
                "it out of `interior`), or add control points, oblique photos or a strip at another height"
            )
        free, held = self.rms
        return (
            f"{self.name} is held at {self.start:.6g}: free it would come to {self.wanted:.6g}, {far}, and gain next "
            f"to nothing (image positions fit to {free:.3g} px RMS in place of {held:.3g}); flat ground from one "
            "height bears no such calibration. To free it, name it in `interior` without a standard deviation, or add "
            "control points, oblique photos or a strip at another height"
        )


def adjust_near_known(
    problem: BlockProblem, start: BlockState, adjust: Callable[[BlockProblem, BlockState], BlockAdjustment]
) -> tuple[BlockAdjustment, list[PriorConflict]]:
    """Adjustment in which camera parameters that leave what is known of them for next to nothing are held.

    Parameters
    ----------
    problem : BlockProblem
    start : BlockState
    adjust : callable
        What gives the adjustment of a problem from a start.

    Returns
    -------
    found : BlockAdjustment
    conflicts : list of PriorConflict
        Parameters that were held, and those that stay free.
    """
    free = found = adjust(problem, start)
    conflicts = dict[tuple[int, int], PriorConflict]()
    while waiting := [each for each in _conflicts(found) if each[:2] not in conflicts]:
        camera, index, wanted, far = max(waiting, key=lambda each: each[3])
        own = found.problem.unknowns.interiors[camera]
        less, first = _holding(problem, start, camera, index)
        rms = None
        try:
            trial = adjust(less, first)
            rms = _alike(free, trial)
        except SolveError:  # held, it is no block: free it was one
            pass
        if rms is not None:
            found, problem, start = trial, less, first
        conflicts[camera, index] = PriorConflict(own.names[index], float(own.start[index]), wanted, far, rms)
    return found, list(conflicts.values())


def _conflicts(found: BlockAdjustment) -> list[tuple[int, int, float, float]]:
    """Camera, number, value and a-priori standard deviations of the way of each parameter that came out too far."""
    unknowns, conflicts = found.problem.unknowns, []
    parts = unknowns.split(found.state.values(unknowns))[len(unknowns.images) :]
    for camera, (own, values) in enumerate(zip(unknowns.interiors, parts, strict=False)):
        known = np.isfinite(own.sigmas) & (own.sigmas > 0.0)
        far = np.abs(values - own.start) / np.where(known, own.sigmas, np.inf)
        conflicts += [(camera, i, float(values[i]), float(far[i])) for i in np.flatnonzero(far > FAR).tolist()]
    return conflicts


def _holding(problem: BlockProblem, start: BlockState, camera: int, index: int) -> tuple[BlockProblem, BlockState]:
    """Problem and start in which a camera's parameter keeps its first value."""
    unknowns = problem.unknowns
    interiors = list(unknowns.interiors)
    sigmas = interiors[camera].sigmas.copy()
    sigmas[index] = 0.0
    interiors[camera] = replace(interiors[camera], sigmas=sigmas)
    groups = [group for group in problem.groups if not isinstance(group, Priors)]
    less = BlockProblem.of(problem.frame, replace(unknowns, interiors=tuple(interiors)), groups)
    points = np.where(start.moving[:, None], start.points, np.nan)
    less = replace(less, robust=problem.robust, free=problem.free)
    return less, less.start(start.models, points, start.further)


def _alike(free: BlockAdjustment, held: BlockAdjustment) -> tuple[float, float] | None:
    """RMS of the image positions, pixels, free and held; None where the measurements fit worse with what is held."""
    known = {each.index for each in free.wrong_groups}
    if any(each.index not in known for each in held.wrong_groups):
        return None
    for index in range(1, len(held.problem.groups)):
        if isinstance(held.problem.groups[index], Priors):
            continue
        one, other = (_whitened(each, index) for each in (free, held))
        # What is known of places and angles may contradict it, where images of vertical photos do not.
        if held.rejected[index].sum() > free.rejected[index].sum() or other > max(1.0, RISE * one):
            return None
    # Of a point of few rays now this one is left out and now that one: only how many says something.
    used, left = (each.state.weights[0] > 0.0 for each in (free, held))
    if left.sum() < (1.0 - LOST) * used.sum():
        return None
    both: BoolArray = used & left
    sizes = [
        np.linalg.norm(in_units(each.problem.views, each.statistics[0].residuals), axis=1) for each in (free, held)
    ]
    before, after = (float(np.sqrt((size[both] ** 2).mean())) for size in sizes)
    return (before, after) if after < RISE * before else None


def _whitened(found: BlockAdjustment, index: int) -> float:
    """RMS of the residuals of a group over their standard deviations."""
    part = found.state.weights[index] > 0.0
    return float(np.sqrt((found.statistics[index].residuals[part] ** 2).mean())) if part.any() else 0.0
