"""Flight paths of a scanner: orbit with attitude angles or quaternions, tables of poses."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal, Protocol, Self

import numpy as np

from geomosaic.types import FloatArray
from geomosaic_pushbroom.orbit import Orbit, horner
from geomosaic_pushbroom.pose import Pose, cross, matrices_of_quaternions, satellite_pose, turned, unit


@dataclass(frozen=True, eq=False)
class QuaternionTable:
    """Orbit with quaternions linear between the times of a table, and normalised.

    Beyond its ends the table goes on at the mean speed of its outer tenth, for as long as its own duration.

    Attributes
    ----------
    orbit : Orbit
    times : array (K,)
        Seconds from the middle of the scene.
    quaternions : array (K, 4)
        From satellite to geocentric axes, see `satellite_pose`; neighbours of the same sign.
    """

    kind: ClassVar[str] = "quaternion_table"
    orbit: Orbit
    times: FloatArray
    quaternions: FloatArray

    @cached_property
    def _nodes(self) -> tuple[FloatArray, FloatArray]:
        t, q = self.times, self.quaternions
        back = max(1, len(t) // 10)
        length = t[-1] - t[0]
        first = q[0] - (q[back] - q[0]) * (length / (t[back] - t[0]))
        last = q[-1] + (q[-1] - q[-1 - back]) * (length / (t[-1] - t[-1 - back]))
        return np.concatenate([[t[0] - length], t, [t[-1] + length]]), np.vstack([first, q, last])

    def pose(self, times: FloatArray) -> Pose:
        """Pose at times (N,)."""
        position, _ = self.orbit.at(times)
        nodes, values = self._nodes
        return satellite_pose(position, np.column_stack([np.interp(times, nodes, column) for column in values.T]))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        table = {"times": self.times.tolist(), "quaternions": self.quaternions.tolist()}
        return {"orbit": self.orbit.to_dict(), **table}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""
        return cls(Orbit.from_dict(state["orbit"]), np.array(state["times"]), np.array(state["quaternions"]))


class Path(Protocol):
    """Flight path as reported; x right, y forward, z up in the scanner's axes."""

    kind: ClassVar[str]

    def pose(self, times: FloatArray) -> Pose:
        """Pose at times (N,), seconds from the middle of the scene; NaN where nothing is known."""

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""


@dataclass(frozen=True, eq=False)
class AnglePath:
    """Orbit with attitude angles about the orbital axes (SPOT 1 to 5).

    z is the direction from the Earth's centre, x = velocity × z, y = z × x; velocity is that in the turning Earth's
    frame, as the ephemeris gives it. The angles are interpolated linearly and stay as they are beyond their ends.

    Attributes
    ----------
    orbit : Orbit
    times : array (K,)
        Of the angles, seconds from the middle of the scene.
    angles : array (K, 3)
        Pitch, roll, yaw in radians, see `pose.turned`.
    """

    kind: ClassVar[str] = "angles"
    orbit: Orbit
    times: FloatArray
    angles: FloatArray

    def pose(self, times: FloatArray) -> Pose:
        """Pose at times (N,)."""
        position, velocity = self.orbit.at(times)
        # Not the ellipsoid's normal: SPOT's orbital axes refer to the Earth's centre.
        z = unit(position)
        x = unit(cross(velocity, z))
        axes = np.stack([x, cross(z, x), z], axis=1)
        pitch, roll, yaw = (np.interp(times, self.times, column) for column in self.angles.T)
        return Pose(position, turned(axes, pitch, roll, yaw))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {"orbit": self.orbit.to_dict(), "times": self.times.tolist(), "angles": self.angles.tolist()}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""
        return cls(Orbit.from_dict(state["orbit"]), np.array(state["times"]), np.array(state["angles"]))


@dataclass(frozen=True, eq=False)
class QuaternionPath:
    """Orbit with a polynomial for each component of the quaternion from satellite to geocentric axes (Pléiades).

    Of the satellite's axes the first points forward, the second right and the third to the ground.

    Attributes
    ----------
    orbit : Orbit
    offset, scale : float
        Seconds: the polynomials run over (t − offset) / scale.
    quaternion : array (K, 4)
        Coefficients, lowest power first; scalar component first.
    """

    kind: ClassVar[str] = "quaternions"
    orbit: Orbit
    offset: float
    scale: float
    quaternion: FloatArray

    def pose(self, times: FloatArray) -> Pose:
        """Pose at times (N,)."""
        position, _ = self.orbit.at(times)
        return satellite_pose(position, horner(self.quaternion, (times[:, None] - self.offset) / self.scale))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        numbers = {"offset": self.offset, "scale": self.scale, "quaternion": self.quaternion.tolist()}
        return {"orbit": self.orbit.to_dict(), **numbers}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""
        return cls(Orbit.from_dict(state["orbit"]), state["offset"], state["scale"], np.array(state["quaternion"]))


@dataclass(frozen=True, eq=False)
class TrackPath:
    """Poses of a table from GNSS and inertial measurement, on smooth curves.

    Positions and components of quaternions run on cubic Hermite curves whose slope at a node is that of the parabola
    through it and its neighbours; quaternions are then brought to length one. Before the first and after the last pose
    the flight goes on at its mean speed.

    Attributes
    ----------
    times : array (K,)
        Seconds from the middle of the scene.
    positions : array (K, 3)
        Geocentric metres.
    quaternions : array (K, 4)
        From the scanner's to geocentric axes, scalar first, neighbours of the same sign.
    """

    kind: ClassVar[str] = "track"
    times: FloatArray
    positions: FloatArray
    quaternions: FloatArray

    @cached_property
    def _curve(self) -> tuple[FloatArray, FloatArray]:
        """Values at the nodes relative to the first (K, 7), and their slopes."""
        # Relative to the first position: geocentric coordinates of 6e6 m would cost the curve digits.
        values = np.column_stack([self.positions - self.positions[0], self.quaternions])
        edge: Literal[1, 2] = 2 if len(self.times) > 2 else 1
        return values, np.gradient(values, self.times, axis=0, edge_order=edge)

    def pose(self, times: FloatArray) -> Pose:
        """Pose at times (N,)."""
        t = self.times
        # A cubic runs away beyond its nodes; there the flight goes on straight, at its mean speed.
        inside = np.clip(times, t[0], t[-1])
        k = np.clip(np.searchsorted(t, inside, side="right") - 1, 0, len(t) - 2)
        width = (t[k + 1] - t[k])[:, None]
        u = (inside - t[k])[:, None] / width
        values, slopes = self._curve
        first, last, start, end = values[k], values[k + 1], slopes[k] * width, slopes[k + 1] * width
        rise = last - first
        found = first + u * (start + u * ((3.0 * rise - 2.0 * start - end) + u * (start + end - 2.0 * rise)))
        speed = (self.positions[-1] - self.positions[0]) / (t[-1] - t[0])
        position = self.positions[0] + found[:, :3] + (times - inside)[:, None] * speed
        return Pose(position, np.ascontiguousarray(matrices_of_quaternions(found[:, 3:]).transpose(0, 2, 1)))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        names = ("times", "positions", "quaternions")
        return {name: getattr(self, name).tolist() for name in names}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""
        return cls(np.array(state["times"]), np.array(state["positions"]), np.array(state["quaternions"]))


PATHS: dict[str, type[AnglePath] | type[QuaternionPath] | type[QuaternionTable] | type[TrackPath]] = {
    path.kind: path for path in (AnglePath, QuaternionPath, QuaternionTable, TrackPath)
}
