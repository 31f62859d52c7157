"""Where the scanner is and how it hangs, in east, north, up about the nominal position at the middle of the image.

Time τ counts lines (scanner) or sweeps (sweeps, panoramic camera) from the middle of the image. Attitude is heading,
pitch and roll of aviation: the body's axes are forward, right and down; heading counts clockwise from north, pitch is
positive nose up, roll positive right wing down. Body → north, east, down is Rz(heading)·Ry(pitch)·Rx(roll).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from geomosaic.types import FloatArray

Three = tuple[FloatArray, FloatArray, FloatArray]


class Flight(Protocol):
    """What a scan asks of a flight."""

    @property
    def pace(self) -> float:
        """Metres per unit of τ."""

    def places(self, tau: FloatArray) -> FloatArray:
        """Projection centres (N, 3) at times (N,)."""

    def to_body(self, enu: FloatArray, tau: FloatArray) -> Three:
        """Ground (N, 3) as seen at times (N,): forward, right, down, in metres."""

    def to_enu(self, body: FloatArray, tau: FloatArray) -> FloatArray:
        """Directions (N, 3) forward, right, down at times (N,) as east, north, up."""


@dataclass(frozen=True)
class Turn:
    """Heading, pitch and roll that change evenly.

    Attributes
    ----------
    attitude : array (3,)
        Heading, pitch, roll in radians at τ = 0.
    rates : array (3,)
        Radians per unit of τ.
    """

    attitude: FloatArray
    rates: FloatArray

    def apply(self, north: FloatArray, east: FloatArray, down: FloatArray, tau: FloatArray) -> Three:
        """Components along the axes before the turn (N,) to those after it: forward, right, down."""
        ch, sh, cp, sp, cr, sr = self._turns(tau)
        ahead, aside = north * ch + east * sh, -north * sh + east * ch
        forward, below = cp * ahead - sp * down, sp * ahead + cp * down
        return forward, cr * aside + sr * below, -sr * aside + cr * below

    def undo(self, forward: FloatArray, right: FloatArray, down: FloatArray, tau: FloatArray) -> Three:
        """The inverse of `apply`: north, east, down."""
        ch, sh, cp, sp, cr, sr = self._turns(tau)
        aside, below = cr * right - sr * down, sr * right + cr * down
        ahead, lower = cp * forward + sp * below, -sp * forward + cp * below
        return ch * ahead - sh * aside, sh * ahead + ch * aside, lower

    def _turns(self, tau: FloatArray) -> tuple[FloatArray, ...]:
        heading, pitch, roll = (self.attitude[i] + self.rates[i] * tau for i in range(3))
        return np.cos(heading), np.sin(heading), np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)


@dataclass(frozen=True)
class Track:
    """A straight flight with slowly turning attitude.

    Attributes
    ----------
    position : array (3,)
        East, north, up in metres at τ = 0.
    velocity : array (3,)
        Metres per unit of τ.
    turn : Turn
    """

    position: FloatArray
    velocity: FloatArray
    turn: Turn

    @property
    def pace(self) -> float:
        """Metres per unit of τ."""
        return float(np.linalg.norm(self.velocity))

    def places(self, tau: FloatArray) -> FloatArray:
        """Projection centres (N, 3) at times (N,)."""
        return self.position + tau[:, None] * self.velocity

    def to_body(self, enu: FloatArray, tau: FloatArray) -> Three:
        """Ground (N, 3) as seen at times (N,): forward, right, down, in metres."""
        offset = enu - self.places(tau)
        return self.turn.apply(offset[:, 1], offset[:, 0], -offset[:, 2], tau)

    def to_enu(self, body: FloatArray, tau: FloatArray) -> FloatArray:
        """Directions (N, 3) forward, right, down at times (N,) as east, north, up."""
        north, east, down = self.turn.undo(body[:, 0], body[:, 1], body[:, 2], tau)
        return np.column_stack([east, north, -down])
