"""Observations of what object points have in common: distances, one height, planes and lines.

distances            s − |X₁ − X₂|
common heights       h − z(X), h one unknown for all points of a lake
planes and lines     0 − the distance of a point from a plane or a line with unknown place and direction
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from geomosaic.estimation.observations import Observations
from geomosaic.geo.local_frames import cross_matrices
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
    further_units = ("m",)

    @property
    def row_further(self) -> tuple[IntArray, IntArray]:
        """Each height and its lake; see `Group`."""
        return np.arange(len(self)), self.lake

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
        return _with_parameters(found, own, -1.0 / self.sigma[:, None, None])


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
    def points(self) -> IntArray:  # type: ignore[override]
        """Point of each (N,); -1 for none."""
        return np.full(len(self.first), -1)

    @property
    def row_points(self) -> tuple[IntArray, IntArray]:
        """Each distance and its ends; see `Group`."""
        return np.tile(np.arange(len(self)), 2), np.concatenate([self.first, self.second])

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
            self.points,
            np.array(ends).reshape(-1, 6),
            by_ends[:, None, :],
            np.zeros((len(self), 1, 3)),
            self.misclosure(state, frame),
        )


@dataclass(frozen=True, eq=False)
class OnSurfaces(Group):
    """Points on planes (further unknowns: two turns, one shift) or on lines (two turns, two shifts).

    In axes turned by the two turns, a plane's points have the third coordinate in common, those of a line the first
    two: true distances, whatever the turn. So planes and lines go along when a whole block turns (inner constraints).

    Attributes
    ----------
    points : int array (N,)
    body : int array (N,)
        Group of further unknowns of each point's plane or line: turns about the first two axes (degrees), and the
        common coordinates (metres).
    axes : array (N, 3, 3)
        Rows are the axes of each point's plane or line, the third along its normal or its direction, by a first fit.
    origin : array (N, 3)
        Origin of these axes.
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

    @property
    def name(self) -> str:  # type: ignore[override]
        """As reports name it."""
        return "points on lines" if self.lines else "points on planes"

    @property
    def further_units(self) -> tuple[str, ...]:  # type: ignore[override]
        """Units of the further unknowns of a plane or a line."""
        return ("deg", "deg", "m", "m") if self.lines else ("deg", "deg", "m")

    @property
    def row_further(self) -> tuple[IntArray, IntArray]:
        """Each point and its plane or line; see `Group`."""
        return np.arange(len(self)), self.body

    @property
    def observed(self) -> BoolArray:
        """Components (N, K): one of a plane, two of a line."""
        return np.ones((len(self), len(self._common)), dtype=np.bool_)

    @property
    def _common(self) -> list[int]:
        return [0, 1] if self.lines else [2]

    def _computed(self, state: BlockState) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Distances (N, K); places in turned axes (N, 3), these axes (N, 3, 3), and turns (N, 2) in radians."""
        own = np.array([state.further[each] for each in self.body.tolist()])
        turns = np.radians(own[:, :2])
        turned = np.swapaxes(Rotation.from_rotvec(_about(turns)).as_matrix(), 1, 2) @ self.axes
        places = np.einsum("nij,nj->ni", turned, state.points[self.points] - self.origin)
        return places[:, self._common] - own[:, 2:], places, turned, turns

    def meaning(self, state: BlockState, frame: BlockFrame) -> dict[int, dict[str, list[float]]]:
        """Upward normals of the planes, or directions of the lines, along the axes of the ground; see `Group`."""
        along = np.einsum("nij,nj->ni", frame.axes_of_ground(self.origin), self._computed(state)[2][:, 2])
        along *= np.where(along[:, 2:] < 0.0, -1.0, 1.0) / np.linalg.norm(along, axis=1, keepdims=True)
        name = "direction" if self.lines else "normal"
        return {body: {name: each} for body, each in zip(self.body.tolist(), along.tolist(), strict=True)}

    def misclosure(self, state: BlockState, frame: BlockFrame) -> FloatArray:
        """Whitened misclosures (N, K); see `Group`."""
        return -self._computed(state)[0] / self.sigma[:, None]

    def linearised(self, state: BlockState, unknowns: BlockUnknowns, frame: BlockFrame) -> Observations:
        """Linearisation at a state; see `Group`."""
        off, places, turned, turns = self._computed(state)
        by_turns = (cross_matrices(places) @ _right_jacobian(turns))[:, self._common, :2] * np.radians(1.0)
        shifts = np.broadcast_to(-np.eye(len(self._common)), (len(self), len(self._common), len(self._common)))
        over = self.sigma[:, None, None]
        found = of_coordinates(self.points, turned[:, self._common] / over, -off / self.sigma[:, None], unknowns)
        own = np.array([unknowns.of_further(each) for each in self.body.tolist()])
        by_own = np.concatenate([by_turns, shifts], axis=2) / over
        return _with_parameters(found, own, by_own)


def _with_parameters(found: Observations, columns: IntArray, derivatives: FloatArray) -> Observations:
    """Observations with further parameters, of columns (N, P) and derivatives (N, K, P), before their own."""
    return replace(
        found,
        columns=np.hstack([columns, found.columns]),
        by_parameters=np.concatenate([derivatives, found.by_parameters], axis=2),
    )


def _about(turns: FloatArray) -> FloatArray:
    """Rotation vectors (N, 3) of turns (N, 2) about the first two axes."""
    return np.column_stack([turns, np.zeros(len(turns))])


def _right_jacobian(turns: FloatArray) -> FloatArray:
    """Small turns (N, 3, 3) after a rotation, by changes of its vector, of turns (N, 2) about the first two axes."""
    angle = np.hypot(*turns.T)[:, None, None]
    # Series below a hundredth of a radian, where the closed form loses its digits.
    small, safe = angle < 1e-2, np.maximum(angle, 1e-2)
    first = np.where(small, 0.5 - angle**2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    second = np.where(small, 1.0 / 6.0 - angle**2 / 120.0, (safe - np.sin(safe)) / safe**3)
    cross = cross_matrices(_about(turns))
    jacobian: FloatArray = np.eye(3) - first * cross + second * cross @ cross
    return jacobian
