"""Three ways to know the flight of a scanner: orbit and attitude angles, orbit and quaternions, a table of poses."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol, Self

import numpy as np

from geomosaic.types import FloatArray
from geomosaic_pushbroom.orbit import Orbit, horner
from geomosaic_pushbroom.pose import Pose, cross, of_quaternions, turned, unit


class Path(Protocol):
    """The flight as it was reported; x right, y forward, z up in the scanner's axes."""

    kind: ClassVar[str]

    def pose(self, times: FloatArray) -> Pose:
        """Pose at times (N,), seconds from the middle of the scene; NaN where nothing is known."""

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Rebuild from `to_dict`."""


@dataclass(frozen=True, eq=False)
class AnglePath:
    """Orbit, with attitude angles about the orbital axes (SPOT 1 to 5).

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
        """Rebuild from `to_dict`."""
        return cls(Orbit.from_dict(state["orbit"]), np.array(state["times"]), np.array(state["angles"]))


@dataclass(frozen=True, eq=False)
class QuaternionPath:
    """Orbit, with a polynomial for each component of the quaternion from satellite to geocentric axes (Pléiades).

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
        turns = of_quaternions(horner(self.quaternion, (times[:, None] - self.offset) / self.scale))
        return Pose(position, np.stack([turns[:, :, 1], turns[:, :, 0], -turns[:, :, 2]], axis=1))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        numbers = {"offset": self.offset, "scale": self.scale, "quaternion": self.quaternion.tolist()}
        return {"orbit": self.orbit.to_dict(), **numbers}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Rebuild from `to_dict`."""
        return cls(Orbit.from_dict(state["orbit"]), state["offset"], state["scale"], np.array(state["quaternion"]))


@dataclass(frozen=True, eq=False)
class TrackPath:
    """Poses of a table, as GNSS and inertial measurement give them, interpolated linearly.

    Components of quaternions are interpolated and brought to length one; over steps of a tenth of a degree that is the
    shortest turn to 1e-10 rad. Before the first and after the last pose the flight goes on at its mean speed.

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

    def pose(self, times: FloatArray) -> Pose:
        """Pose at times (N,)."""
        inside = np.clip(times, self.times[0], self.times[-1])
        position = np.stack([np.interp(inside, self.times, column) for column in self.positions.T], axis=1)
        speed = (self.positions[-1] - self.positions[0]) / (self.times[-1] - self.times[0])
        position = position + (times - inside)[:, None] * speed
        turn = np.stack([np.interp(inside, self.times, column) for column in self.quaternions.T], axis=1)
        return Pose(position, np.ascontiguousarray(of_quaternions(turn).transpose(0, 2, 1)))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        names = ("times", "positions", "quaternions")
        return {name: getattr(self, name).tolist() for name in names}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Rebuild from `to_dict`."""
        return cls(np.array(state["times"]), np.array(state["positions"]), np.array(state["quaternions"]))


PATHS: dict[str, type[AnglePath] | type[QuaternionPath] | type[TrackPath]] = {
    path.kind: path for path in (AnglePath, QuaternionPath, TrackPath)
}
