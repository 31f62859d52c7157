"""Orbit, and a table of attitude quaternions over time (SPOT 6 and 7, Pléiades Neo)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Self

import numpy as np

from geomosaic.types import FloatArray
from geomosaic_pushbroom.orbit import Orbit
from geomosaic_pushbroom.pose import Pose, satellite_pose


@dataclass(frozen=True, eq=False)
class QuaternionTable:
    """Orbit, with quaternions that are linear between the times of a table, and brought to length one.

    Beyond its ends the table goes on at the mean speed of its outer tenth, for as long as it is itself.

    Attributes
    ----------
    orbit : Orbit
    times : array (K,)
        Seconds from the middle of the scene.
    quaternions : array (K, 4)
        From satellite to geocentric axes, see `satellite_pose`; neighbours of the same side.
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
        """Rebuild from `to_dict`."""
        return cls(Orbit.from_dict(state["orbit"]), np.array(state["times"]), np.array(state["quaternions"]))
