"""Four points of an oblique photo: a projective fit is determined by them, and nothing is left to check it."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np

from geomosaic.adjust.choose import Choice
from geomosaic.adjust.fit import ControlFit, fit_control
from geomosaic.adjust.problem import Build
from geomosaic.control.finding import Advice
from geomosaic.control.points import ImageControl
from geomosaic.control.spread import collinear
from geomosaic.errors import GeomosaicError
from geomosaic.types import FloatArray

FOUR = 4
MISSED = 5.0
"""Pixels, from which on a fit of fewer parameters is not kept: it would be seen."""
AGREE = 0.1
"""Share of that error within which three points agree, so that the fourth is wrong and the photo not oblique."""


def look_at_four(
    points: ImageControl, choice: Choice, builder: Callable[[str, ImageControl], Build]
) -> tuple[str, Advice | None]:
    """Say why a projective fit takes the place of the one chosen, or which of four points is wrong.

    The one chosen is kept where it misses the points by no more than a hand does. Else, where three of them fit
    together without the fourth, that is wrong; where none do, and they are the corners of a convex figure, passed in
    the same order, in the image and on the ground, a projective fit is made.

    Parameters
    ----------
    points : ImageControl
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
            mend = f"measure again, and more points; or leave out what is known to be wrong: --without {name}"
            return "", Advice("contradiction", "error", what, (name,), mend)
    if not _same_figure(points):
        return "", None
    why = f"passes through the four points, which {choice.name} misses by {missed:.1f} px: the photo is oblique, or a "
    return why + "point is wrong, and nothing is left to tell", None


def _error(fit: ControlFit) -> float:
    """Length of the error of a point, RMS, pixels, as the redundancy has it."""
    return fit.sigma0 * float(np.sqrt(2.0) * np.median(fit.sigma))


def _same_figure(points: ImageControl) -> bool:
    """Whether the points are corners of a convex figure in both, in one order, rows running down and y up.

    Else a horizon runs between them, or the photo is mirrored; two exchanged points do either.
    """
    return bool((_turns(points.colrow) == -_turns(points.xy)).all())


def _turns(places: FloatArray) -> FloatArray:
    """Sense in which every three of four places (4, 2) run."""
    corners = places[list(combinations(range(FOUR), FOUR - 1))]
    signs: FloatArray = np.sign(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    return signs
