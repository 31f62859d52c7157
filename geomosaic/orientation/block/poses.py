"""Observed camera positions, attitudes, and poses of images relative to each other (GNSS, IMU, stereo rigs).

    camera positions     C₀ − (C(p) + R(p)ᵀ·a + o + t·d)      a lever arm, o offset and d drift of a strip, t its time
    attitudes            rotation left between R₀ and B·R(p), B the boresight
    relative positions   b₀ + b − R₁·(C₂ − C₁), b shared by all exposures of a rig
    relative attitudes   rotation left between B·R₀ and R₂·R₁ᵀ, B shared by all exposures of a rig

Derivatives by the parameters of a sensor are taken by differences: a pose is a smooth function of few numbers, and any
sensor with a pose serves.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import cast

import numpy as np
from scipy.spatial.transform import Rotation

from geomosaic.estimation.network import Observations
from geomosaic.geo.local_frames import angle_axis, angles_of
from geomosaic.orientation.block.frame import BlockFrame
from geomosaic.orientation.block.observations import Group
from geomosaic.orientation.block.unknowns import BlockState, BlockUnknowns
from geomosaic.sensor.plugin import HasPose, SensorModel
from geomosaic.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Pose:
    """Projection centre (3,) and rotation (3, 3) from the block's axes to camera axes: x right, y down, z forward."""

    centre: FloatArray
    rotation: FloatArray


def pose_of(model: SensorModel, frame: BlockFrame) -> Pose:
    """Pose of an image in the block's frame.

    Parameters
    ----------
    model : SensorModel
    frame : BlockFrame

    Raises
    ------
    TypeError
        The sensor has none.
    """
    # No `isinstance`, which asks a protocol for all its members and takes longer than the pose.
    if not hasattr(model, "pose"):
        raise TypeError(f"{type(model).__name__} has no pose")
    centre, rotation = cast(HasPose, model).pose
    local = frame.local
    if model.crs == local.crs:
        return Pose(local.to_enu(centre[None])[0], rotation @ local.axes.T)
    geocentric = frame.from_crs(model.crs, centre[None])[0]
    turn = frame.to_crs(model.crs, geocentric[None])[1][0]
    return Pose(geocentric, rotation @ turn)


def rotation_vector(rotation: FloatArray) -> FloatArray:
    """Rotation vector (3,) of a matrix (3, 3), radians.

    Parameters
    ----------
    rotation : array (3, 3)
    """
    # Written out for all but half turns: this is done for every parameter of every image, and SciPy takes 20 times as
    # long for a single matrix.
    axis: FloatArray = 0.5 * np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )
    sine, cosine = float(np.sqrt(axis @ axis)), 0.5 * (float(np.trace(rotation)) - 1.0)
    if cosine < -0.9:
        vector: FloatArray = Rotation.from_matrix(rotation).as_rotvec()
        return vector
    return axis * (float(np.arctan2(sine, cosine)) / sine) if sine > 1e-12 else axis


