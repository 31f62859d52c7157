"""Common rotation of a block in one step of its adjustment, applied exactly and not to first order.

What control says of a block's attitude is weak beside what rays say of its form: a block of photos good to millimetres
on points good to a metre turns by degrees without changing a residual. A linear step by ω moves each point by ω × X,
which deforms the block by |ω|²/2 of its size, thousands of standard deviations of the rays. Damping that keeps this
small would also keep the block from turning at all. So the mean rotation and the change of scale of all images are
taken out of a step, and applied as a similarity about the middle m of the block,

    X + dX + (s·Q − I − ω̂ − (s − 1)·I)·(X − m),   Q = exp(ω̂)

which equals the linear step X + dX to first order: the minimum is the same, and steps of small rotations are left as
they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from geomosaic.geo.local_frames import angle_axis, cross_matrices
from geomosaic.orientation.block.frame import BlockFrame
from geomosaic.orientation.block.poses import Pose, moved_poses, pose_of, rotation_vector
from geomosaic.sensor.plugin import SensorModel
from geomosaic.types import BoolArray, FloatArray

# Rotation in radians from which on its second order matters: below it moves no ray by more than 5e-11 radians.
LEAST = 1e-5
# Share of a step over which attitudes are differenced.
SHARE = 1e-4
# Parameters of a pose.
POSE = 6
# Iterations from a pose to the parameters of a sensor, the share that one leaves from which on the next has derivatives
# of its own, and the last one's change, in steps of about a pixel.
ITERATIONS, SLOW, NEAR = 8, 1e-2, 1e-6


class CommonRotation(NamedTuple):
    """Mean rotation and change of scale of a step, about the middle of the block."""

    rotation: FloatArray  # ω (3,), radians, about the block's axes
    scale: float  # s
    middle: FloatArray  # m (3,)

    @property
    def second_order(self) -> FloatArray:
        """What an exact similarity adds to the linear step: a matrix (3, 3) of X − m."""
        linear = cross_matrices(self.rotation[None])[0] + self.scale * np.eye(3)
        exact: FloatArray = self.scale * angle_axis(self.rotation) - linear
        return exact


def turned_together(
    models: Sequence[SensorModel], steps: Sequence[FloatArray], free: Sequence[BoolArray], frame: BlockFrame
) -> tuple[list[SensorModel], CommonRotation | None]:
    """Models after a step, their common rotation applied exactly.

    Parameters
    ----------
    models : sequence of SensorModel (M,)
        Before the step, their interior orientation after it.
    steps : sequence of array (P,)
        Changes of the parameters of each.
    free : sequence of bool array (P,)
        Which of these are estimated.
    frame : BlockFrame

    Returns
    -------
    models : list of SensorModel (M,)
    rotation : CommonRotation or None
        None where the images do not turn together by an angle that matters.
    """
    plain = [m.with_values(m.parameters.values + step) for m, step in zip(models, steps, strict=True)]
    poses = {
        i: pose_of(model, frame)
        for i, model in enumerate(models)
        if hasattr(model, "pose") and np.count_nonzero(free[i]) >= POSE
    }
    if not poses:
        return plain, None
    # Centres move linearly, and differenced over a share of the step would carry the rounding of geocentric metres.
    changes = {
        i: (pose_of(plain[i], frame).centre - pose.centre, _turn(pose, models[i], steps[i], frame))
        for i, pose in poses.items()
    }
    rotation = np.mean([-poses[i].rotation.T @ turn for i, (_, turn) in changes.items()], axis=0)
    if not LEAST < float(np.linalg.norm(rotation)) < np.pi:
        return plain, None
    centres, shifts = np.array([pose.centre for pose in poses.values()]), np.array([c for c, _ in changes.values()])
    middle = centres.mean(axis=0)
    off = centres - middle
    spread = float((off**2).sum())
    common = CommonRotation(rotation, 1.0 + (float((off * shifts).sum()) / spread if spread > 0.0 else 0.0), middle)
    for i, pose in poses.items():
        shift, turn = changes[i]
        own = angle_axis(turn + pose.rotation @ rotation)
        centre = pose.centre + shift + common.second_order @ (pose.centre - middle)
        wanted = Pose(centre, own @ pose.rotation @ angle_axis(rotation).T)
        plain[i] = with_pose(plain[i], wanted, free[i], frame)
    return plain, common


def _turn(pose: Pose, model: SensorModel, step: FloatArray, frame: BlockFrame) -> FloatArray:
    """Linear change of an attitude by a step: a rotation vector (3,) about the camera's axes."""
    near = pose_of(model.with_values(model.parameters.values + SHARE * step), frame)
    return rotation_vector(near.rotation @ pose.rotation.T) / SHARE


def with_pose(model: SensorModel, wanted: Pose, free: BoolArray, frame: BlockFrame) -> SensorModel:
    """Model whose parameters give a pose, from one whose pose is near it; in the parameters' own frame.

    Parameters
    ----------
    model : SensorModel
        With a `pose`.
    wanted : Pose
        In `frame`.
    free : bool array (P,)
        Parameters that may change.
    frame : BlockFrame
    """
    design, last = None, np.inf
    for _ in range(ITERATIONS):
        left = _difference(wanted, pose_of(model, frame))
        if design is None:
            pairs = moved_poses(model, frame)
            design = np.array([_difference(after, before) for after, before in pairs]).T * free
            length = np.abs(design[:3]).max(initial=1e-300), np.abs(design[3:]).max(initial=1e-300)
            rows = np.repeat(length, 3)
        change = np.linalg.lstsq(design / rows[:, None], left / rows, rcond=1e-9)[0]
        model = model.with_values(model.parameters.values + change * model.parameters.steps)
        size = float(np.abs(change).max())
        # Geocentric metres are rounded to about 1e-8 of a step.
        if size < NEAR:
            break
        # Few steps of a block are so large that a pose's derivatives change on the way.
        design, last = (design if size < SLOW * last or last == np.inf else None), size
    return model


def _difference(one: Pose, other: Pose) -> FloatArray:
    """Shift (3,) and rotation vector (3,) from a pose to another."""
    return np.concatenate([one.centre - other.centre, rotation_vector(one.rotation @ other.rotation.T)])
