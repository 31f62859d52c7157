"""Pairs of rays that meet: what two or three rays of a point allow to say about a blunder among them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.orientation.block.initial_values import image_rays
from geomosaic.orientation.block.observations import slices_of
from geomosaic.orientation.block.solution import BlockSolution
from geomosaic.types import BoolArray, FloatArray, IntArray

# Standard deviations by which two rays that meet may miss each other.
TOLERANCE = 4.0
# Points of one image that are compared with each other: the square of their number is.
COMPARED = 1000


@dataclass(frozen=True, eq=False)
class RayPairs:
    """Rays of image positions, by their rows.

    Attributes
    ----------
    origins, directions : array (N, 3)
        In the block's frame; NaN of rows that nobody asked for.
    spread : array (N,)
        Standard deviation of the direction, radians.
    heights : tuple of float
        Between which points may lie.
    """

    origins: FloatArray
    directions: FloatArray
    spread: FloatArray
    heights: tuple[float, float]

    @classmethod
    def of(cls, solution: BlockSolution, rows: IntArray) -> RayPairs:
        """Rays of some rows of the image positions, ascending."""
        adjustment = solution.adjustment
        views, state, frame = adjustment.problem.views, adjustment.state, adjustment.problem.frame
        origins, directions = np.full((len(views), 3), np.nan), np.full((len(views), 3), np.nan)
        spread = np.linalg.norm(np.linalg.inv(views.root), axis=(1, 2)) / np.sqrt(2.0)
        for image, part in slices_of(views.image[rows]):
            mine = rows[part]
            origins[mine], directions[mine], angle = image_rays(state.models[image], views.colrow[mine], frame.local)
            spread[mine] *= angle
        up = state.points[state.moving, 2]
        low, high = (float(up.min()), float(up.max())) if len(up) else (-np.inf, np.inf)
        # The lowest and the highest point of the ground need not be among those that were measured.
        return cls(origins, directions, spread, (low - (high - low), high + (high - low)))

    def meet(self, one: IntArray, other: IntArray) -> BoolArray:
        """Whether rays of rows (K,) meet rays of other rows (K,), before the cameras and where there may be ground."""
        base = self.origins[other] - self.origins[one]
        first, second = self.directions[one], self.directions[other]
        normal = np.cross(first, second)
        square = (normal**2).sum(axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            miss = np.abs((base * normal).sum(axis=1)) / np.sqrt(square)
            near = (np.cross(base, second) * normal).sum(axis=1) / square
            far = (np.cross(base, first) * normal).sum(axis=1) / square
            up = self.origins[one, 2] + near * first[:, 2]
            limit = TOLERANCE * np.hypot(near * self.spread[one], far * self.spread[other])
            placed = (near > 0.0) & (far > 0.0) & (up >= self.heights[0]) & (up <= self.heights[1])
            return np.asarray(placed & (miss <= limit))


def exchanged_points(solution: BlockSolution) -> dict[int, str]:
    """Causes, by points of two rays that do not meet, where these meet once two points of an image are exchanged.

    Parameters
    ----------
    solution : BlockSolution

    Returns
    -------
    dict of int to str
        Cause in words, by the number of the point.
    """
    views, moving = solution.adjustment.problem.views, solution.adjustment.state.moving
    lost = (np.bincount(views.points, minlength=len(moving)) == 2) & ~moving
    rows = np.flatnonzero(lost[views.points])
    if len(rows) < 4:
        return {}
    pairs, order = RayPairs.of(solution, rows), rows[np.argsort(views.points[rows], kind="stable")]
    partner = np.full(len(views), -1)
    partner[order[0::2]], partner[order[1::2]] = order[1::2], order[0::2]
    partners: dict[int, dict[int, list[str]]] = {}
    for image, part in slices_of(views.image[rows]):
        own = rows[part]
        if not 2 <= len(own) <= COMPARED:
            continue
        one, other = (each.ravel() for each in np.meshgrid(own, own, indexing="ij"))
        fits = pairs.meet(other, partner[one]).reshape(len(own), len(own))
        for i, j in zip(*np.nonzero(fits & fits.T & ~np.eye(len(own), dtype=np.bool_)), strict=True):
            there = partners.setdefault(int(views.points[own[i]]), {}).setdefault(int(views.points[own[j]]), [])
            there.append(solution.images[image])
    return {
        point: f"exchanged with point '{solution.ids[other]}' in {' or '.join(images)}"
        for point, found in partners.items()
        if len(found) == 1
        for other, images in found.items()
    }


def other_suspects(solution: BlockSolution, rows: IntArray) -> dict[int, list[str]]:
    """Images, by rows (N,) that were left out, whose ray of the same point may be the wrong one as well.

    Of three rays, in a strip above all: another that was kept is suspected where the one left out meets the third.

    Parameters
    ----------
    solution : BlockSolution
    rows : int array (N,)
        Image positions that were left out.

    Returns
    -------
    dict of int to list of str
        Names of the images.
    """
    views, used = solution.adjustment.problem.views, solution.adjustment.state.weights[0] > 0.0
    count = np.bincount(views.points, minlength=len(solution.ids))
    three = rows[(count[views.points[rows]] == 3) & (solution.rays[views.points[rows]] == 2)]
    mine = np.flatnonzero(np.isin(views.points, views.points[three]))
    kept: dict[int, list[int]] = {}
    for row in mine[used[mine]].tolist():
        kept.setdefault(int(views.points[row]), []).append(row)
    pairs = RayPairs.of(solution, mine)
    found: dict[int, list[str]] = {}
    for row in three.tolist():
        ends = np.array(kept[int(views.points[row])])
        meets = pairs.meet(np.array([row, row]), ends)
        # Where it meets one, the other of the two may be wrong.
        names = [solution.images[int(views.image[end])] for end in ends[::-1][meets].tolist()]
        if names:
            found[row] = names
    return found
