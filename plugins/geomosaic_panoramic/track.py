"""A straight flight with slowly turning attitude, in east, north, up about its middle.

Time τ counts lines (scanner) or sweeps (panoramic camera) from the middle of the image. Attitude is heading, pitch and
roll of aviation: the body's axes are forward, right and down; heading counts clockwise from north, pitch is positive
nose up, roll positive right wing down. Body → north, east, down is Rz(heading)·Ry(pitch)·Rx(roll).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.types import FloatArray


@dataclass(frozen=True)
class Track:
    """Motion and attitude.

    Attributes
    ----------
    position : array (3,)
        East, north, up in metres at τ = 0.
    velocity : array (3,)
        Metres per unit of τ.
    attitude : array (3,)
        Heading, pitch, roll in radians at τ = 0.
    rates : array (3,)
        Radians per unit of τ.
    """

    position: FloatArray
    velocity: FloatArray
    attitude: FloatArray
    rates: FloatArray

    def places(self, tau: FloatArray) -> FloatArray:
        """Projection centres (N, 3) at times (N,)."""
        return self.position + tau[:, None] * self.velocity

    def to_body(self, enu: FloatArray, tau: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Ground (N, 3) as seen at times (N,): forward, right, down, in metres."""
        offset = enu - self.places(tau)
        ch, sh, cp, sp, cr, sr = self._turns(tau)
        east, north, down = offset[:, 0], offset[:, 1], -offset[:, 2]
        ahead, aside = north * ch + east * sh, -north * sh + east * ch
        forward, below = cp * ahead - sp * down, sp * ahead + cp * down
        return forward, cr * aside + sr * below, -sr * aside + cr * below

    def to_enu(self, body: FloatArray, tau: FloatArray) -> FloatArray:
        """Directions (N, 3) forward, right, down at times (N,) as east, north, up."""
        ch, sh, cp, sp, cr, sr = self._turns(tau)
        forward, right, down = body.T
        aside, below = cr * right - sr * down, sr * right + cr * down
        ahead, lower = cp * forward + sp * below, -sp * forward + cp * below
        return np.column_stack([sh * ahead + ch * aside, ch * ahead - sh * aside, -lower])

    def _turns(self, tau: FloatArray) -> tuple[FloatArray, ...]:
        heading, pitch, roll = (self.attitude[i] + self.rates[i] * tau for i in range(3))
        return np.cos(heading), np.sin(heading), np.cos(pitch), np.sin(pitch), np.cos(roll), np.sin(roll)
