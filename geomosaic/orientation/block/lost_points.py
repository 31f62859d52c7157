"""Points that robust rounds or the search for blunders have lost, intersected anew from the adjusted images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from geomosaic.orientation.block.initial_values import image_rays
from geomosaic.orientation.block.observations import slices_of
from geomosaic.orientation.block.problem import BlockProblem
from geomosaic.orientation.block.triangulation import Rays, Triangulation, midpoints, triangulate
from geomosaic.orientation.block.unknowns import BlockState
from geomosaic.types import BoolArray, FloatArray, IntArray

# Standard deviations by which rays that agree may miss each other, and rays that must agree, as any two may meet by
# chance; two of three do where neither meets the third.
TOLERANCE, CONFIRMED = 4.0, 3
# The former before the cameras are adjusted: what a lens does, which is yet to be found, is no blunder.
AT_FIRST = 50.0
# Points with a place that are intersected beside them.
JUDGES = 300


def lost_points(problem: BlockProblem, state: BlockState, start: BlockState, rejected: BoolArray) -> BoolArray:
    """Points (S,) that have lost their place, or as many rays as they have left.

    One wrong ray of a fine sensor outweighs many of coarse ones, and any other ray agrees with it somewhere.

    Parameters
    ----------
    problem : BlockProblem
    state : BlockState
        A solution.
    start : BlockState
        Before any rejection.
    rejected : bool array (N,)
        Image positions.
    """
    point, count = problem.views.points, len(start.moving)
    left = np.bincount(point[state.weights[0] > 0.0], minlength=count)
    return start.moving & (~state.moving | (np.bincount(point[rejected], minlength=count) >= left))


def recover_points(
    problem: BlockProblem, state: BlockState, lost: BoolArray, rejected: Sequence[BoolArray], held: BoolArray
) -> tuple[BlockState, list[BoolArray]] | None:
    """Lost points where at least three of their rays meet, or two of three alone, and more than are left.

    Parameters
    ----------
    problem : BlockProblem
    state : BlockState
        A solution.
    lost : bool array (S,)
        See `lost_points`.
    rejected : sequence of bool array (N,)
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
    if not lost[views.points[~held[views.image]]].any():
        return None
    rows, rays, numbers, found = _intersected(problem, state, lost, ~held, TOLERANCE)
    own = rays.point
    meeting = np.bincount(own[found.used], minlength=len(numbers))
    left = np.bincount(own[state.weights[0][rows] > 0.0], minlength=len(numbers)) * state.moving[numbers]
    confirmed = (meeting >= CONFIRMED) | _only_pair(rays, meeting, _pixels(problem, rows, TOLERANCE))
    agree = lost[numbers] & confirmed & (meeting > left)
    if not agree.any():
        return None
    points = state.points.copy()
    points[numbers[agree]] = found.xyz[agree]
    now = [out.copy() for out in rejected]
    mine = agree[own]
    now[0][rows[mine]] = ~found.used[mine]
    return replace(state, points=points), now


def ray_intersections(problem: BlockProblem, state: BlockState, wanted: BoolArray) -> FloatArray:
    """Places (S, 3) where the rays of some points meet without those that disagree; NaN of all others.

    Parameters
    ----------
    problem : BlockProblem
    state : BlockState
        Orientations, and places of the other points.
    wanted : bool array (S,)
        Points.
    """
    every = np.ones(len(state.models), dtype=np.bool_)
    _, _, numbers, found = _intersected(problem, state, wanted, every, AT_FIRST)
    places = np.full_like(state.points, np.nan)
    places[numbers] = np.where(wanted[numbers, None], found.xyz, np.nan)
    return places


def _only_pair(rays: Rays, meeting: IntArray, tolerance: float) -> BoolArray:
    """Points (T,) of three rays, two of which `meeting` (T,) counts, where no other two meet."""
    three = (np.bincount(rays.point, minlength=len(meeting)) == CONFIRMED) & (meeting == 2)
    order = np.flatnonzero(three[rays.point])
    order = order[np.argsort(rays.point[order], kind="stable")]
    pairs = np.zeros(len(meeting), dtype=np.int64)
    for one, other in ((0, 1), (0, 2), (1, 2)):
        ends = [replace(rays.select(order[k::3]), point=np.arange(len(order) // 3)) for k in (one, other)]
        place = midpoints(*ends)
        pairs[three] += np.maximum(*(each.misses(place) for each in ends)) <= tolerance
    found: BoolArray = three & (pairs == 1)
    return found


def _intersected(
    problem: BlockProblem, state: BlockState, wanted: BoolArray, images: BoolArray, tolerance: float
) -> tuple[IntArray, Rays, IntArray, Triangulation]:
    """Intersections of some points from rays in some images, with others that tell the scatter of rays that agree.

    Image positions (R,) that take part, their rays, numbers of the points (T,) that these meet, and what was found.
    """
    views = problem.views
    judges = np.flatnonzero(state.moving & ~wanted)
    chosen = wanted.copy()
    chosen[judges[:: max(1, len(judges) // JUDGES)]] = True
    rows = np.flatnonzero(chosen[views.points] & images[views.image])
    numbers, own = np.unique(views.points[rows], return_inverse=True)
    origins, directions = np.full((len(rows), 3), np.nan), np.full((len(rows), 3), np.nan)
    angle = np.ones(len(rows))
    for image, part in slices_of(views.image[rows]):
        colrow: FloatArray = views.colrow[rows[part]]
        origins[part], directions[part], angle[part] = image_rays(state.models[image], colrow, problem.frame.local)
    rays = Rays(origins, directions, own, angle)
    return rows, rays, numbers, triangulate(rays, len(numbers), _pixels(problem, rows, tolerance))


def _pixels(problem: BlockProblem, rows: IntArray, factor: float) -> float:
    """A number of standard deviations of some image positions, in pixels."""
    sigma = 1.0 / np.sqrt((problem.views.root[rows] ** 2).sum(axis=(1, 2)) / 2.0)
    return factor * float(np.median(sigma))
