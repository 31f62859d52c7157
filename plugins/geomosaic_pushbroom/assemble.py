"""Initial model of platform and look directions: a ground point to start from, steps of about a pixel, rough rows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import geographic
from geomosaic.geo.transform import Transform
from geomosaic.sensor.model import Parameters
from geomosaic.types import FloatArray
from geomosaic_pushbroom.look_angles import LookDirections
from geomosaic_pushbroom.model import PushbroomModel
from geomosaic_pushbroom.platform import Platform

ECEF = CRS.from_epsg(4978)
_LARGEST_STEP = {"m": 1e4, "deg": 0.05, "deg/s": 0.05, "s": 1.0, "px": 1e2}
"""Beyond these differences are no derivatives any more, however little they move the image."""


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
    notes: tuple[str, ...] = (),
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
    notes : tuple of str
        What was assumed so far.

    Raises
    ------
    InputError
        The scanner does not look at the ground.
    """
    parameters = Parameters(platform.names, platform.units, values, sigmas, np.ones(len(values)))
    origin = (0.0, 0.0, 0.0)
    bare = PushbroomModel(platform, look, crs, size, parameters, origin, np.zeros(5), notes)
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
    for index, unit in enumerate(model.parameters.units):
        step = {"m": 1.0, "deg": 1e-4, "deg/s": 1e-4, "s": 1e-4, "px": 1.0}[unit]
        # The image may answer a change non-linearly: the step is scaled to a pixel three times.
        for _ in range(3):
            moved = values.copy()
            moved[index] += step
            most = np.nanmax(np.hypot(*(model.with_values(moved).ground_to_image(ground) - image).T))
            step = float(np.clip(step / max(float(most), 1e-6), 1e-12, _LARGEST_STEP[unit]))
        steps[index] = step
    return steps
