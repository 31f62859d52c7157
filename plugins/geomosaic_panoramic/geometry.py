"""Scan geometry: time and direction on the image, and sweeps of several lines at once.

scanner      a line is one moment, col = w/2 + θ/β, row = h/2 + τ, where θ is the scan angle to the right of nadir and β
             the instantaneous field of view. A ground point is on the line at the moment when it lies in the plane of
             scan, forward = 0.
sweeps       n lines are swept at once by n detectors, see `sweeps`.
panoramic    one sweep of a lens over cylindrical film, col = w/2 + θ/β, row = h/2 − f·tan ψ + m·sin θ, where ψ is the
             angle ahead of the plane of scan, f the focal length and m the image motion compensation, both in pixels.
             The moment is τ = θ/(β·w), from −1/2 to 1/2: the camera moves on while it sweeps.

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

from dataclasses import dataclass, field

import numpy as np

from geomosaic.types import FloatArray
from geomosaic_panoramic.trajectory import Flight

SWEEP_ROUNDS = 12
# β in radians, f and m in lines.
Inside = tuple[float, float, float]


@dataclass(frozen=True)
class Sweeps:
    """Sweeps of several lines: their number of lines, directions and active share.

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

    def moments(
        self, size: tuple[int, int], focal: float, motion: float, colrow: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Image (N, 2) to τ (N,) and tan ψ (N,); a row on the border of two sweeps belongs to the later one.

        Parameters
        ----------
        size : tuple of int
            Width and height in pixels.
        focal : float
            Pixels.
        motion : float
        colrow : array (N, 2)
            Pixels.
        """
        width, height = size
        # The row of the border itself belongs to the later sweep, so that every row has exactly one moment.
        sweep = np.floor(colrow[:, 1] / self.lines)
        share = self._direction(sweep) * (colrow[:, 0] - width / 2) / width
        within = colrow[:, 1] - self.lines * (sweep + 0.5)
        return self._middle(sweep, height) + self.active * share, (within - motion * share) / focal

    def project(
        self, flight: Flight, size: tuple[int, int], side: int, inside: Inside, enu: FloatArray, near: FloatArray
    ) -> FloatArray:
        """Image of ground points, each in the sweep in whose middle it lies most nearly.

        Parameters
        ----------
        flight : Flight
        size : tuple of int
            Width and height in pixels.
        side : int
            1 where columns run to the right of the flight, −1 to the left.
        inside : tuple of float
            β in radians, f and m in lines.
        enu : array (N, 3)
            East, north, up in metres.
        near : array (N,)
            τ at which each point lies in the plane of scan.

        Returns
        -------
        array (N, 2)
            col, row in pixels; NaN for points not seen.
        """
        guess = np.floor(near + size[1] / self.lines / 2)
        best, within = self._in_sweep(flight, size, side, inside, enu, guess)
        for _ in range(2):  # the guess may be a sweep off, as the scanner moves while it sweeps
            # From half a sweep on a neighbour is nearer; 0.3 leaves room for the bow tie and the motion within a sweep.
            doubt = np.flatnonzero(np.abs(within) > 0.3 * self.lines)
            if not len(doubt):
                break
            other = guess[doubt] + np.sign(within[doubt])
            found, away = self._in_sweep(flight, size, side, inside, enu[doubt], other)
            # Both sweeps of the bow tie see the point; the one in whose middle it lies more nearly is kept.
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
        for _ in range(SWEEP_ROUNDS):  # the scan angle hardly changes within a sweep, so this converges at once
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


KINDS = ("scanner", "sweeps", "panoramic")
ROUNDS = 50
# Lines or sweeps by which a moment may miss before the last step of its search, which leaves far less; of sweeps.
SMALL, ROUGH = 1e-9, 1e-2
# Lines or sweeps of one step of the search: what runs away keeps to numbers.
FARTHEST = 1e7


@dataclass(frozen=True)
class Scan:
    """Scan geometry of an image.

    Attributes
    ----------
    kind : str
        'scanner', 'sweeps' or 'panoramic'.
    size : tuple of int
        Width and height in pixels.
    side : int
        1 where columns run to the right of the flight, −1 to the left.
    sweeps : Sweeps
        Of kind 'sweeps'; means nothing for the others.
    centre : tuple of float, optional
        Principal point in pixels, of kind 'panoramic'; the middle of the image unless given.
    """

    kind: str
    size: tuple[int, int]
    side: int
    sweeps: Sweeps = field(default_factory=Sweeps)
    centre: tuple[float, float] | None = None

    @property
    def _centre(self) -> tuple[float, float]:
        return self.centre or (self.size[0] / 2, self.size[1] / 2)

    @property
    def periods(self) -> float:
        """Units of τ from the image's begin to its end."""
        return {"scanner": self.size[1], "sweeps": self.size[1] / self.sweeps.lines, "panoramic": 1.0}[self.kind]

    def project(self, track: Flight, beta: float, focal: float, motion: float, enu: FloatArray) -> FloatArray:
        """Image of ground points.

        Parameters
        ----------
        track : Flight
        beta : float
            Instantaneous field of view, radians.
        focal, motion : float
            Focal length and image motion compensation in pixels (lines of sweeps); no scanner has them.
        enu : array (N, 3)
            East, north, up in metres.

        Returns
        -------
        array (N, 2)
            col, row in pixels; NaN for what lies above or never comes into the plane of scan.
        """
        col, middle = self._centre
        tau = self._moments(track, beta, enu)
        if self.kind == "sweeps":
            return self.sweeps.project(track, self.size, self.side, (beta, focal, motion), enu, tau)
        forward, right, down = track.to_body(enu, tau)
        angle = np.arctan2(self.side * right, down)
        if self.kind == "scanner":
            row = middle + tau
        else:
            with np.errstate(divide="ignore", invalid="ignore"):
                row = middle - focal * forward / np.hypot(right, down) + motion * np.sin(angle)
        out = np.column_stack([col + angle / beta, row])
        out[~(np.isfinite(out).all(axis=1) & (down > 0.0))] = np.nan
        return out

    def derivatives(
        self, track: Flight, beta: float, focal: float, motion: float, enu: FloatArray, colrow: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Derivatives of the image of ground points.

        Parameters
        ----------
        track, beta, focal, motion, enu
            As for `project`.
        colrow : array (N, 2)
            Their image.

        Returns
        -------
        by_values : array (N, 2, 15)
            By place, speed (metres), attitude, rates (radians), β (radians), focal length and motion (pixels).
        by_ground : array (N, 2, 3)
            By east, north, up.
        """
        # The moment τ of a point is defined by an equation in τ and all others, and follows from it implicitly.
        tau = self.directions(beta, focal, motion, colrow)[0]
        body, by_place, by_angle, by_tau = track.sight(enu, tau)
        later = tau[:, None, None]
        outside = np.concatenate([-by_place, -by_place * later, by_angle, by_angle * later, by_place], axis=2)
        ahead, right, down = body.T
        depth = np.hypot(right, down)
        angle = np.arctan2(self.side * right, down)

        def turning(by: FloatArray) -> FloatArray:
            """Of the scan angle, from derivatives of forward, right and down in the second axis."""
            turned: FloatArray = self.side * (by[:, 1].T * down - by[:, 2].T * right) / depth**2
            return turned.T

        def leading(by: FloatArray) -> FloatArray:
            """Of forward over the depth."""
            slope: FloatArray = (by[:, 0].T - ahead / depth**2 * (right * by[:, 1].T + down * by[:, 2].T)) / depth
            return slope.T

        angle_by, lead_by = (of(outside) for of in (turning, leading))
        angle_tau, lead_tau = (of(by_tau[:, :, None])[:, 0] for of in (turning, leading))
        count = outside.shape[2]
        inner = np.zeros((len(enu), 3))  # by β, focal length and motion
        if self.kind == "scanner":
            moment = np.hstack([-outside[:, 0] / by_tau[:, :1], inner])
            row = moment
        else:
            width = self.size[0]
            share, sign = np.full(len(enu), 1.0 / width), -1.0
            if self.kind == "sweeps":
                # A point in the gap between two sweeps may lie in the rows of the other one; that one is taken.
                sweep = np.floor(colrow[:, 1] / self.sweeps.lines)
                share, sign = self.sweeps.active * self.sweeps._direction(sweep) / width, 1.0
            inner[:, 0] = -angle / beta
            moment = np.hstack([angle_by, inner]) * (share / beta / (1.0 - share * angle_tau / beta))[:, None]
            row = sign * focal * (np.hstack([lead_by, 0.0 * inner]) + lead_tau[:, None] * moment)
            row[:, count + 1] += sign * ahead / depth
        turned = np.hstack([angle_by, 0.0 * inner]) + angle_tau[:, None] * moment
        col = turned / beta
        col[:, count] -= angle / beta**2
        if self.kind == "panoramic":
            row = row + motion * np.cos(angle)[:, None] * turned
            row[:, count + 2] += np.sin(angle)
        elif self.kind == "sweeps":
            across = share / self.sweeps.active
            row = row + motion * across[:, None] * col
            row[:, count + 2] += across * angle / beta
        total = np.stack([col, row], axis=1)
        return np.delete(total, slice(12, 15), axis=2), total[:, :, 12:15]

    def directions(self, beta: float, focal: float, motion: float, colrow: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Times and directions of view of image points.

        Parameters
        ----------
        beta : float
            Instantaneous field of view, radians.
        focal, motion : float
            Focal length and image motion compensation in pixels (lines of sweeps); no scanner has them.
        colrow : array (N, 2)
            Pixels.

        Returns
        -------
        tau : array (N,)
            Lines or sweeps from the middle of the image.
        directions : array (N, 3)
            Unit vectors forward, right, down.
        """
        col, row = self._centre
        angle = (colrow[:, 0] - col) * beta
        if self.kind == "scanner":
            tau, ahead = colrow[:, 1] - row, np.zeros(len(colrow))
        elif self.kind == "sweeps":
            tau, ahead = self.sweeps.moments(self.size, focal, motion, colrow)
        else:
            tau = (colrow[:, 0] - self.size[0] / 2) / self.size[0]
            ahead = (row - colrow[:, 1] + motion * np.sin(angle)) / focal
        body = np.column_stack([ahead, self.side * np.sin(angle), np.cos(angle)])
        return tau, body / np.linalg.norm(body, axis=1)[:, None]

    def _moments(self, track: Flight, beta: float, enu: FloatArray) -> FloatArray:
        """Times τ (N,) at which points are seen, by the secant method on `_lead`; of sweeps only roughly."""
        # `_lead` is nearly linear in τ. For sweeps the time only selects the sweep, whose own search is exact.
        enough = ROUGH if self.kind == "sweeps" else SMALL
        found, rest = np.full(len(enu), np.nan), np.arange(len(enu))
        before, after = track.around(enu, self.periods / 2)
        miss = self._lead(track, beta, enu, before)
        for _ in range(ROUNDS):
            now = self._lead(track, beta, enu[rest], after)
            slope = np.where(now == miss, np.inf, now - miss)  # no slope: no step, and no moment
            step = np.clip(-now * (after - before) / slope, -FARTHEST, FARTHEST)
            done = np.abs(now) <= enough * (1.0 + np.abs(after))
            found[rest[done]] = (after + step)[done]
            on = ~done & (np.abs(step) > 0.0)
            if not on.any():
                break
            rest, before, miss, after = rest[on], after[on], now[on], (after + step)[on]
        return found

    def _lead(self, track: Flight, beta: float, enu: FloatArray, tau: FloatArray) -> FloatArray:
        """Misfit (N,) of a time from the moment at which a point is seen: 0 there, about in units of τ."""
        forward, right, down = track.to_body(enu, tau)
        if self.kind != "panoramic":
            return forward / max(track.pace, 1e-12)
        aside = self._centre[0] / self.size[0] - 0.5
        return tau - np.arctan2(self.side * right, down) / (beta * self.size[0]) - aside
