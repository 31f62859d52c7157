"""A mosaic grown photo by photo, each held by map control and by the part that is made already.

The order of work of Bellman, Deakin and Rollings (Tonga): the first photo is rectified by map control; control for the
next comes from the map and, along the join, from the photos before; each join is checked before the work goes on.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.adjust.planar.attach import Attachment, fit_single, known_points, merged
from geomosaic.adjust.planar.check import elongation
from geomosaic.adjust.planar.joins import Join, join, positions_by
from geomosaic.adjust.planar.kinds import LEAST
from geomosaic.adjust.planar.solution import PlanarSolution
from geomosaic.adjust.planar.transform import PlanarTransform
from geomosaic.adjust.planar.values import Control, PlanarBlock
from geomosaic.errors import SolveError, counted
from geomosaic.types import FloatArray

ACCEPTED = 2.0
"""Pixels: residuals and shifts at joins below it passed in Tonga, with control from maps at 1:25 000."""


@dataclass(frozen=True, eq=False)
class Growth:
    """A mosaic grown photo by photo.

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
    """Place photo after photo.

    Parameters
    ----------
    block : PlanarBlock
    kind : str
        'conformal', 'affine' or 'projective'.
    start : str, optional
        Photo to begin with; unless given, the one with the most control points.
    accepted : float
        Pixels; joins beyond it are listed as failed: there more control is wanted.

    Returns
    -------
    Growth

    Raises
    ------
    SolveError
        No photo has enough control to begin with, or a photo shares too few points with the map and what is made.
    """
    if kind not in LEAST:
        raise SolveError(f"no transformation named '{kind}'", mend=f"choose one of {', '.join(LEAST)}")
    control: dict[str, list[Control]] = {photo.name: [] for photo in block.photos}
    for point in block.control:
        control[point.photo].append(point)
    first = start or max(control, key=lambda name: len(control[name]))
    block.photo(first)
    if len(control[first]) < LEAST[kind]:
        raise SolveError(
            f"no photo to begin with: '{first}' has {counted(len(control[first]), 'control point')}, "
            f"the {kind} transformation needs {LEAST[kind]}",
            mend="add control points to one photo, choose a simpler model, or adjust all photos together",
        )
    solutions: dict[str, PlanarSolution] = {}
    made: dict[str, PlanarTransform] = {}
    records: list[Attachment] = []
    checked: list[Join] = []
    places: dict[str, dict[str, FloatArray]] = {}
    waiting = [photo.name for photo in block.photos]
    found: dict[str, tuple[list[Control], tuple[str, ...]]] = {first: ([], ())}
    while waiting:
        points = {name: merged(seen, control[name]) for name, (seen, _) in found.items()}
        # Next to what is made comes what hangs best on it and on the map.
        near = [name for name, (seen, _) in found.items() if seen] or list(found)
        name = max(near, key=lambda one: (len(points[one]), -waiting.index(one)))
        if len(points[name]) < LEAST[kind]:
            raise SolveError(
                f"photo '{name}' has {counted(len(points[name]), 'point')} on the map or on the photos made before; "
                f"the {kind} transformation needs {LEAST[kind]}",
                mend="measure more control or tie points in it",
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
