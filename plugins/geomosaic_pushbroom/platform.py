"""Platform of a scanner: its pose at each image row as a function of the adjustable parameters."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol, Self

import numpy as np

from geomosaic.types import FloatArray
from geomosaic_pushbroom.paths import PATHS, Path
from geomosaic_pushbroom.pose import Pose, combined, turned


class Bend(NamedTuple):
    """Changes of the look directions over the line: multiples of its second Legendre polynomial, as slopes."""

    stretch: float = 0.0
    bend: float = 0.0


class Platform(Protocol):
    """Poses over image rows."""

    kind: ClassVar[str]
    names: ClassVar[tuple[str, ...]]
    units: ClassVar[tuple[str, ...]]

    def pose(self, values: FloatArray, rows: FloatArray) -> Pose:
        """Pose at image rows (N,) with parameter values (P,)."""

    def bend(self, values: FloatArray) -> Bend:
        """Changes of the look directions with these values."""

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Rebuild from `to_dict`."""


@dataclass(frozen=True, eq=False)
class Flight:
    """A reported flight with corrections that control points can find.

    With t the seconds from the middle of the scene, the pose of the path at t + `time` is moved by (across, along, up)
    along its own axes and then turned by `pose.turned` with pitch + pitch_rate·t and so on.

    Attributes
    ----------
    path : Path
    period : float
        Seconds from one row to the next.
    middle : float
        Row at t = 0.
    """

    kind: ClassVar[str] = "flight"
    names: ClassVar[tuple[str, ...]] = (
        "roll", "pitch", "yaw", "roll_rate", "pitch_rate", "yaw_rate", "across", "along", "up", "time",
    )  # fmt: skip
    units: ClassVar[tuple[str, ...]] = ("deg",) * 3 + ("deg/s",) * 3 + ("m",) * 3 + ("s",)
    path: Path
    period: float
    middle: float

    def pose(self, values: FloatArray, rows: FloatArray) -> Pose:
        """Pose at rows (N,)."""
        t = (rows - self.middle) * self.period
        position, axes = self.path.pose(t + values[9])
        shift = np.broadcast_to(values[6:9], position.shape)
        roll, pitch, yaw = (np.radians(values[i] + values[i + 3] * t) for i in range(3))
        return Pose(position + combined(axes, shift), turned(axes, pitch, roll, yaw))

    def bend(self, values: FloatArray) -> Bend:
        """The look directions are those of the calibration."""
        return Bend()

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {"path": self.path.kind, **self.path.to_dict(), "period": self.period, "middle": self.middle}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Rebuild from `to_dict`."""
        return cls(PATHS[state["path"]].from_dict(state), state["period"], state["middle"])
