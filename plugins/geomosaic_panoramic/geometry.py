"""How a scan puts time and direction on the image: three kinds, each with its map both ways.

scanner      a line is one moment, col = w/2 + θ/β, row = h/2 + τ, where θ is the scan angle to the right of nadir and β
             the instantaneous field of view. A ground point is on the line at the moment when it lies in the plane of
             scan, forward = 0.
sweeps       n lines are swept at once by n detectors, see `sweeps`.
panoramic    one sweep of a lens over cylindrical film, col = w/2 + θ/β, row = h/2 − f·tan ψ + m·sin θ, where ψ is the
             angle ahead of the plane of scan, f the focal length and m the image motion compensation, both in pixels.
             The moment is τ = θ/(β·w), from −1/2 to 1/2: the camera moves on while it sweeps.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from geomosaic.types import FloatArray
from geomosaic_panoramic.sweeps import Sweeps
from geomosaic_panoramic.track import Flight

KINDS = ("scanner", "sweeps", "panoramic")
ROUNDS = 50
SMALL = 1e-12
FARTHEST = 1e7
"""Lines or sweeps of one step of the search: what runs away keeps to numbers."""


@dataclass(frozen=True)
class Scan:
    """A kind of scan.

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
    """

    kind: str
    size: tuple[int, int]
    side: int
    sweeps: Sweeps = field(default_factory=Sweeps)

    @property
    def periods(self) -> float:
        """Units of τ from the image's begin to its end."""
        return {"scanner": self.size[1], "sweeps": self.size[1] / self.sweeps.lines, "panoramic": 1.0}[self.kind]

    def project(self, track: Flight, beta: float, focal: float, motion: float, enu: FloatArray) -> FloatArray:
        """Ground (N, 3) to image (N, 2); NaN for what lies above or never comes into the plane of scan."""
        width, height = self.size
        tau = self._moments(track, beta, enu)
        if self.kind == "sweeps":
            return self.sweeps.project(track, self.size, self.side, (beta, focal, motion), enu, tau)
        forward, right, down = track.to_body(enu, tau)
        angle = np.arctan2(self.side * right, down)
        if self.kind == "scanner":
            row = height / 2 + tau
        else:
            with np.errstate(divide="ignore", invalid="ignore"):
                row = height / 2 - focal * forward / np.hypot(right, down) + motion * np.sin(angle)
        out = np.column_stack([width / 2 + angle / beta, row])
        out[~(np.isfinite(out).all(axis=1) & (down > 0.0))] = np.nan
        return out

    def directions(self, beta: float, focal: float, motion: float, colrow: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Image (N, 2) to times (N,) and directions (N, 3) forward, right, down."""
        width, height = self.size
        angle = (colrow[:, 0] - width / 2) * beta
        if self.kind == "scanner":
            tau, ahead = colrow[:, 1] - height / 2, np.zeros(len(colrow))
        elif self.kind == "sweeps":
            tau, ahead = self.sweeps.moments(self.size, focal, motion, colrow)
        else:
            tau = (colrow[:, 0] - width / 2) / width
            ahead = (height / 2 - colrow[:, 1] + motion * np.sin(angle)) / focal
        body = np.column_stack([ahead, self.side * np.sin(angle), np.cos(angle)])
        return tau, body / np.linalg.norm(body, axis=1)[:, None]

    def _moments(self, track: Flight, beta: float, enu: FloatArray) -> FloatArray:
        """When each point is seen: a secant on `_lead`, which is nearly a line in τ; of sweeps only roughly."""
        small, enough = (1e-3, 1e-2) if self.kind == "sweeps" else (SMALL, 1e-9)
        before, after = np.full(len(enu), -0.5), np.full(len(enu), 0.5)
        miss = self._lead(track, beta, enu, before)
        for _ in range(ROUNDS):
            now = self._lead(track, beta, enu, after)
            slope = np.where(now == miss, np.inf, now - miss)  # settled: the step is 0
            step = np.clip(-now * (after - before) / slope, -FARTHEST, FARTHEST)
            before, miss, after = after, now, after + step
            if not (np.abs(step) > small * (1.0 + np.abs(after))).any():
                break
        settled = np.abs(self._lead(track, beta, enu, after)) <= enough * (1.0 + np.abs(after))
        return np.where(settled, after, np.nan)

    def _lead(self, track: Flight, beta: float, enu: FloatArray, tau: FloatArray) -> FloatArray:
        """How far τ is from the moment of a point: 0 there, about in units of τ."""
        forward, right, down = track.to_body(enu, tau)
        if self.kind != "panoramic":
            return forward / max(track.pace, 1e-12)
        return tau - np.arctan2(self.side * right, down) / (beta * self.size[0])