class PoseGroup(Group):
    """Observations of poses, each of one image or two, and of some further unknowns."""

    of_points = False
    components = 3

    root: FloatArray

    @property
    @abstractmethod
    def images(self) -> tuple[tuple[int, ...], ...]:
        """Images of each."""

    @property
    def further(self) -> tuple[tuple[int, ...], ...]:
        """Groups of further unknowns of each."""
        return ((),) * len(self.images)

    @property
    def points(self) -> IntArray:  # type: ignore[override]
        """Point of each (N,); -1 for none."""
        return np.full(len(self.images), -1)

    @property
    def row_images(self) -> tuple[IntArray, IntArray]:
        """Each observation and its images."""
        return _pairs(self.images)

    @property
    def row_further(self) -> tuple[IntArray, IntArray]:
        """Each observation and its groups of further unknowns."""
        return _pairs(self.further)

    @property
    def observed(self) -> BoolArray:
        """Components (N, K) that were observed."""
        given: BoolArray = (self.root != 0.0).any(axis=2)
        return given

    @abstractmethod
    def computed(self, row: int, poses: Sequence[Pose], further: Sequence[FloatArray]) -> FloatArray:
        """Whitened misclosure (K,) of an observation under poses and further unknowns.

        Parameters
        ----------
        row : int
            Number of the observation.
        poses : sequence of Pose
            Of the images it is of.
        further : sequence of array (K,)
            Values of further unknowns.
        """

    def misclosure(self, state: BlockState, frame: BlockFrame) -> FloatArray:
        """Whitened misclosures (N, K); see `Group`."""
        poses = {each: pose_of(state.models[each], frame) for each in {i for images in self.images for i in images}}
        return np.array(
            [
                self.computed(row, [poses[i] for i in images], [state.further[i] for i in further])
                for row, (images, further) in enumerate(zip(self.images, self.further, strict=True))
            ]
        )

    def linearised(self, state: BlockState, unknowns: BlockUnknowns, frame: BlockFrame) -> Observations:
        """Linearisation at a state; see `Group`."""
        moved = state.memo.setdefault("moved poses", {})
        for image in {i for own in self.images for i in own} - moved.keys():
            moved[image] = moved_poses(state.models[image], frame)
        rows = []
        for row, (images, further) in enumerate(zip(self.images, self.further, strict=True)):
            poses = [pose_of(state.models[i], frame) for i in images]
            values = [state.further[i] for i in further]
            columns: list[IntArray] = []
            slopes: list[FloatArray] = []
            for place, image in enumerate(images):
                model = state.models[image]
                own = unknowns.of_image(image)[: len(model.parameters)]
                columns.append(own)
                for step, pair in zip(model.parameters.steps, moved[image], strict=True):
                    ends = [self.computed(row, [*poses[:place], pose, *poses[place + 1 :]], values) for pose in pair]
                    slopes.append((ends[1] - ends[0]) / step)
            for place, group in enumerate(further):
                columns.append(unknowns.of_further(group))
                for index in range(len(values[place])):
                    ends = []
                    for change in (0.5, -0.5):
                        changed = [value.copy() for value in values]
                        # Metres and degrees alike: these functions are linear, or nearly so over a thousandth.
                        changed[place][index] += change * 1e-3
                        ends.append(self.computed(row, poses, changed))
                    slopes.append((ends[1] - ends[0]) / 1e-3)
            rows.append((np.concatenate(columns), np.array(slopes).T))
        width = max(len(columns) for columns, _ in rows)
        misclosure = self.misclosure(state, frame)
        all_columns = np.full((len(rows), width), -1)
        by_parameters = np.zeros((*misclosure.shape, width))
        for row, (columns_here, slopes_here) in enumerate(rows):
            all_columns[row, : len(columns_here)] = columns_here
            by_parameters[row, :, : len(columns_here)] = slopes_here
        return Observations(self.points, all_columns, by_parameters, np.zeros((*misclosure.shape, 3)), misclosure)


def moved_poses(model: SensorModel, frame: BlockFrame) -> list[tuple[Pose, Pose]]:
    """Poses half a step beyond and before each parameter of an image.

    Parameters
    ----------
    model : SensorModel
    frame : BlockFrame
    """
    found = []
    for index, step in enumerate(model.parameters.steps.tolist()):
        ends = []
        for change in (0.5 * step, -0.5 * step):
            values = model.parameters.values.copy()
            values[index] += change
            ends.append(pose_of(model.with_values(values), frame))
        found.append((ends[0], ends[1]))
    return found


def _pairs(numbers: Sequence[Sequence[int]]) -> tuple[IntArray, IntArray]:
    """Rows of a ragged list, and what stands in them."""
    rows = np.repeat(np.arange(len(numbers)), [len(each) for each in numbers])
    return rows, np.array([number for each in numbers for number in each], dtype=np.int64)


def _of_each(numbers: IntArray, count: int) -> tuple[tuple[int, ...], ...]:
    """Group of further unknowns of each observation: none where it is -1, or where no groups are given at all."""
    return tuple((each,) if each >= 0 else () for each in numbers.tolist()) if len(numbers) else ((),) * count


@dataclass(frozen=True, eq=False)
class CameraPositions(PoseGroup):
    """Positions of an antenna (GNSS), or of projection centres.

    Attributes
    ----------
    image : int array (N,)
    xyz : array (N, 3)
        In the block's frame.
    root : array (N, 3, 3)
        Whitening matrices.
    lever_arm : array (3,)
        Antenna less projection centre, in camera axes, metres.
    strip : int array (N,)
        Group of further unknowns, offset (3) and drift (3, per unit of time), of each position; -1 for none.
    time : array (N,)
        From the middle of the strip.
    """

    image: IntArray
    xyz: FloatArray
    root: FloatArray
    lever_arm: FloatArray = field(default_factory=lambda: np.zeros(3))
    strip: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    time: FloatArray = field(default_factory=lambda: np.zeros(0))
    name = "camera positions"
    further_units = ("m",) * 6

    @property
    def images(self) -> tuple[tuple[int, ...], ...]:
        """Images of each."""
        return tuple((each,) for each in self.image.tolist())

    @property
    def further(self) -> tuple[tuple[int, ...], ...]:
        """Groups of further unknowns of each."""
        return _of_each(self.strip, len(self.image))

    def computed(self, row: int, poses: Sequence[Pose], further: Sequence[FloatArray]) -> FloatArray:
        """Whitened misclosure (K,) of one; see `PoseGroup`."""
        (pose,) = poses
        place = pose.centre + pose.rotation.T @ self.lever_arm
        for values in further:
            place = place + values[:3] + values[3:] * self.time[row]
        left: FloatArray = self.root[row] @ (self.xyz[row] - place)
        return left


