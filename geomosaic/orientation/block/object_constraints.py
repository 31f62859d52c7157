"""Observations of what object points have in common: distances, one height, planes and lines.

distances            s − |X₁ − X₂|
common heights       h − z(X), h one unknown for all points of a lake
planes and lines     0 − the distance of a point from a plane or a line with unknown place and direction
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.estimation.observations import Observations
from geomosaic.orientation.block.frame import BlockFrame
from geomosaic.orientation.block.observations import Group, of_coordinates
from geomosaic.orientation.block.unknowns import BlockState, BlockUnknowns
from geomosaic.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class CommonHeights(Group):
    """Points at one unknown height, such as shores of a lake.

    Attributes
    ----------
    points : int array (N,)
    lake : int array (N,)
        Group of further unknowns that has its height in the CRS of the ground.
    sigma : array (N,)
        Metres.
    """

    points: IntArray
    lake: IntArray
    sigma: FloatArray
    name = "common heights"

    @property
    def row_further(self) -> tuple[IntArray, IntArray]:
        """Each height and its lake; see `Group`."""
        return np.arange(len(self)), self.lake

    @property
    def point(self) -> IntArray:
        """Point of each (N,); -1 for none."""
        return self.points

    def misclosure(self, state: BlockState, frame: BlockFrame) -> FloatArray:
        """Whitened misclosures (N, K); see `Group`."""
        height = frame.to_ground(state.points[self.points])[:, 2]
        level = np.array([state.further[each][0] for each in self.lake.tolist()])
        return ((level - height) / self.sigma)[:, None]

    def linearised(self, state: BlockState, unknowns: BlockUnknowns, frame: BlockFrame) -> Observations:
        """Linearisation at a state; see `Group`."""
        slope = frame.axes_of_ground(state.points[self.points])[:, 2:3, :]
        found = of_coordinates(self.points, slope / self.sigma[:, None, None], self.misclosure(state, frame), unknowns)
        own = np.array([unknowns.of_further(each) for each in self.lake.tolist()]).reshape(-1, 1)
        return Observations(
            found.point,
            np.hstack([own, found.columns]),
            np.concatenate([-1.0 / self.sigma[:, None, None], found.by_parameters], axis=2),
            found.by_point,
            found.misclosure,
        )


@dataclass(frozen=True, eq=False)
class Distances(Group):
    """Distances between points; the points are kept among the parameters.

    Attributes
    ----------
    first, second : int array (N,)
    length, sigma : array (N,)
        Metres.
    """

    first: IntArray
    second: IntArray
    length: FloatArray
    sigma: FloatArray
    name = "distances"
    of_points = False

    @property
    def point(self) -> IntArray:
        """Point of each (N,); -1 for none."""
        return np.full(len(self.first), -1)

    def placed(self, moving: BoolArray) -> BoolArray:
        """Distances (N,) whose ends both have a place; see `Group`."""
        return moving[self.first] & moving[self.second]

    def _between(self, state: BlockState) -> tuple[FloatArray, FloatArray]:
        apart = state.points[self.second] - state.points[self.first]
        length = np.linalg.norm(apart, axis=1)
        return length, apart / length[:, None]

    def misclosure(self, state: BlockState, frame: BlockFrame) -> FloatArray:
        """Whitened misclosures (N, K); see `Group`."""
        return ((self.length - self._between(state)[0]) / self.sigma)[:, None]

    def linearised(self, state: BlockState, unknowns: BlockUnknowns, frame: BlockFrame) -> Observations:
        """Linearisation at a state; see `Group`."""
        _, along = self._between(state)
        kept, none = unknowns.kept_columns, np.full(3, -1)
        pairs = zip(self.first.tolist(), self.second.tolist(), strict=True)
        ends = [np.concatenate([kept.get(a, none), kept.get(b, none)]) for a, b in pairs]
        by_ends = np.hstack([-along, along]) / self.sigma[:, None]
        return Observations(
            self.point,
            np.array(ends).reshape(-1, 6),
            by_ends[:, None, :],
            np.zeros((len(self), 1, 3)),
            self.misclosure(state, frame),
        )


@dataclass(frozen=True, eq=False)
class OnSurfaces(Group):
    """Points on planes (2 further unknowns of direction, 1 of place) or lines (2 and 2).

    A plane has the normal n + a·e₁ + b·e₂ and the offset c: n·(X − X₀) = c. A line has the direction n + a·e₁ + b·e₂
    through X₀ + c·e₁ + d·e₂. The axes (e₁, e₂, n) and X₀ are those of a first fit.

    Attributes
    ----------
    points : int array (N,)
    body : int array (N,)
        Group of further unknowns of each point's plane or line.
    axes : array (N, 3, 3)
        Rows e₁, e₂, n of each point's plane or line.
    origin : array (N, 3)
        Its X₀.
    sigma : array (N,)
        Metres.
    lines : bool
        Whether all are lines.
    """

    points: IntArray
    body: IntArray
    axes: FloatArray
    origin: FloatArray
    sigma: FloatArray
    lines: bool
    name = "points on planes or lines"

    @property
    def row_further(self) -> tuple[IntArray, IntArray]:
        """Each point and its plane or line; see `Group`."""
        return np.arange(len(self)), self.body

    @property
    def point(self) -> IntArray:
        """Point of each (N,); -1 for none."""
        return self.points

    def _values(self, state: BlockState) -> FloatArray:
        return np.array([state.further[each] for each in self.body.tolist()])

    def _computed(self, state: BlockState) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Distances (N, K), their derivatives by the further unknowns (N, K, Q) and by the point (N, K, 3)."""
        p = self._values(state)
        local = np.einsum("nij,nj->ni", self.axes, state.points[self.points] - self.origin)
        u, v, w = local.T
        a, b, c = p[:, 0], p[:, 1], p[:, 2]
        zero, one = np.zeros_like(a), np.ones_like(a)
        if self.lines:
            off = np.stack([u - c - a * w, v - p[:, 3] - b * w], axis=1)
            by_own = np.stack(
                [np.stack([-w, zero, -one, zero], axis=1), np.stack([zero, -w, zero, -one], axis=1)], axis=1
            )
            by_local = np.stack([np.stack([one, zero, -a], axis=1), np.stack([zero, one, -b], axis=1)], axis=1)
        else:
            off = (w + a * u + b * v - c)[:, None]
            by_own = np.stack([u, v, -one], axis=1)[:, None, :]
            by_local = np.stack([a, b, one], axis=1)[:, None, :]
        return off, by_own, by_local @ self.axes

    def misclosure(self, state: BlockState, frame: BlockFrame) -> FloatArray:
        """Whitened misclosures (N, K); see `Group`."""
        return -self._computed(state)[0] / self.sigma[:, None]

    def linearised(self, state: BlockState, unknowns: BlockUnknowns, frame: BlockFrame) -> Observations:
        """Linearisation at a state; see `Group`."""
        off, by_own, by_point = self._computed(state)
        over = self.sigma[:, None, None]
        found = of_coordinates(self.points, by_point / over, -off / self.sigma[:, None], unknowns)
        own = np.array([unknowns.of_further(each) for each in self.body.tolist()])
        return Observations(
            found.point,
            np.hstack([own, found.columns]),
            np.concatenate([by_own / over, found.by_parameters], axis=2),
            found.by_point,
            found.misclosure,
        )
