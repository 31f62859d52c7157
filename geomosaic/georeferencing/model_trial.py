"""Trial of models: choice of model and search for blunders, each on what the other left."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from geomosaic.control.distribution import collinear
from geomosaic.control.findings import Advice
from geomosaic.control.points import ControlPoints
from geomosaic.errors import GeomosaicError
from geomosaic.estimation.blunders.hypotheses import MOST
from geomosaic.estimation.blunders.m_estimator import search_blunders
from geomosaic.georeferencing.independent_check import Opinion, confirmed, pardoned, second_opinion, unbent
from geomosaic.georeferencing.request import FitRequest, kind_order
from geomosaic.orientation.single.fit import ControlAdjustment, ControlBlunders, ControlFit, fit_control
from geomosaic.orientation.single.model_selection import ModelChoice, choose_model, planar_builds
from geomosaic.orientation.single.problem import Build, registry_build
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.registry import plane_sensor
from geomosaic.types import FloatArray

FOUR = 4
MISSED = 5.0
"""Pixels, from which on a fit of fewer parameters is not kept: it would be seen."""
AGREE = 0.1
"""Share of that error within which three points agree, so that the fourth is wrong and the photo not oblique."""


def look_at_four(
    points: ControlPoints, choice: ModelChoice, builder: Callable[[str, ControlPoints], Build]
) -> tuple[str, Advice | None]:
    """Say why a projective fit takes the place of the one chosen, or which of four points is wrong.

    The one chosen is kept where it misses the points by no more than a hand does. Else, where three of them fit
    together without the fourth, that is wrong; where none do, and they are the corners of a convex figure, passed in
    the same order, in the image and on the ground, a projective fit is made.

    Parameters
    ----------
    points : ControlPoints
    choice : Choice
        Among the fits that leave a point to judge them by.
    builder : callable
        Of a fit by name, to the points it is given.

    Returns
    -------
    why : str
        Empty where the fit chosen is kept.
    finding : Advice, optional
    """
    if len(points) != FOUR or choice.name not in ("conformal", "affine") or collinear(points, "projective"):
        return "", None
    missed = _error(choice.fit)
    if not missed > MISSED:
        return "", None
    for out in range(FOUR):
        three = points.select([i != out for i in range(FOUR)])
        try:
            fit = fit_control(builder("conformal", three), three.names, three.xy, three.colrow, three.sigma)
        except GeomosaicError:
            continue
        if _error(fit) < AGREE * missed:
            name = points.names[out]
            what = f"{name} contradicts the other three points, which agree within {_error(fit):.2f} px (conformal); "
            what += f"{choice.name} misses all four by {missed:.1f} px"
            hint = f"measure again, and more points; or leave out what is known to be wrong: `without={name}`"
            return "", Advice("contradiction", "error", what, (name,), hint)
    if not _same_figure(points):
        return "", None
    why = f"passes through the four points, which {choice.name} misses by {missed:.1f} px: the photo is oblique, or a "
    return why + "point is wrong, and nothing is left to tell", None


def _error(fit: ControlFit) -> float:
    """Length of the error of a point, RMS, pixels, as the redundancy has it."""
    return fit.sigma0 * float(np.sqrt(2.0) * np.median(fit.sigma))


def _same_figure(points: ControlPoints) -> bool:
    """Whether the points are corners of a convex figure in both, in one order, rows running down and y up.

    Else a horizon runs between them, or the photo is mirrored; two exchanged points do either.
    """
    return bool((_turns(points.colrow) == -_turns(points.xy)).all())


def _turns(places: FloatArray) -> FloatArray:
    """Sense in which every three of four places (4, 2) run."""
    corners = places[list(combinations(range(FOUR), FOUR - 1))]
    signs: FloatArray = np.sign(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    return signs


COMPARED = 300
"""Points up to which a model that was asked for is compared with the others."""
ROUNDS = 4


@dataclass(frozen=True, eq=False)
class Trial:
    """What was tried.

    Attributes
    ----------
    model : str
        Asked for or chosen.
    points : ControlPoints
        Those that take part in the fit.
    suspects : tuple of str
        Those left out as blunders; none unless that was asked for.
    choice : Choice, optional
        All models compared, on points that are no suspects, where points were enough for it.
    search : ControlBlunders, optional
        With `model`, over `points` and suspects.
    said : str
        What the search found, or why there is none.
    opinion : Opinion, optional
        On blunders, without the model.
    why : str
        Why another model than `choice` has.
    four : Advice, optional
        Of four points, which is wrong.
    """

    model: str
    points: ControlPoints
    suspects: tuple[str, ...]
    choice: ModelChoice | None
    search: ControlBlunders | None
    said: str
    opinion: Opinion | None = None
    why: str = ""
    four: Advice | None = None


def try_models(image: str, size: tuple[int, int], points: ControlPoints, request: FitRequest) -> Trial:
    """Choose the model where it is to be chosen, and look for blunders.

    A blunder spoils the choice, and the wrong model hides blunders: where blunders are to be left out and the model is
    to be chosen, both are done in turn until the model stays.

    Parameters
    ----------
    image, size : str, (int, int)
        Of the image.
    points : ControlPoints
        Enabled control in the CRS of the fit.
    request : FitRequest

    Raises
    ------
    SolveError
        No model can be chosen.
    """
    auto = request.model == "auto"
    opinion = second_opinion(points, request.model)
    blamed = opinion.blunders if opinion is not None else ()
    # A blunder spoils the choice, whether or not it is to be left out of the fit.
    suspects = blamed
    clean = _without(points, suspects)
    choice = _choose(image, size, clean, needed=auto)
    if opinion is not None and blamed and len(points) > MOST:
        opinion = confirmed(opinion, points, choice, _choose(image, size, points, needed=False))
        if opinion.blunders != blamed:
            blamed = suspects = opinion.blunders
            clean = _without(points, suspects)
            choice = _choose(image, size, clean, needed=auto)
    four = None
    if auto and choice is not None:
        why, four = look_at_four(points, choice, lambda name, some: builder(name, image, size, some))
        if why:
            return Trial("projective", points, (), choice, None, why, None, why)
    model = choice.name if auto and choice is not None else request.model
    for _ in range(ROUNDS):
        search, said = _search(builder(model, image, size, points), points, model, opinion)
        if search is not None:
            search = pardoned(search, points, model if choice is None else choice.name)
            said = search.said
        found = set(blamed)
        if request.robust or (auto and request.threshold is not None):
            found |= set(search.blunders if search is not None else () if choice is None else choice.outliers)
        again = tuple(name for name in points.names if name in found)
        if again == suspects:
            break
        suspects = again
        clean = _without(points, suspects)
        choice = _choose(image, size, clean, needed=auto)
        if not auto or choice is None or choice.name == model:
            break
        model = choice.name
        if model == "tps":  # it passes through blunders: the search keeps the model that found them
            break
    if not request.robust:  # all take part, and deletion finds the worst itself
        clean, suspects = points, ()
    return Trial(model, clean, suspects, choice, search, said, opinion, four=four)


def _without(points: ControlPoints, names: tuple[str, ...]) -> ControlPoints:
    return points.select([name not in names for name in points.names]) if names else points


def builder(model: str, image: str, size: tuple[int, int], points: ControlPoints) -> Build:
    """Return the function that fits a model, by its name, to chosen points."""
    kind, order = kind_order(model)
    request = SensorRequest(image, size, {"kind": kind, "order": order}, points.crs)
    return registry_build(plane_sensor(), request, points.xy, points.colrow)


def _choose(image: str, size: tuple[int, int], points: ControlPoints, *, needed: bool) -> ModelChoice | None:
    """Compare all models; where the choice is not needed, as far as that takes no long time."""
    if not needed and len(points) > COMPARED:
        return None
    builds = planar_builds(SensorRequest(image, size, {}, points.crs), points.xy, points.colrow)
    try:
        return unbent(choose_model(builds, points.names, points.xy, points.colrow, points.sigma), points)
    except GeomosaicError:
        if needed:
            raise
        return None


def _search(
    build: Build, points: ControlPoints, model: str, opinion: Opinion | None
) -> tuple[ControlBlunders | None, str]:
    if model == "tps":
        passes = "a thin plate spline passes through all points, blunders too"
        return None, f"{passes}; {opinion.said}" if opinion is not None else f"{passes}, and points are too few to tell"
    try:
        found = search_blunders(ControlAdjustment.of(build, points.names, points.xy, points.colrow, points.sigma))
    except GeomosaicError as error:
        return None, error.what if opinion is None else f"{error.what}; {opinion.said}"
    return found, found.said
