"""Points that a robust start has lost, intersected anew from the adjusted images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geomosaic.orientation.block.initial_values import image_rays, pixel_angles
from geomosaic.orientation.block.problem import BlockProblem
from geomosaic.orientation.block.triangulation import Rays, triangulate
from geomosaic.orientation.block.unknowns import BlockState
from geomosaic.types import BoolArray, FloatArray

# Standard deviations by which rays that agree may miss each other, and rays that must agree: two of them always meet
# somewhere, so that a third has to confirm them.
TOLERANCE, CONFIRMED = 4.0, 3
# Points with a place that are intersected beside them.
JUDGES = 300


def recover_points(
    problem: BlockProblem, state: BlockState, start: BlockState, rejected: Sequence[BoolArray], held: BoolArray
) -> tuple[BlockState, list[BoolArray]] | None:
    """Points without a place, where at least three of their rays meet.

    Parameters
    ----------
    problem : BlockProblem
    state : BlockState
        A solution.
    start : BlockState
        Before any rejection.
    rejected : sequence of bool array
        Of each group.
    held : bool array (M,)
        Images that nothing determines.

    Returns
    -------
    state : BlockState
        With first places of these points.
    rejected : list of bool array
        The rays that agree are no blunders any more.
    None
        There is no such point.
    """
    views = problem.views
    lost = start.moving & ~state.moving
    if not lost[views.points[~held[views.image]]].any():
        return None
    # Points that have a place tell the scatter of rays that agree.
    judges = np.flatnonzero(state.moving)
    wanted = lost.copy()
    wanted[judges[:: max(1, len(judges) // JUDGES)]] = True
    rows = np.flatnonzero(wanted[views.points] & ~held[views.image])
    numbers, own = np.unique(views.points[rows], return_inverse=True)
    origins, directions = np.full((len(rows), 3), np.nan), np.full((len(rows), 3), np.nan)
    angle = np.ones(len(rows))
    for image in np.unique(views.image[rows]).tolist():
        mine = views.image[rows] == image
        colrow: FloatArray = views.colrow[rows[mine]]
        origins[mine], directions[mine] = image_rays(state.models[image], colrow, problem.frame.local)
        _, beside = image_rays(state.models[image], colrow + np.array([1.0, 0.0]), problem.frame.local)
        angle[mine] = pixel_angles(directions[mine], beside)
    sigma = 1.0 / np.sqrt((views.root[rows] ** 2).sum(axis=(1, 2)) / 2.0)
    found = triangulate(Rays(origins, directions, own, angle), len(numbers), TOLERANCE * float(np.median(sigma)))
    agree = lost[numbers] & (np.bincount(own[found.used], minlength=len(numbers)) >= CONFIRMED)
    if not agree.any():
        return None
    points = state.points.copy()
    points[numbers[agree]] = found.xyz[agree]
    now = [out.copy() for out in rejected]
    mine = agree[own]
    now[0][rows[mine]] = ~found.used[mine]
    return replace(state, points=points), now