@dataclass(frozen=True, eq=False)
class Attitudes(PoseGroup):
    """Attitudes of cameras (IMU, gimbal).

    Attributes
    ----------
    image : int array (N,)
    rotation : array (N, 3, 3)
        From the block's axes to camera axes.
    root : array (N, 3, 3)
        Whitening matrices of rotations about the camera's axes, in degrees.
    boresight : int array (N,)
        Group of further unknowns, rotations (3) about the camera's axes in degrees, of each; -1 for none.
    """

    image: IntArray
    rotation: FloatArray
    root: FloatArray
    boresight: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    name = "attitudes"
    further_units = ("deg",) * 3

    @property
    def images(self) -> tuple[tuple[int, ...], ...]:
        """Images of each."""
        return tuple((each,) for each in self.image.tolist())

    @property
    def further(self) -> tuple[tuple[int, ...], ...]:
        """Groups of further unknowns of each."""
        return _of_each(self.boresight, len(self.image))

    def computed(self, row: int, poses: Sequence[Pose], further: Sequence[FloatArray]) -> FloatArray:
        """Whitened misclosure (K,) of one; see `PoseGroup`."""
        (pose,) = poses
        turned = pose.rotation
        for values in further:
            turned = angle_axis(np.radians(values)) @ turned
        left: FloatArray = self.root[row] @ np.degrees(rotation_vector(self.rotation[row] @ turned.T))
        return left


@dataclass(frozen=True, eq=False)
class RelativePoses(PoseGroup):
    """What second images have relative to first ones, as the cameras of a rig.

    Attributes
    ----------
    first, second : int array (N,)
        Images.
    root : array (N, 3, 3)
        Whitening matrices.
    rig : int array (N,)
        Group of further unknowns, corrections (3) that all exposures of a rig share; -1 for none.
    """

    first: IntArray
    second: IntArray
    root: FloatArray
    rig: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.int64), kw_only=True)

    @property
    def images(self) -> tuple[tuple[int, ...], ...]:
        """Images of each."""
        return tuple(zip(self.first.tolist(), self.second.tolist(), strict=True))

    @property
    def further(self) -> tuple[tuple[int, ...], ...]:
        """Groups of further unknowns of each."""
        return _of_each(self.rig, len(self.first))


@dataclass(frozen=True, eq=False)
class RelativePositions(RelativePoses):
    """Bases of rigs: where second projection centres lie.

    Attributes
    ----------
    base : array (N, 3)
        Second projection centre less the first, in camera axes of the first, metres.
    """

    base: FloatArray
    name = "relative positions"
    further_units = ("m",) * 3

    def computed(self, row: int, poses: Sequence[Pose], further: Sequence[FloatArray]) -> FloatArray:
        """Whitened misclosure (K,) of one; see `PoseGroup`."""
        one, other = poses
        base = self.base[row] + sum(further, np.zeros(3))
        left: FloatArray = self.root[row] @ (base - one.rotation @ (other.centre - one.centre))
        return left


@dataclass(frozen=True, eq=False)
class RelativeAttitudes(RelativePoses):
    """Rotations of rigs.

    Attributes
    ----------
    rotation : array (N, 3, 3)
        From camera axes of the first to those of the second.
    """

    rotation: FloatArray
    name = "relative attitudes"
    further_units = ("deg",) * 3

    def computed(self, row: int, poses: Sequence[Pose], further: Sequence[FloatArray]) -> FloatArray:
        """Whitened misclosure (K,) of one; see `PoseGroup`."""
        one, other = poses
        rotation = self.rotation[row]
        for values in further:
            rotation = angle_axis(np.radians(values)) @ rotation
        between = other.rotation @ one.rotation.T
        left: FloatArray = self.root[row] @ np.degrees(rotation_vector(rotation @ between.T))
        return left

    def meaning(self, state: BlockState, frame: BlockFrame) -> dict[int, dict[str, list[float]]]:
        """Omega, phi and kappa of each rig, degrees; see `Group`."""
        found = {}
        for group, rotation in zip(self.rig.tolist(), self.rotation, strict=True):
            turned = angle_axis(np.radians(state.further[group])) @ rotation
            found[group] = {"omega, phi, kappa": np.degrees(angles_of(turned)).tolist()}
        return found
