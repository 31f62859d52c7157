"""The pushbroom scanner as a sensor model: each row has a pose of its own.

A ground point G is seen in the row whose pose has it in the plane of its line. With d the components of G − P(row)
along the scanner's axes, look slopes across a = dx / −dz and along b = dy / −dz, col(a) the detector that looks at a,
and B(col) the along slope of that detector, the row is the root of

    b(row) − B(col(a(row))) = 0

found by Newton's rule with slopes by secants, for each point by itself (equation (4) of Müller and Sauleda, 1988, where
B = 0; SPOT Geometry Handbook, CNES, 2002). Rays are the same without iteration.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from pyproj import CRS

from geomosaic.sensor.parameters import Parameters
from geomosaic.types import FloatArray, IntArray
from geomosaic_pushbroom.look import Look
from geomosaic_pushbroom.platform import Bend, Flight, Platform
from geomosaic_pushbroom.pose import combined, components, unit
from geomosaic_pushbroom.straight import Straight

PLATFORMS: dict[str, type[Flight] | type[Straight]] = {"flight": Flight, "straight": Straight}
_ROUNDS = 40
_GOAL = 1e-8  # pixels of the last step; the error that is left is far smaller, secants being steeper than linear
_FURTHEST = 20.0  # image heights beyond the image


@dataclass(frozen=True, eq=False)
class PushbroomModel:
    """One scene or strip of a line scanner.

    Attributes
    ----------
    platform : Flight or Straight
        Poses over rows.
    look : Look
        Directions over columns.
    crs : CRS
        Geocentric.
    size : tuple of int
        Width and height in pixels.
    parameters : Parameters
        Those of the platform.
    seed : tuple of float
        Ground point near the middle of the image.
    guess : array (4,)
        Rough row of a ground point: guess[0] + guess[1:]·(xyz − seed).
    notes : tuple of str
        What was assumed when the model was made.
    """

    platform: Platform
    look: Look
    crs: CRS
    size: tuple[int, int]
    parameters: Parameters
    seed: tuple[float, float, float]
    guess: FloatArray
    notes: tuple[str, ...] = ()

    @cached_property
    def _bend(self) -> Bend:
        return self.platform.bend(self.parameters.values)

    def _slopes(self, xyz: FloatArray, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Column (N,) and misfit along (N,) of points (N, 3) as seen from the poses of rows (N,)."""
        position, axes = self.platform.pose(self.parameters.values, rows)
        d = components(axes, xyz - position)
        down = np.where(d[:, 2] < 0.0, -d[:, 2], np.nan)
        cols = self.look.columns(d[:, 0] / down, self._bend.stretch)
        return cols, d[:, 1] / down - self.look.slopes(cols, *self._bend)[1]

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        """Ground (N, 3) in geocentric metres to image (N, 2) in pixels.

        NaN where the scanner is below the point's horizon or never passes it, and far outside the image.
        """
        points = np.asarray(xyz, dtype=np.float64)
        off = points - np.array(self.seed)
        rows = self.guess[0] + (off[:, 0] * self.guess[1] + off[:, 1] * self.guess[2] + off[:, 2] * self.guess[3])
        limit = _FURTHEST * self.size[1]
        rows = np.clip(rows, -limit, self.size[1] + limit)
        image = np.full((len(points), 2), np.nan)
        cols, misfit = self._slopes(points, rows)
        there = np.flatnonzero(np.isfinite(misfit))
        before, row = rows[there] + 1.0, rows[there]
        miss_before, miss, col = self._slopes(points[there], before)[1], misfit[there], cols[there]
        for _ in range(_ROUNDS):
            with np.errstate(divide="ignore", invalid="ignore"):
                step = -miss * (row - before) / (miss - miss_before)
            step = np.where(miss == 0.0, 0.0, np.clip(step, -self.size[1], self.size[1]))
            before, miss_before, row = row, miss, row + step
            col, miss = self._slopes(points[there], row)
            done = np.abs(step) < _GOAL
            image[there[done], 0], image[there[done], 1] = col[done], row[done]
            on = ~done & np.isfinite(miss) & (np.abs(row) < 2.0 * limit)
            there, row, before, col, miss, miss_before = (v[on] for v in (there, row, before, col, miss, miss_before))
            if not len(there):
                break
        self._hide_beyond_horizon(points, image)
        return image

    def _hide_beyond_horizon(self, points: FloatArray, image: FloatArray) -> None:
        """A line of sight goes through the Earth and comes out again: what it meets there cannot be seen."""
        seen: IntArray = np.flatnonzero(np.isfinite(image[:, 1]))
        position = self.platform.pose(self.parameters.values, image[seen, 1]).position
        up = ((position - points[seen]) * points[seen]).sum(axis=1) > 0.0
        image[seen[~up]] = np.nan
        image[~np.isfinite(image).all(axis=1)] = np.nan

    def rays(self, colrow: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Image (N, 2) to origins (N, 3) and unit directions (N, 3) towards the ground, geocentric."""
        pixels = np.asarray(colrow, dtype=np.float64)
        across, along = self.look.slopes(pixels[:, 0], *self._bend)
        position, axes = self.platform.pose(self.parameters.values, pixels[:, 1])
        directions = combined(axes, np.stack([across, along, np.full(len(pixels), -1.0)], axis=1))
        return position, unit(directions)

    def with_values(self, values: FloatArray) -> Self:
        """Return the scene with other parameter values (P,)."""
        return replace(self, parameters=self.parameters.with_values(values))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values; a free parameter's sigma is null."""
        p = self.parameters
        return {
            "platform": self.platform.kind,
            "flight": self.platform.to_dict(),
            "look": self.look.to_dict(),
            "crs": self.crs.to_wkt(),
            "size": list(self.size),
            "values": p.values.tolist(),
            "sigmas": [None if np.isinf(s) else float(s) for s in p.sigmas],
            "steps": p.steps.tolist(),
            "seed": list(self.seed),
            "guess": self.guess.tolist(),
            "notes": list(self.notes),
        }

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Rebuild a model from `to_dict`."""
        platform = PLATFORMS[state["platform"]].from_dict(state["flight"])
        sigmas = np.array([np.inf if s is None else s for s in state["sigmas"]])
        values, steps = np.array(state["values"]), np.array(state["steps"])
        parameters = Parameters(platform.names, platform.units, values, sigmas, steps)
        x, y, z = state["seed"]
        width, height = state["size"]
        crs, guess = CRS.from_wkt(state["crs"]), np.array(state["guess"])
        look, notes = Look.from_dict(state["look"]), tuple(state["notes"])
        return cls(platform, look, crs, (width, height), parameters, (x, y, z), guess, notes)
