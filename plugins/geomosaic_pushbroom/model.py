"""Pushbroom model of a scene: ground to image with its derivatives, and its start from platform and look directions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import geographic
from geomosaic.geo.transform import Transform
from geomosaic.sensor.plugin import ControlBlunder, Parameters
from geomosaic.types import FloatArray
from geomosaic_pushbroom.platform import LineDistortion, Platform, ReportedFlight, StraightFlight
from geomosaic_pushbroom.pose import LookDirections, combined, components, unit

PLATFORMS: dict[str, type[ReportedFlight] | type[StraightFlight]] = {
    "flight": ReportedFlight,
    "straight": StraightFlight,
}
_ROUNDS = 40
_GOAL = 1e-7  # pixels of the last step; the error that is left is far smaller, secants converging faster than linear
_FURTHEST = 20.0  # image heights beyond the image


@dataclass(frozen=True, eq=False)
class PushbroomModel:
    """Pushbroom model of one scene or strip of a line scanner.

    Attributes
    ----------
    platform : Platform
        Poses over rows.
    look : LookDirections
        Directions over columns.
    crs : CRS
        Geocentric.
    size : tuple of int
        Width and height in pixels.
    parameters : Parameters
        Those of the platform.
    seed : tuple of float
        Ground point near the middle of the image.
    guess : array (5,)
        Rough row of a ground point, guess[0] + guess[1:4]·(xyz − seed), and the change of the misfit per row.
    notes : tuple of str
        What was assumed when the model was made.
    left_out : tuple of ControlBlunder
        Control points that contradict the others; a record of the fit, and no part of the state.
    """

    platform: Platform
    look: LookDirections
    crs: CRS
    size: tuple[int, int]
    parameters: Parameters
    seed: tuple[float, float, float]
    guess: FloatArray
    notes: tuple[str, ...] = ()
    left_out: tuple[ControlBlunder, ...] = ()

    @cached_property
    def _bend(self) -> LineDistortion:
        return self.platform.bend(self.parameters.values)

    def seen_from(self, xyz: FloatArray, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Column and misfit of ground points seen from the poses of given rows.

        Parameters
        ----------
        xyz : array (N, 3)
            Geocentric ground, metres.
        rows : array (N,)
            One for each point.

        Returns
        -------
        cols : array (N,)
        misfit : array (N,)
            Along the flight, as a slope; NaN where the scanner is below the point's horizon or the point behind it.
        """
        position, axes = self.platform.pose(self.parameters.values, rows)
        line = xyz - position
        d = components(axes, line)
        # A line of sight goes through the Earth and comes out again: what it meets there cannot be seen.
        above = line[:, 0] * xyz[:, 0] + line[:, 1] * xyz[:, 1] + line[:, 2] * xyz[:, 2] < 0.0
        down = np.where((d[:, 2] < 0.0) & above, -d[:, 2], np.nan)
        cols = self.look.columns(d[:, 0] / down, self._bend.stretch)
        return cols, d[:, 1] / down - self.look.slopes(cols, *self._bend)[1]

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        """Ground (N, 3) in geocentric metres to image (N, 2) in pixels.

        NaN where the scanner is below the point's horizon or never passes it, and far outside the image.
        """
        points = np.asarray(xyz, dtype=np.float64)
        image = np.full((len(points), 2), np.nan)
        off = points - np.array(self.seed)
        rows = self.guess[0] + (off[:, 0] * self.guess[1] + off[:, 1] * self.guess[2] + off[:, 2] * self.guess[3])
        limit = _FURTHEST * self.size[1]
        # Far outside, path and attitude are extrapolated without sense: the search starts no further out.
        row = np.clip(rows, -limit, limit + self.size[1])
        _, miss = self.seen_from(points, row)
        there = np.flatnonzero(np.isfinite(miss))
        row, miss = row[there], miss[there]
        slope = np.full(len(there), self.guess[4])
        for _ in range(_ROUNDS):
            if not len(there):
                break
            # No step is longer than the image: a bad slope at the start must not throw the search out of the orbit.
            step = np.clip(-miss / slope, -self.size[1], self.size[1])
            col, next_miss = self.seen_from(points[there], row + step)
            with np.errstate(divide="ignore", invalid="ignore"):
                secant = (next_miss - miss) / step
            # A secant of two equal misfits is no slope: the one before it serves once more.
            slope = np.where(np.isfinite(secant) & (secant != 0.0), secant, slope)
            row, miss = row + step, next_miss
            done = np.abs(step) < _GOAL
            image[there[done], 0], image[there[done], 1] = col[done], row[done]
            on = ~done & np.isfinite(miss) & (np.abs(row) < 2.0 * limit)
            there, row, miss, slope = there[on], row[on], miss[on], slope[on]
        image[~np.isfinite(image).all(axis=1)] = np.nan
        return image

    def jacobian(self, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of (col, row) by parameters (N, 2, P) and by ground coordinates (N, 2, 3)."""
        # With the column c and the misfit m as seen from a row, m(p, row) = 0 defines the row: implicitly,
        # d row / dp = −(∂m/∂p) / (∂m/∂row), and d col / dp = ∂c/∂p + ∂c/∂row · d row / dp.
        points = np.asarray(xyz, dtype=np.float64)
        cols, rows = self.ground_to_image(points).T
        sight = self.platform.sight(self.parameters.values, rows, points)
        by_all = np.concatenate([sight.by_values, sight.by_ground, sight.by_row[:, :, None]], axis=2)
        count = len(self.parameters)
        # Slopes across and along are components over the depth, −z.
        slopes = sight.seen[:, :2] / -sight.seen[:, 2:]
        change = (by_all[:, :2] + slopes[:, :, None] * by_all[:, 2:]) / -sight.seen[:, 2:, None]
        across, along, curve = self.look.column_slopes(cols, *self._bend)
        stretch, bend = (np.zeros(by_all.shape[2]) for _ in range(2))
        stretch[:count], bend[:count] = self.platform.bend_slopes()
        by_col = (change[:, 0] - curve[:, None] * stretch) / across[:, None]
        by_miss = change[:, 1] - along[:, None] * by_col - curve[:, None] * bend
        by_row = -by_miss[:, :-1] / by_miss[:, -1:]
        total = np.stack([by_col[:, :-1] + by_col[:, -1:] * by_row, by_row], axis=1)
        return total[:, :, :count], total[:, :, count:]

    def rays(self, colrow: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Image (N, 2) to origins (N, 3) and unit directions (N, 3) towards the ground, geocentric."""
        pixels = np.asarray(colrow, dtype=np.float64)
        across, along = self.look.slopes(pixels[:, 0], *self._bend)
        position, axes = self.platform.pose(self.parameters.values, pixels[:, 1])
        # Slopes are per unit of depth, and z points away from the ground: the third component is −1.
        directions = combined(axes, np.stack([across, along, np.full(len(pixels), -1.0)], axis=1))
        return position, unit(directions)

    def with_values(self, values: FloatArray) -> Self:
        """Scene with other parameter values (P,)."""
        return replace(self, parameters=self.parameters.with_values(values))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {
            "platform": self.platform.kind,
            "flight": self.platform.to_dict(),
            "look": self.look.to_dict(),
            "crs": self.crs.to_wkt(),
            "size": list(self.size),
            **self.parameters.to_dict(),
            "seed": list(self.seed),
            "guess": self.guess.tolist(),
            "notes": list(self.notes),
        }

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Model of a state, as `to_dict` gives it."""
        platform = PLATFORMS[state["platform"]].from_dict(state["flight"])
        parameters = Parameters.from_dict(platform.names, platform.units, state)
        x, y, z = state["seed"]
        width, height = state["size"]
        crs, guess = CRS.from_wkt(state["crs"]), np.array(state["guess"])
        look, notes = LookDirections.from_dict(state["look"]), tuple(state["notes"])
        return cls(platform, look, crs, (width, height), parameters, (x, y, z), guess, notes)


ECEF = CRS.from_epsg(4978)
# Beyond these differences are no derivatives any more, however little they move the image.
_LARGEST_STEP = {"m": 1e4, "deg": 0.05, "deg/s": 0.05, "s": 1.0, "px": 1e2}


def initial_model(
    platform: Platform,
    look: LookDirections,
    size: tuple[int, int],
    values: FloatArray,
    sigmas: FloatArray,
    height: float,
    where: str,
    *,
    crs: CRS = ECEF,
) -> PushbroomModel:
    """Initial model of platform and look directions: seed, rough rows, parameter steps of about a pixel.

    Parameters
    ----------
    platform : Platform
    look : LookDirections
    size : tuple of int
        Width and height in pixels.
    values, sigmas : array (P,)
        Of the platform's parameters.
    height : float
        Rough ellipsoidal height of the ground in metres.
    where : str
        Named in errors.
    crs : CRS
        Geocentric.

    Raises
    ------
    InputError
        The scanner does not look at the ground.
    """
    parameters = Parameters(platform.names, platform.units, values, sigmas, np.ones(len(values)))
    origin = (0.0, 0.0, 0.0)
    bare = PushbroomModel(platform, look, crs, size, parameters, origin, np.zeros(5), ())
    width, rows = float(size[0]), float(size[1])
    # Nine rays, at corners, edges and middle, are enough for a linear guess of the row of a ground point.
    c, r = np.meshgrid([0.0, width / 2, width], [0.0, rows / 2, rows])
    origins, directions = bare.rays(np.column_stack([c.ravel(), r.ravel()]))
    distances = _down_to(crs, origins, directions, height)
    if not np.isfinite(distances).all():
        raise InputError(
            "lines of sight of this scene do not reach the ground",
            where=where,
            hint="check the attitude angles, their unit, and that the file belongs to the image",
        )
    middle = len(distances) // 2
    seed = origins[middle] + distances[middle] * directions[middle]
    # Points above and below the ground too, so that the guess also knows what height does to the row.
    shares = np.repeat([0.98, 1.0, 1.02], len(distances))
    points = np.tile(origins, (3, 1)) + (shares * np.tile(distances, 3))[:, None] * np.tile(directions, (3, 1))
    off = points - seed
    scale = float(np.abs(off).max())
    design = np.column_stack([np.ones(len(off)), off / scale])
    guess = np.linalg.lstsq(design, np.tile(r.ravel(), 3), rcond=None)[0] / [1.0, scale, scale, scale]
    ground = origins + distances[:, None] * directions
    # The first step of the secant search needs the change of the misfit over one row.
    ends = [bare.seen_from(ground, r.ravel() + shift)[1] for shift in (-0.5, 0.5)]
    slope = float(np.median(ends[1] - ends[0]))
    if not abs(slope) > 0.0:
        raise InputError("the scanner does not move from row to row", where=where, hint="check times and positions")
    x, y, z = seed.tolist()
    model = replace(bare, seed=(x, y, z), guess=np.append(guess, slope))
    return replace(model, parameters=replace(parameters, steps=_steps(model, ground)))


def _down_to(crs: CRS, origins: FloatArray, directions: FloatArray, height: float) -> FloatArray:
    """Distances (N,) along rays to an ellipsoidal height; NaN where they do not get there."""
    # Height along a ray is convex, so Newton's steps from above never pass the height.
    to_geographic = Transform(crs, geographic(crs))
    t = np.zeros(len(origins))
    for _ in range(60):
        over = to_geographic(origins + t[:, None] * directions)[:, 2] - height
        # One metre further along: ellipsoidal height has no closed derivative along a ray.
        ahead = to_geographic(origins + (t + 1.0)[:, None] * directions)[:, 2] - height
        slope = ahead - over
        step = np.where(slope < -1e-6, -over / np.where(slope < -1e-6, slope, -1.0), np.nan)
        t = t + step
        if not (np.abs(step) > 1e-4).any():
            break
    return np.where(t > 0.0, t, np.nan)


def _steps(model: PushbroomModel, ground: FloatArray) -> FloatArray:
    """Changes of parameters that move the image by a pixel where they move it most, or less if that took too much."""
    image = model.ground_to_image(ground)
    values = model.parameters.values
    steps = np.empty(len(values))
    for index, named in enumerate(model.parameters.units):
        step = {"m": 1.0, "deg": 1e-4, "deg/s": 1e-4, "s": 1e-4, "px": 1.0}[named]
        # The image may answer a change non-linearly: the step is scaled to a pixel three times.
        for _ in range(3):
            moved = values.copy()
            moved[index] += step
            most = np.nanmax(np.hypot(*(model.with_values(moved).ground_to_image(ground) - image).T))
            step = float(np.clip(step / max(float(most), 1e-6), 1e-12, _LARGEST_STEP[named]))
        steps[index] = step
    return steps
