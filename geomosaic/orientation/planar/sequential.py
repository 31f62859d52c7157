"""Sequential planar mosaics: each photo joined to the part that is made already, with or without map control.

The order of work of Bellman, Deakin and Rollings (Tonga): the first photo is rectified by map control; control for the
next comes from the map and, along the join, from the photos before; each join is checked before the work goes on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.errors import SolveError, counted
from geomosaic.orientation.planar.determinacy import elongation
from geomosaic.orientation.planar.measurements import Control, PlanarBlock, PlanarPhoto
from geomosaic.orientation.planar.simultaneous import adjust
from geomosaic.orientation.planar.solution import Join, PlanarSolution, join, positions_by
from geomosaic.orientation.planar.transformations import LEAST, PlanarTransform
from geomosaic.types import FloatArray

# Largest elongation of the points that a photo is joined by, for each kind.
# Across the points an affine fit carries errors on by their elongation times as much as along them: at 8, points that
# err by 0.5 px put the far side of a photo wrong by several pixels, and each photo joined there carries that on.
LONGEST = {"conformal": np.inf, "affine": 8.0, "projective": 5.0}
# The same where all points are control: nothing is carried on, and the sigmas of the corners are reported.
LONGEST_OF_CONTROL = {"conformal": np.inf, "affine": 20.0, "projective": 12.0}


@dataclass(frozen=True)
class Attachment:
    """Attachment of one photo to those placed before.

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
        Condition number of the places of the points in the photo, see `determinacy.elongation`.
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
    """Fit of one photo to points with known places.

    Parameters
    ----------
    photo : PlanarPhoto
    points : sequence of Control
    kind : str
        'conformal', 'affine' or 'projective'.
    longest : mapping of str to float
        Largest elongation of the points that each kind takes.

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
                hint="choose conformal, or measure points away from the line",
            )
    return adjust(PlanarBlock((photo,), (), tuple(points)), kind, where=photo.name)


def fit_best(photo: PlanarPhoto, points: Sequence[Control], kind: str) -> tuple[PlanarSolution, str]:
    """Fit of the kind asked for, or conformal where the points do not hold it; and why.

    Parameters
    ----------
    photo : PlanarPhoto
    points : sequence of Control
    kind : str
        'conformal', 'affine' or 'projective'.
    """
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

    Parameters
    ----------
    block : PlanarBlock
    photo : str
        Name of the photo.
    places : mapping
        Map position (2,) of each point by photo, see `positions`.
    transforms : mapping of str to PlanarTransform
        By photo.

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
        # Weighted mean: a place measured in a finer photo counts more.
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


def _merged(ties: Sequence[Control], control: Sequence[Control]) -> list[Control]:
    """Points from the part made before, and from the map; of a point that comes from both, the map's place."""
    from_map = {point.id for point in control}
    return [*(point for point in ties if point.id not in from_map), *control]


# Pixels: residuals and shifts at joins below it passed in Tonga, with control from maps at 1:25 000.
ACCEPTED = 2.0


@dataclass(frozen=True, eq=False)
class Growth:
    """Sequential mosaic, placed photo by photo.

    Attributes
    ----------
    solutions : dict of str to PlanarSolution
        In the order of work.
    attachments : tuple of Attachment
        What each photo was placed by.
    joins : tuple of Join
        Checked when the second photo of each was sewn in.
    failed : tuple of Join
        Those whose shift along or across the seam, or whose largest gap, exceeds what is accepted.
    """

    solutions: dict[str, PlanarSolution]
    attachments: tuple[Attachment, ...]
    joins: tuple[Join, ...]
    failed: tuple[Join, ...]

    @property
    def transforms(self) -> dict[str, PlanarTransform]:
        """Transformation of each photo, in the order of work."""
        return {name: solution.transforms[name] for name, solution in self.solutions.items()}


def grow(block: PlanarBlock, kind: str = "affine", *, start: str | None = None, accepted: float = ACCEPTED) -> Growth:
    """Sequential mosaic: photo after photo is placed on the map and on those before.

    Parameters
    ----------
    block : PlanarBlock
    kind : str
        'conformal', 'affine' or 'projective'.
    start : str, optional
        Photo to begin with; unless given, the one with the most control points.
    accepted : float
        Pixels; joins beyond it are listed as failed: there more control is wanted.

    Raises
    ------
    SolveError
        No photo has enough control to begin with, or a photo shares too few points with the map and what is made.
    """
    if kind not in LEAST:
        raise SolveError(f"no transformation named '{kind}'", hint=f"choose one of {', '.join(LEAST)}")
    control: dict[str, list[Control]] = {photo.name: [] for photo in block.photos}
    for point in block.control:
        control[point.photo].append(point)
    first = start or max(control, key=lambda name: len(control[name]))
    block.photo(first)
    if len(control[first]) < LEAST[kind]:
        raise SolveError(
            f"no photo to begin with: '{first}' has {counted(len(control[first]), 'control point')}, "
            f"the {kind} transformation needs {LEAST[kind]}",
            hint="add control points to one photo, choose a simpler model, or adjust all photos together",
        )
    solutions: dict[str, PlanarSolution] = {}
    made: dict[str, PlanarTransform] = {}
    records: list[Attachment] = []
    checked: list[Join] = []
    places: dict[str, dict[str, FloatArray]] = {}
    waiting = [photo.name for photo in block.photos]
    found: dict[str, tuple[list[Control], tuple[str, ...]]] = {first: ([], ())}
    while waiting:
        points = {name: _merged(seen, control[name]) for name, (seen, _) in found.items()}
        # Next to what is made comes what hangs best on it and on the map.
        near = [name for name, (seen, _) in found.items() if seen] or list(found)
        name = max(near, key=lambda one: (len(points[one]), -waiting.index(one)))
        if len(points[name]) < LEAST[kind]:
            raise SolveError(
                f"photo '{name}' has {counted(len(points[name]), 'point')} on the map or on the photos made before; "
                f"the {kind} transformation needs {LEAST[kind]}",
                hint="measure more control or tie points in it",
            )
        photo, to = block.photo(name), found[name][1]
        solution = fit_single(photo, points[name], kind)
        solutions[name], made[name] = solution, solution.transforms[name]
        ratio = elongation(photo.size, np.array([[point.col, point.row] for point in points[name]]))
        own = len(control[name])
        records.append(Attachment(name, to, kind, len(points[name]) - own, own, ratio, "", solution.rms))
        places[name] = positions_by(block, made[name])
        checked += [one for other in to if (one := join(other, name, made, places)) is not None]
        waiting.remove(name)
        sharing = {other for point in places[name] for other in block.sharing[point]}
        changed = [other for other in waiting if other in sharing or other not in found]
        del found[name]
        found.update({other: known_points(block, other, places, made) for other in changed})
    failed = tuple(one for one in checked if max(abs(one.along), abs(one.across), one.largest) > accepted)
    return Growth(solutions, tuple(records), tuple(checked), failed)
