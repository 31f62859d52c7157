"""Which model, and which points: the choice and the search for blunders, each on what the other left."""

from __future__ import annotations

from dataclasses import dataclass

from geomosaic.adjust.choose import Choice, choose_model, planar_builds
from geomosaic.adjust.explanation import MOST
from geomosaic.adjust.problem import Build, registry_build
from geomosaic.adjust.robust import BlunderSearch, search_blunders
from geomosaic.control.finding import Advice
from geomosaic.control.points import ImageControl
from geomosaic.errors import GeomosaicError
from geomosaic.product.georeference.four import look_at_four
from geomosaic.product.georeference.opinion import Opinion, confirmed, pardoned, second_opinion, unbent
from geomosaic.product.georeference.request import FitRequest, kind_order
from geomosaic.sensor.plugin import SensorRequest

SENSOR = "planar"
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
    points : ImageControl
        Those that take part in the fit.
    suspects : tuple of str
        Those left out as blunders; none unless that was asked for.
    choice : Choice, optional
        All models compared, on points that are no suspects, where points were enough for it.
    search : BlunderSearch, optional
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
    points: ImageControl
    suspects: tuple[str, ...]
    choice: Choice | None
    search: BlunderSearch | None
    said: str
    opinion: Opinion | None = None
    why: str = ""
    four: Advice | None = None


def try_models(image: str, size: tuple[int, int], points: ImageControl, request: FitRequest) -> Trial:
    """Choose the model where it is to be chosen, and look for blunders.

    A blunder spoils the choice, and the wrong model hides blunders: where blunders are to be left out and the model is
    to be chosen, both are done in turn until the model stays.

    Parameters
    ----------
    image, size : str, (int, int)
        Of the image.
    points : ImageControl
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
            found |= set(search.blunders if search is not None else () if choice is None else choice.odd)
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


def _without(points: ImageControl, names: tuple[str, ...]) -> ImageControl:
    return points.select([name not in names for name in points.names]) if names else points


def builder(model: str, image: str, size: tuple[int, int], points: ImageControl) -> Build:
    """Return the function that fits a model, by its name, to chosen points."""
    kind, order = kind_order(model)
    request = SensorRequest(image, size, {"kind": kind, "order": order}, points.crs)
    return registry_build(SENSOR, request, points.xy, points.colrow)


def _choose(image: str, size: tuple[int, int], points: ImageControl, *, needed: bool) -> Choice | None:
    """Compare all models; where the choice is not needed, as far as that takes no long time."""
    if not needed and len(points) > COMPARED:
        return None
    builds = planar_builds(SensorRequest(image, size, {}, points.crs), points.xy, points.colrow, SENSOR)
    try:
        return unbent(choose_model(builds, points.names, points.xy, points.colrow, points.sigma), points)
    except GeomosaicError:
        if needed:
            raise
        return None


def _search(
    build: Build, points: ImageControl, model: str, opinion: Opinion | None
) -> tuple[BlunderSearch | None, str]:
    if model == "tps":
        passes = "a thin plate spline passes through all points, blunders too"
        return None, f"{passes}; {opinion.said}" if opinion is not None else f"{passes}, and points are too few to tell"
    try:
        found = search_blunders(build, points.names, points.xy, points.colrow, points.sigma)
    except GeomosaicError as error:
        return None, error.what if opinion is None else f"{error.what}; {opinion.said}"
    return found, found.said
