"""Trial of models: choice of model and search for blunders, each on what the other left."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from math import isqrt

import numpy as np

from geomosaic.control.coordinate_diagnostics import Diagnostic
from geomosaic.control.diagnostics import collinear
from geomosaic.control.points import ControlPoints
from geomosaic.errors import GeomosaicError, SolveError
from geomosaic.estimation.blunders.data_snooping import search_blunders
from geomosaic.estimation.blunders.hypotheses import MOST
from geomosaic.georeferencing.blunder_check import (
    BlunderCheck,
    check_blunders,
    confirm_blunders,
    exclude_distorted_outliers,
    exclude_distortion,
)
from geomosaic.options.control import MOST_SPLINE_POINTS, FitOptions
from geomosaic.orientation.single.fit import ControlAdjustment, ControlBlunders, ControlFit, fit_problem
from geomosaic.orientation.single.model_selection import SPLINE, ModelChoice, choose_model, planar_problems
from geomosaic.orientation.single.problem import registry_build
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.registry import plane_sensor
from geomosaic.types import FloatArray

# Kinds that are linear in their coefficients; a conformal transformation is so for either handedness of the image only.
LINEAR = ("affine", "polynomial")
# Corners of a figure that a projective transformation always fits: only simpler models tell whether one is wrong.
CORNERS = 4
# Error in pixels above which a fit of fewer parameters is rejected: it would be visible in the output.
MISFIT = 5.0
# Share of that error within which three points must agree before the fourth is called a blunder.
# In an oblique photo no three of four points fit a conformal transformation so much better than all four do.
AGREEMENT = 0.1
# Number of points up to which a model that was asked for is compared with the others (leave-one-out refits).
MOST_COMPARED = 300
# Number of points up to which 'auto' tries the spline: with them each solution, whose cost grows with their cube, takes
# some seconds, and there are several.
MOST_SPLINED = 3000
# Bytes for each pair of points that solving a spline takes: its matrix, the inverse, and the work of inverting it.
SPLINE_BYTES = 40
# Limit on alternations of model choice and blunder search; it ends earlier where nothing changes.
ROUNDS = 4


def kind_order(model: str) -> tuple[str, int]:
    """Kind and order of a model, as options of the planar sensor.

    Parameters
    ----------
    model : str
    """
    return ("polynomial", int(model[4:])) if model.startswith("poly") else (model, 1)


def _most_splined(memory: int) -> int:
    """Number of points of the largest spline that can be solved."""
    return min(isqrt(memory // SPLINE_BYTES), MOST_SPLINE_POINTS)


def need_possible(model: str, points: ControlPoints, memory: int) -> tuple[Diagnostic, ...]:
    """Check that a spline asked for can be solved; the note that 'auto' leaves it out of the choice.

    Parameters
    ----------
    model : str
        One of `options.control.MODELS`, or 'auto'.
    points : ControlPoints
        Of the fit.
    memory : int
        Bytes that a spline may take.

    Raises
    ------
    SolveError
        A spline is asked for, and would take more.
    """
    count, most = len(points), _most_splined(memory)
    thinner = "thin out the points, which a spline through noisy ones does not need all"
    if model == "tps" and count > most:
        raise SolveError(
            f"a thin plate spline through {count} points takes {SPLINE_BYTES * count**2 / 2**30:.1f} GB of memory: "
            f"{most} points at most are possible",
            where=points.origins[0].path,
            hint=f"{thinner}; or `model=poly3`, or another that averages"
            + ("; or raise `memory_limit`" if count <= MOST_SPLINE_POINTS else ""),
        )
    if model != "auto" or count <= (limit := min(most, MOST_SPLINED)):
        return ()
    what = f"'auto' leaves the thin plate spline out of the choice: {count} points, and its cost grows with their cube"
    hint = f"nothing, where the chosen fit is good enough; else {thinner}: {limit} are tried"
    return (Diagnostic("no-spline", "note", what, (), hint + (", or `model=tps`" if count <= most else "")),)


def _minimal_control_model(
    points: ControlPoints, choice: ModelChoice, problem: Callable[[str, ControlPoints], ControlAdjustment]
) -> tuple[str, Diagnostic | None]:
    """Projective model for four points of an oblique photo, or the one of them that is a blunder."""
    # The model chosen is kept while its error is below `MISFIT`. Otherwise, if three points agree without the fourth,
    # the fourth is a blunder. If no three agree and the points are the corners of a convex quadrilateral, in the same
    # order in the image and on the ground, the projective model takes its place.
    if len(points) != CORNERS or choice.name not in ("conformal", "affine") or collinear(points, "projective"):
        return "", None
    missed = _error(choice.fit)
    if not missed > MISFIT:
        return "", None
    for out in range(CORNERS):
        three = points.select([i != out for i in range(CORNERS)])
        try:
            fit = fit_problem(problem("conformal", three))
        except GeomosaicError:
            continue
        if _error(fit) < AGREEMENT * missed:
            name = points.names[out]
            what = f"{name} contradicts the other three points, which agree within {_error(fit):.2f} px (conformal); "
            what += f"{choice.name} misses all four by {missed:.1f} px"
            hint = f"measure again, and more points; or leave out what is known to be wrong: `without={name}`"
            return "", Diagnostic("contradiction", "error", what, (name,), hint)
    if not _same_figure(points):
        return "", None
    reason = (
        f"passes through the four points, which {choice.name} misses by {missed:.1f} px: the photo is oblique, or a "
    )
    return reason + "point is wrong, and nothing is left to tell", None


def _error(fit: ControlFit) -> float:
    """RMS length of the error of a point, pixels: from sigma 0, so that few residuals are not taken for accuracy."""
    return fit.sigma0 * float(np.sqrt(2.0) * np.median(fit.sigma))


def _same_figure(points: ControlPoints) -> bool:
    """Whether the four points have the same orientation in image and map, rows counted downwards."""
    # If not, the horizon of the projective transformation runs between them or the photo is mirrored; both happen when
    # two points are exchanged.
    return bool((_turns(points.colrow) == -_turns(points.xy)).all())


def _turns(places: FloatArray) -> FloatArray:
    """Orientation (+1 counter-clockwise, -1 clockwise, y up) of each triangle of four points (4, 2)."""
    corners = places[list(combinations(range(CORNERS), CORNERS - 1))]
    signs: FloatArray = np.sign(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    return signs


@dataclass(frozen=True, eq=False)
class ModelTrial:
    """Model, its points and the blunders found on the way.

    Attributes
    ----------
    model : str
        Asked for or chosen.
    points : ControlPoints
        Points of the fit.
    suspects : tuple of str
        Points left out as blunders; none unless `robust` was asked for.
    choice : ModelChoice, optional
        Comparison of all models on the points that are no suspects, where they are enough.
    search : ControlBlunders, optional
        Blunder search under `model`, over `points` and suspects.
    summary : str
        Result of the search in a sentence, or why there was none.
    blunder_check : BlunderCheck, optional
        Blunders found without the model.
    reason : str
        Why `model` is not that of `choice`; empty where it is.
    minimal_control_finding : Diagnostic, optional
        Blunder among four points.
    """

    model: str
    points: ControlPoints
    suspects: tuple[str, ...]
    choice: ModelChoice | None
    search: ControlBlunders | None
    summary: str
    blunder_check: BlunderCheck | None = None
    reason: str = ""
    minimal_control_finding: Diagnostic | None = None


def try_models(
    image: str, size: tuple[int, int], points: ControlPoints, request: FitOptions, memory: int
) -> ModelTrial:
    """Choice of the model, if it is 'auto', alternating with the search for blunders.

    Parameters
    ----------
    image : str
        Name of the image.
    size : tuple of int
        Width and height of the image, pixels.
    points : ControlPoints
        Enabled control points, x and y in the CRS of the fit.
    request : FitOptions
    memory : int
        Bytes that a spline may take.

    Raises
    ------
    SolveError
        No model can be chosen.
    """
    # A blunder spoils the choice of the model, and the wrong model hides blunders: both are repeated in turn until the
    # model and the blunders stay the same.
    auto, most = request.model == "auto", min(MOST_SPLINED, _most_splined(memory))
    check = check_blunders(points, request.model)
    blamed = check.blunders if check is not None else ()
    # A blunder spoils the choice, whether or not it is to be left out of the fit.
    suspects = blamed
    clean = _without(points, suspects)
    choice = _choose(image, size, clean, most, needed=auto)
    if check is not None and blamed and len(points) > MOST:
        check = confirm_blunders(check, points, choice, _choose(image, size, points, most, needed=False))
        if check.blunders != blamed:
            blamed = suspects = check.blunders
            clean = _without(points, suspects)
            choice = _choose(image, size, clean, most, needed=auto)
    finding = None
    if auto and choice is not None:
        reason, finding = _minimal_control_model(points, choice, lambda name, some: problem_of(name, image, size, some))
        if reason:
            return ModelTrial("projective", points, (), choice, None, reason, None, reason)
    model = choice.name if auto and choice is not None else request.model
    for _ in range(ROUNDS):
        search, summary = _search(problem_of(model, image, size, points), model, check)
        if search is not None:
            search = exclude_distortion(search, points, model if choice is None else choice.name)
            summary = search.summary
        found = set(blamed)
        if request.robust or (auto and request.deletes):
            found |= set(search.blunders if search is not None else () if choice is None else choice.outliers)
        again = tuple(name for name in points.names if name in found)
        if again == suspects:
            break
        suspects = again
        clean = _without(points, suspects)
        choice = _choose(image, size, clean, most, needed=auto)
        if not auto or choice is None or choice.name == model:
            break
        model = choice.name
        if model == "tps":  # a spline passes through blunders: the search of the model before it is kept
            break
    if not request.robust:  # all points take part; point deletion, if asked for, finds the worst itself
        clean, suspects = points, ()
    return ModelTrial(model, clean, suspects, choice, search, summary, check, minimal_control_finding=finding)


def _without(points: ControlPoints, names: tuple[str, ...]) -> ControlPoints:
    # A set: of many points many may be wrong.
    wrong = set(names)
    return points.select([name not in wrong for name in points.names]) if wrong else points


def problem_of(model: str, image: str, size: tuple[int, int], points: ControlPoints) -> ControlAdjustment:
    """Problem of points and the model of a name.

    Parameters
    ----------
    model : str
    image : str
    size : tuple of int
        Width and height of the image, pixels.
    points : ControlPoints
    """
    kind, order = kind_order(model)
    request = SensorRequest(image, size, {"kind": kind, "order": order}, points.crs)
    build = registry_build(plane_sensor(), request, points.xy, points.colrow)
    problem = ControlAdjustment.of(build, points.names, points.xy, points.colrow, points.sigma)
    return replace(problem, linear=kind in LINEAR)


def _choose(image: str, size: tuple[int, int], points: ControlPoints, most: int, *, needed: bool) -> ModelChoice | None:
    """Comparison of all models, the spline up to `most` points; None where not needed and long, or failed."""
    if not needed and len(points) > MOST_COMPARED:
        return None
    request = SensorRequest(image, size, {}, points.crs)
    problems = planar_problems(request, points.names, points.xy, points.colrow, points.sigma)
    if len(points) > most:
        del problems[SPLINE]
    try:
        return exclude_distorted_outliers(choose_model(problems), points)
    except GeomosaicError:
        if needed:
            raise
        return None


def _search(problem: ControlAdjustment, model: str, check: BlunderCheck | None) -> tuple[ControlBlunders | None, str]:
    if model == "tps":
        passes = "a thin plate spline passes through all points, blunders too"
        return None, f"{passes}; {check.summary}" if check is not None else f"{passes}, and points are too few to tell"
    try:
        found = search_blunders(problem)
    except GeomosaicError as error:
        return None, error.what if check is None else f"{error.what}; {check.summary}"
    return found, found.summary
