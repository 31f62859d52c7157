"""Fit of one image to its control points, with the diagnostics made on the way."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from pyproj import CRS

from geomosaic.accuracy.check_points import check_diagnostics
from geomosaic.control.coordinate_diagnostics import SEVERITIES, Diagnostic, has_valid_positions
from geomosaic.control.diagnostics import diagnose
from geomosaic.control.parsing import Reading
from geomosaic.control.points import ControlPoints
from geomosaic.errors import InputError
from geomosaic.geo.transform import Transform
from geomosaic.georeferencing.blunder_check import BlunderCheck
from geomosaic.georeferencing.fit_diagnostics import (
    blunder_diagnostics,
    checked_blunder_diagnostics,
    comparison_diagnostics,
    deletion_diagnostics,
    distortion_diagnostics,
    large_error_diagnostics,
    outlier_diagnostics,
    stop_on_errors,
)
from geomosaic.georeferencing.model_trial import kind_order, need_possible, problem_of, try_models
from geomosaic.options.control import FitOptions
from geomosaic.orientation.single.check_points import CheckStatistics, check_model
from geomosaic.orientation.single.fit import ControlBlunders, ControlFit, fit_problem
from geomosaic.orientation.single.model_selection import Deletion, ModelChoice, delete_points
from geomosaic.orientation.single.problem import map_by_image
from geomosaic.types import FloatArray


@dataclass(frozen=True, eq=False)
class Solution:
    """The fit of an image to its control.

    Attributes
    ----------
    model : str
        Name of the model, see `options.control.MODELS`.
    why : str
        Reason for this model.
    crs : CRS
        CRS of the fit.
    control : ControlPoints
        All N points of the image, x and y in `crs`.
    states : tuple of str
        State of each point: 'control' (in the fit), 'check' (judges it), 'deleted' (by the threshold), 'suspect' (left
        out as a blunder) or 'disabled' (in the file or by the user).
    fit : ControlFit
    residuals, map_residuals : array (N, 2)
        Residuals of all points (col, row) in pixels and (x, y) in map units, measured minus computed; NaN where the
        model has no image of the point.
    choice : ModelChoice, optional
        All models with their leave-one-out errors, where points were enough to compare them.
    deletion : Deletion, optional
        Point deletion, where a threshold was given.
    robust : ControlBlunders, optional
        Blunder search under the model, where points were enough.
    blunder_summary : str
        Result of the search in a sentence, or why there was none.
    blunder_check : BlunderCheck, optional
        Blunders found without the model.
    check : CheckStatistics, optional
        Statistics of the check points, map units.
    diagnostics : tuple of Diagnostic
        Findings, errors first.
    """

    model: str
    why: str
    crs: CRS
    control: ControlPoints
    states: tuple[str, ...]
    fit: ControlFit
    residuals: FloatArray
    map_residuals: FloatArray
    choice: ModelChoice | None
    deletion: Deletion | None
    robust: ControlBlunders | None
    blunder_summary: str
    blunder_check: BlunderCheck | None
    check: CheckStatistics | None
    diagnostics: tuple[Diagnostic, ...]


def solve(
    reading: Reading,
    image: str,
    size: tuple[int, int],
    crs: CRS,
    request: FitOptions,
    near: tuple[float, float] | None,
    unit: str,
    memory: int,
) -> Solution:
    """Fit of an image to its control points, checked before and after.

    Parameters
    ----------
    reading : Reading
        The control points and their file.
    image : str
        Name of the image.
    size : tuple of int
        Width and height of the image, pixels.
    crs : CRS
        CRS of the fit.
    request : FitOptions
        Model, threshold and treatment of blunders.
    near : tuple of float, optional
        Longitude and latitude near the image, degrees.
    unit : str
        Unit of `crs`, for messages.
    memory : int
        Bytes that the fit may take.

    Raises
    ------
    BadControlError
        The diagnostics have errors, and the user does not insist.
    SolveError
        The points do not determine the fit: it is refused whether or not the user insists.
    """
    given, where = reading.control, reading.control.origins[0].path
    auto = request.model == "auto"
    why = "as asked for"
    diagnostics = check_control(given, size, request, near)
    control = _in_fit_crs(given, crs)
    points = control.of_role("control")
    if not len(points):
        raise InputError("no point takes part in the fit: all are disabled or check points", where=where, hint=HINT)
    searched = points.names
    omitted = need_possible(request.model, points, memory)
    trial = try_models(image, size, points, request, memory)
    name, points, choice = trial.model, trial.points, trial.choice
    if auto:
        diagnostics = _control_diagnostics(given, name, size, near)
        stop_on_errors(diagnostics, where, insist=request.insist)
        diagnostics = (*diagnostics, *omitted)
        why = trial.reason or (choice.summary.removeprefix(f"{name}: ") if choice is not None else why)
    problem = problem_of(name, image, size, points)
    deletion = None
    if request.deletes:
        deletion = delete_points(problem, request.threshold, request.threshold_xy)
        fit = deletion.fit
    elif choice is not None and choice.name == name and choice.fit.ids == points.names:
        fit = choice.fit
    else:
        fit = fit_problem(problem, omission=True)
    diagnostics = (*diagnostics, *deletion_diagnostics(deletion), *comparison_diagnostics(choice, name))
    if trial.search is not None:
        diagnostics = (*diagnostics, *blunder_diagnostics(trial.search, searched, fit))
        diagnostics = (*diagnostics, *distortion_diagnostics(trial.search, fit, name))
    if trial.blunder_check is not None:
        named = _blunder_names(diagnostics)
        diagnostics = (*diagnostics, *checked_blunder_diagnostics(trial.blunder_check, fit, named))
    if (
        trial.minimal_control_finding is not None
        and trial.minimal_control_finding.points[0] in fit.ids
        and not _blunder_names(diagnostics)
    ):
        diagnostics = (*diagnostics, trial.minimal_control_finding)
    diagnostics = (*diagnostics, *outlier_diagnostics(choice, fit, _blunder_names(diagnostics)))
    if not _blunder_names(diagnostics):  # blunders cause large errors: one finding is enough
        diagnostics = (*diagnostics, *large_error_diagnostics(fit, size))
    stop_on_errors(diagnostics, where, insist=request.insist)
    residuals = control.colrow - fit.model.ground_to_image(_spatial(control.xy))
    moved = np.einsum("nij,nj->ni", map_by_image(fit.model, _spatial(control.xy)), residuals)
    check = control.of_role("check")
    judged = check_model(fit.model, check.names, check.xy, check.colrow, unit) if len(check) else None
    if judged is not None:
        pixels = check.colrow - fit.model.ground_to_image(_spatial(check.xy))
        found = check_diagnostics(check.names, pixels, judged.errors, unit, fit.leave_one_out_rms)
        diagnostics = (*diagnostics, *found)
    return Solution(
        name,
        why,
        crs,
        control,
        _states(control, fit, set(trial.suspects), deletion),
        fit,
        residuals,
        moved,
        choice,
        deletion,
        trial.search,
        trial.summary,
        trial.blunder_check,
        judged,
        tuple(sorted(diagnostics, key=lambda found: SEVERITIES.index(found.severity))),
    )


def check_control(
    control: ControlPoints, size: tuple[int, int], request: FitOptions, near: tuple[float, float] | None
) -> tuple[Diagnostic, ...]:
    """Findings on control points before any fit; for the model 'auto' those of the simplest, conformal.

    Parameters
    ----------
    control : ControlPoints
        All points, in their own CRS.
    size : tuple of int
        Width and height of the image, pixels.
    request : FitOptions
    near : tuple of float, optional
        Longitude and latitude near the image, degrees.

    Raises
    ------
    BadControlError
        The diagnostics have errors, and the user does not insist.
    """
    diagnostics = _control_diagnostics(control, "conformal" if request.model == "auto" else request.model, size, near)
    possible = has_valid_positions(control.select(control.enabled))
    stop_on_errors(diagnostics, control.origins[0].path, insist=request.insist, possible=possible)
    return diagnostics


HINT = "enable some, or give some the role 'control'"


def _control_diagnostics(
    control: ControlPoints, name: str, size: tuple[int, int], near: tuple[float, float] | None
) -> tuple[Diagnostic, ...]:
    kind, order = kind_order(name)
    return diagnose(control, kind=kind, order=order, size=size, near=near)


def _blunder_names(diagnostics: tuple[Diagnostic, ...]) -> list[str]:
    return [name for found in diagnostics if found.code in ("blunder", "contradiction") for name in found.points]


def _in_fit_crs(control: ControlPoints, crs: CRS) -> ControlPoints:
    """Control points (x, y) in the CRS of the fit, without disabled points that cannot be transformed to it."""
    flat = replace(control, ground=control.xy)
    if not control.enabled.all():
        there = np.isfinite(Transform(flat.crs, crs)(flat.ground)).all(axis=1)
        flat = flat.select(flat.enabled | there)
    return flat.to_crs(crs)


def _spatial(xy: FloatArray) -> FloatArray:
    return np.column_stack([xy, np.zeros(len(xy))])


def _states(control: ControlPoints, fit: ControlFit, suspects: set[str], deletion: Deletion | None) -> tuple[str, ...]:
    deleted = {row.id for row in deletion.deleted} if deletion is not None else set()
    used = set(fit.ids)

    def state(name: str, role: str, enabled: bool) -> str:
        if not enabled:
            return "disabled"
        if role == "check":
            return "check"
        if name in used:
            return "control"
        return "deleted" if name in deleted else "suspect" if name in suspects else "disabled"

    return tuple(state(*each) for each in zip(control.names, control.roles, control.enabled.tolist(), strict=True))
