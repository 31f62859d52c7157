"""Joining one photo to a part that is made already: the step that uncontrolled and growing mosaics repeat."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.adjust.planar.check import elongation
from geomosaic.adjust.planar.kinds import LEAST
from geomosaic.adjust.planar.simultaneous import adjust
from geomosaic.adjust.planar.solution import PlanarSolution
from geomosaic.adjust.planar.transform import PlanarTransform
from geomosaic.adjust.planar.values import Control, PlanarBlock, PlanarPhoto
from geomosaic.errors import SolveError
from geomosaic.types import FloatArray

LONGEST = {"conformal": np.inf, "affine": 8.0, "projective": 5.0}
"""Largest elongation of the points that a photo is joined by, for each kind.

Across the points an affine fit carries errors on by their elongation times as much as along them: at 8, points that err
by 0.5 px put the far side of a photo wrong by several pixels, and each photo joined there carries that on.
"""
LONGEST_OF_CONTROL = {"conformal": np.inf, "affine": 20.0, "projective": 12.0}
"""The same where all points are control: nothing is carried on, and the standard deviations of the corners are told."""


@dataclass(frozen=True)
class Attachment:
    """How one photo was joined to the others.

    Attributes
    ----------
    photo : str
    to : tuple of str
        Photos made before that it shares points with.
    kind : str
        Transformation that was fitted.
    points, control : int
        Tie points and control points that placed it.
    elongation : float
        Condition number of the places of the points in the photo, see `check.elongation`.
    refused : str
        What stood against the kind that was asked for; empty where nothing did.
    rms : float
        Of the residuals, pixels; NaN for the photo it began with.
    """

    photo: str
    to: tuple[str, ...]
    kind: str
    points: int
    control: int
    elongation: float
    refused: str
    rms: float


def fit_single(
    photo: PlanarPhoto, points: Sequence[Control], kind: str, longest: Mapping[str, float] = LONGEST
) -> PlanarSolution:
    """Fit one photo to points with known places.

    Raises
    ------
    SolveError
        Too few points, or points nearly on a line for an affine or projective transformation; names their condition
        number.
    """
    if len(points) >= max(2, LEAST.get(kind, 0)):
        ratio = elongation(photo.size, np.array([[point.col, point.row] for point in points]))
        if ratio > longest.get(kind, np.inf):
            raise SolveError(
                f"the {len(points)} points lie nearly on a line: their condition number is {ratio:.3g}, and "
                f"{longest[kind]:g} is the most that the {kind} transformation takes",
                where=photo.name,
                mend="choose conformal, or measure points away from the line",
            )
    return adjust(PlanarBlock((photo,), (), tuple(points)), kind, where=photo.name)


def fit_best(photo: PlanarPhoto, points: Sequence[Control], kind: str) -> tuple[PlanarSolution, str]:
    """Fit the kind asked for, or conformal where the points do not hold it; and what was said against it."""
    if kind == "conformal":
        return fit_single(photo, points, kind), ""
    try:
        return fit_single(photo, points, kind), ""
    except SolveError as error:
        return fit_single(photo, points, "conformal"), error.what


def known_points(
    block: PlanarBlock,
    photo: str,
    places: Mapping[str, Mapping[str, FloatArray]],
    transforms: Mapping[str, PlanarTransform],
) -> tuple[list[Control], tuple[str, ...]]:
    """Points of a photo that photos made before show, as control at the mean of their positions there.

    Returns
    -------
    points : list of Control
        Each with the standard deviation that the photos' measurements give the mean.
    to : tuple of str
        The photos they come from.
    """
    found, to = [], set[str]()
    for measured in block.by_photo[photo].values():
        seen = [name for name in block.sharing[measured.id] if name in transforms and name != photo]
        if not seen:
            continue
        spread = [block.by_photo[name][measured.id].sigma * transforms[name].pixel() for name in seen]
        weight = 1.0 / np.square(spread)
        x, y = np.average([places[name][measured.id] for name in seen], axis=0, weights=weight)
        found.append(
            Control(
                measured.id, float(x), float(y), photo, measured.col, measured.row, measured.sigma,
                float(1.0 / np.sqrt(weight.sum())),
            )
        )  # fmt: skip
        to.update(seen)
    return found, tuple(name for name in transforms if name in to)


def merged(ties: Sequence[Control], control: Sequence[Control]) -> list[Control]:
    """Points from the part made before, and from the map; of a point that comes from both, the map's place."""
    from_map = {point.id for point in control}
    return [*(point for point in ties if point.id not in from_map), *control]
