"""Least squares on bearings: one image on known points, and poses and points of a block without a datum."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.estimation.equations import Equations
from geomosaic.estimation.network import Network, Observations
from geomosaic.estimation.solver import Problem, Stopping, solve
from geomosaic.geo.local_frames import angle_axis, cross_matrices
from geomosaic.orientation.block.bearings import Bearings, Poses
from geomosaic.types import BoolArray, FloatArray, IntArray

# A start is near enough where a round lowers the sum of squares by less than a thousandth.
ROUGH = Stopping(rounds=12, step=0.0, near=float("inf"), gain=1e-3)


def adjust_pose(
    bearings: Bearings, xyz: FloatArray, centre: FloatArray, rotation: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Pose of one image on known points.

    Parameters
    ----------
    bearings : Bearings
        Of one image, to points in front of it.
    xyz : array (N, 3)
        The point of each.
    centre : array (3,)
    rotation : array (3, 3)
        Start, from the axes of the points to those of the camera.
    """
    return solve(_OneImage(bearings, xyz), (centre, rotation), ROUGH).state


def adjust_bearings(bearings: Bearings, poses: Poses, xyz: FloatArray) -> tuple[Poses, FloatArray]:
    """Bundle adjustment of poses and points, as far as they are known.

    Parameters
    ----------
    bearings : Bearings
        To points in front of their images, two or more to each.
    poses : Poses
    xyz : array (S, 3)
        Points; those without a bearing stay.

    Returns
    -------
    poses : Poses
    xyz : array (S, 3)
        About the first image, which keeps its pose, and with a scale that one coordinate of the farthest one keeps.
    """
    images, image = np.unique(bearings.image, return_inverse=True)
    points, point = np.unique(bearings.point, return_inverse=True)
    own = Bearings(image, point, bearings.direction, bearings.angle)
    start = Poses(poses.centres[images], poses.rotations[images])
    apart = np.abs(start.centres - start.centres[0])
    held = np.zeros((len(images), 6), dtype=bool)
    held[0] = True
    held[np.unravel_index(int(np.argmax(apart)), apart.shape)] = True
    found, places = solve(_Block(own, held), (start, xyz[points]), ROUGH).state
    centres, rotations, moved = poses.centres.copy(), poses.rotations.copy(), xyz.copy()
    centres[images], rotations[images], moved[points] = found.centres, found.rotations, places
    return Poses(centres, rotations), moved


_Pose = tuple[FloatArray, FloatArray]


@dataclass(frozen=True, eq=False)
class _OneImage(Problem[_Pose]):
    """Centre and rotation vector of one image."""

    bearings: Bearings
    xyz: FloatArray

    def _seen(self, state: _Pose) -> FloatArray:
        return (self.xyz - state[0]) @ state[1].T

    def squares(self, state: _Pose) -> float:
        return float(np.sum(self.bearings.misclosure(self._seen(state)) ** 2))

    def linearise(self, state: _Pose) -> Equations:
        seen = self._seen(state)
        by_seen = self.bearings.derivatives(seen)
        design = np.concatenate([-by_seen @ state[1], -by_seen @ cross_matrices(seen)], axis=2)
        return Equations(design.reshape(-1, 6), self.bearings.misclosure(seen).ravel())

    def moved(self, state: _Pose, step: FloatArray) -> _Pose:
        return state[0] + step[:3], angle_axis(step[3:]) @ state[1]


_State = tuple[Poses, FloatArray]


@dataclass(frozen=True, eq=False)
class _Block(Problem[_State]):
    """Poses of all images but for what is held, and points."""

    bearings: Bearings
    held: BoolArray

    @property
    def _columns(self) -> IntArray:
        """Column of each pose's six unknowns (M, 6); -1 for those that are held."""
        free = ~self.held
        return np.where(free, np.cumsum(free).reshape(free.shape) - 1, -1)

    def squares(self, state: _State) -> float:
        poses, xyz = state
        return float(np.sum(self.bearings.misclosure(poses.seen(self.bearings, xyz)) ** 2))

    def linearise(self, state: _State) -> Network:
        poses, xyz = state
        seen = poses.seen(self.bearings, xyz)
        by_seen = self.bearings.derivatives(seen)
        by_point = by_seen @ poses.rotations[self.bearings.image]
        by_pose = np.concatenate([-by_point, -by_seen @ cross_matrices(seen)], axis=2)
        columns = self._columns
        rows = Observations(
            self.bearings.point, columns[self.bearings.image], by_pose, by_point, self.bearings.misclosure(seen)
        )
        blocks = np.concatenate([[0], np.cumsum((~self.held).sum(axis=1))])
        return Network((rows,), blocks, np.ones_like(xyz, dtype=bool))

    def moved(self, state: _State, step: FloatArray) -> _State:
        poses, xyz = state
        turn = np.zeros((len(poses.centres), 6))
        turn[~self.held] = step[: int((~self.held).sum())]
        rotations = np.stack([angle_axis(w) @ r for w, r in zip(turn[:, 3:], poses.rotations, strict=True)])
        return Poses(poses.centres + turn[:, :3], rotations), xyz + step[int((~self.held).sum()) :].reshape(-1, 3)
