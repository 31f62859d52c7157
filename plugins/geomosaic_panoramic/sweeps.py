"""Sweeps of several lines at once, as Landsat's scanners make them: n detectors in a row along the flight.

Sweep k, from 0, has its middle at τ_k = k + 1/2 − S/2, S being the number of sweeps. Column c is seen at the moment

    τ = τ_k + d · a · (c − w/2) / w

where a is the share of a period in which the mirror looks at the ground and d its direction, 1, or −1 on every other
sweep where both directions count. Its scan angle is θ = (c − w/2)·β, and the line within the sweep

    row − n·(k + 1/2) = f · tan ψ + m · d · (c − w/2) / w

with ψ the angle ahead of the plane of scan, f = 1/γ the lines per radian and m the lines by which a corrector turns the
view back during the sweep; with m = f·a·V/H per sweep the lines of a level flight run straight across. Rows
grow with the flight.

At θ the n lines cover n·γ·H·sec θ of flat ground, more than below the scanner: the bow tie. A place that two sweeps see
is given to the one in whose middle it lies more nearly, and so is a place between two sweeps. There the row jumps by
the overlap or gap, and nothing but that is discontinuous.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from geomosaic.types import FloatArray
from geomosaic_panoramic.track import Flight

ROUNDS = 12
Inside = tuple[float, float, float]
"""β in radians, f and m in lines."""


@dataclass(frozen=True)
class Sweeps:
    """What is special of this kind.

    Attributes
    ----------
    lines : int
        Lines of one sweep, n.
    both : bool
        Whether every other sweep runs backwards.
    active : float
        Share of the period in which the ground is seen, a.
    """

    lines: int = 16
    both: bool = False
    active: float = 1.0

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values; the arguments again."""
        return asdict(self)

    def moments(
        self, size: tuple[int, int], focal: float, motion: float, colrow: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Image (N, 2) to τ (N,) and tan ψ (N,); a row on the border of two sweeps belongs to the later one."""
        width, height = size
        sweep = np.floor(colrow[:, 1] / self.lines)
        share = self._direction(sweep) * (colrow[:, 0] - width / 2) / width
        within = colrow[:, 1] - self.lines * (sweep + 0.5)
        return self._middle(sweep, height) + self.active * share, (within - motion * share) / focal

    def project(
        self, flight: Flight, size: tuple[int, int], side: int, inside: Inside, enu: FloatArray, near: FloatArray
    ) -> FloatArray:
        """Ground (N, 3) to image (N, 2); `near` (N,) is when each point lies in the plane of scan."""
        guess = np.floor(near + size[1] / self.lines / 2)
        best, within = self._in_sweep(flight, size, side, inside, enu, guess)
        for _ in range(2):  # the guess may be a sweep off, as the scanner moves while it sweeps
            doubt = np.flatnonzero(np.abs(within) > 0.3 * self.lines)
            if not len(doubt):
                break
            other = guess[doubt] + np.sign(within[doubt])
            found, away = self._in_sweep(flight, size, side, inside, enu[doubt], other)
            closer = np.abs(away) < np.abs(within[doubt])
            best[doubt[closer]], within[doubt[closer]] = found[closer], away[closer]
            guess[doubt[closer]] = other[closer]
        return best

    def _in_sweep(
        self, flight: Flight, size: tuple[int, int], side: int, inside: Inside, enu: FloatArray, sweep: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Image (N, 2) as a sweep (N,) sees it, NaN where it does not, and lines from its middle (N,)."""
        (width, height), (beta, focal, motion) = size, inside
        direction, middle = self._direction(sweep), self._middle(sweep, height)
        share = np.zeros(len(enu))
        for _ in range(ROUNDS):  # the scan angle hardly changes within a sweep, so this converges at once
            forward, right, down = flight.to_body(enu, middle + self.active * share)
            before, share = share, direction * np.arctan2(side * right, down) / (beta * width)
            if not (np.abs(share - before) > 1e-12).any():
                break
        with np.errstate(divide="ignore", invalid="ignore"):
            within = focal * forward / np.hypot(right, down) + motion * share
        found = np.column_stack([width / 2 + direction * share * width, self.lines * (sweep + 0.5) + within])
        found[~(np.isfinite(found).all(axis=1) & (down > 0.0))] = np.nan
        return found, within

    def _direction(self, sweep: FloatArray) -> FloatArray:
        return np.where(sweep % 2 == 1, -1.0, 1.0) if self.both else np.ones(len(sweep))

    def _middle(self, sweep: FloatArray, height: int) -> FloatArray:
        return sweep + 0.5 - height / self.lines / 2
