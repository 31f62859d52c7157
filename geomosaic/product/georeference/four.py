"""Four points of an oblique photo: a projective fit is determined by them, and nothing is left to check it."""

from __future__ import annotations

from collections.abc import Callable
from itertools import combinations

import numpy as np

from geomosaic.adjust.choose import Choice
from geomosaic.adjust.fit import ControlFit, fit_control
from geomosaic.adjust.problem import Build
from geomosaic.control.points import ImageControl
from geomosaic.control.spread import collinear
from geomosaic.errors import GeomosaicError
from geomosaic.types import FloatArray

FOUR = 4
MISSED = 5.0
"""Pixels, from which on a fit of fewer parameters is not kept: it would be seen."""
AGREE = 0.2
"""Share of that error within which three points agree, so that the fourth is wrong and the photo not oblique."""


def through_four(points: ImageControl, choice: Choice, builder: Callable[[str, ImageControl], Build]) -> str:
    """Say why a projective fit takes the place of the one chosen; empty where it does not.

    It does where the one chosen misses four points by more than a hand does, no three of them fit together without the
    fourth, and they are the corners of a convex figure, passed in the same order, in the image and on the ground.

    Parameters
    ----------
    points : ImageControl
    choice : Choice
        Among the fits that leave a point to judge them by.
    builder : callable
        Of a fit by name, to the points it is given.
    """
    if len(points) != FOUR or choice.name not in ("conformal", "affine") or collinear(points, "projective"):
        return ""
    missed = _error(choice.fit)
    if not missed > MISSED or not _same_figure(points):
        return ""
    for three in combinations(range(FOUR), FOUR - 1):
        chosen = points.select([i in three for i in range(FOUR)])
        try:
            fit = fit_control(builder("conformal", chosen), chosen.names, chosen.xy, chosen.colrow, chosen.sigma)
        except GeomosaicError:
            continue
        if _error(fit) < AGREE * missed:
            return ""
    return (
        f"passes through the four points, which {choice.name} misses by {missed:.1f} px: the photo is oblique, or a "
        "point is wrong, and nothing is left to tell"
    )


def _error(fit: ControlFit) -> float:
    """Length of the error of a point, RMS, pixels, as the redundancy has it."""
    return fit.sigma0 * float(np.sqrt(2.0) * np.median(fit.sigma))


def _same_figure(points: ImageControl) -> bool:
    """Whether the points are corners of a convex figure in both, in one order: else a horizon runs between them."""
    image, ground = _turns(points.colrow), _turns(points.xy)
    return bool((image == ground).all() or (image == -ground).all())


def _turns(places: FloatArray) -> FloatArray:
    """Sense in which every three of four places (4, 2) run."""
    corners = places[list(combinations(range(FOUR), FOUR - 1))]
    signs: FloatArray = np.sign(np.linalg.det(corners[:, 1:] - corners[:, :1]))
    return signs
