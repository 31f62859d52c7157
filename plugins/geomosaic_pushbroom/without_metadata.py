"""Scenes without metadata: straight flight from control points, started by a parallel projection.

Seen from far away a scanned line is nearly a parallel projection, and over a short flight so is the whole scene:
col = a₀ + a·g and row = b₀ + b·g for ground points g in local east, north, up. Both forms are linear, so no start is
needed. The direction of view is a × b; the ground the middle of the first and last row show gives A and E, a distance D
up that direction; the ground a pixel covers across it gives the scale D / f.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from geomosaic.errors import GeomosaicError, InputError, SolveError, counted, default_where
from geomosaic.geo.crs import geographic
from geomosaic.geo.local_frames import LocalFrame, angles_of
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import EARTH_RADIUS
from geomosaic.sensor.inputs import known_keys, number, positive
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.solve import ControlResection, resect, resect_control
from geomosaic.sensor.solve.control_judgement import LinearControl, judge_control
from geomosaic.types import BoolArray, FloatArray
from geomosaic_pushbroom.model import ECEF, PushbroomModel, initial_model
from geomosaic_pushbroom.platform import ADDITIONAL, IDEAL, StraightFlight
from geomosaic_pushbroom.points import ImageControl, need_crs
from geomosaic_pushbroom.pose import LookDirections


def _contradicting_points(ground: FloatArray, colrow: FloatArray) -> BoolArray:
    """Control points (N,) that contradict a parallel projection of the others.

    A flight bends towards a wrong point and hides it; a parallel projection, with squares of east and north where there
    are points enough, is stiff.
    """
    off = (ground - ground.mean(axis=0)) / np.abs(ground - ground.mean(axis=0)).max()
    e, n, u = off.T
    terms = np.column_stack([np.ones(len(off)), e, n, u, e * e, e * n, n * n])[:, : 7 if len(off) >= ENOUGH else 4]
    design = np.einsum("ij,nk->nijk", np.eye(2), terms).reshape(len(off), 2, -1)
    return judge_control(LinearControl(design, colrow, np.ones(len(off))), known_sigmas=False).wrong


# Control points for the ideal flight: 9 unknowns, and a start of 8 that checks itself.
LEAST = 6
# Control points from which the additional parameters are free: 20 observations for 17 unknowns.
ENOUGH = 10
# Degrees, of omega and phi: where they come from, relief and the width of the line, may say little of them.
VIEW_SIGMA = 5.0
# Degrees, of the linear and squared terms of the angles in space; an orbit pitches by 0.25° over half a SPOT scene.
ANGLE_SIGMA = np.array([0.5, 0.5, 1.0, 0.2, 0.2, 0.2])
# Flying height in metres below which angles may be off and change by ten times as much.
AIRBORNE = 3e4
# Pixels, of bend and stretch.
LINE_SIGMA = 20.0
_STEEPEST = np.tan(np.radians(60.0))


@dataclass(frozen=True)
class InitialValues:
    """Initial values of the straight flight.

    Attributes
    ----------
    values : array (9,)
        Those of `IDEAL`, metres and degrees.
    focal : float
        Camera constant in pixels.
    flying_height : float
        Metres above the ground.
    """

    values: FloatArray
    focal: float
    flying_height: float


def model_from_control(request: SensorRequest, control: ImageControl) -> PushbroomModel:
    """Model of a scene from its control points alone.

    Parameters
    ----------
    request : SensorRequest
        Size in pixels, CRS of the points, and the options focal_length_px or flying_height, or both.
    control : ImageControl

    Raises
    ------
    InputError
        Too few points, or neither focal_length_px nor flying_height.
    SolveError
        The points do not determine the flight.
    """
    where, options = request.image, request.options
    if options.get("refine", "points") == "none":
        raise InputError("there is nothing but control points, and refine = none", where=where, hint="leave refine out")
    if len(control) < LEAST:
        raise InputError(
            f"{counted(len(control), 'control point')} cannot place a scene without metadata",
            where=where,
            hint=f"at least {LEAST} are needed, {ENOUGH} for the additional parameters too, spread over the image and "
            "over height",
        )
    additional = _additional(options.get("additional"), len(control), where)
    crs = need_crs(request)
    frame = LocalFrame.at(crs, np.array([*control.xyz.mean(axis=0)])[None])
    suspects = _contradicting_points(frame.to_enu(Transform(crs, ECEF)(control.xyz)), control.colrow)
    with default_where(where):
        found = _flight(request, control, frame, suspects, additional)
        # A suspect that the flight of the others meets takes part from the start.
        if (suspects & found.used).any():
            found = _flight(request, control, frame, suspects & ~found.used, additional)
    return found.noted(control.names, where)


def _flight(
    request: SensorRequest, control: ImageControl, frame: LocalFrame, suspects: BoolArray, additional: tuple[str, ...]
) -> ControlResection[PushbroomModel]:
    """Straight flight from control points, started without those that are suspects (N,)."""
    where, options, good = request.image, request.options, ~suspects
    xyz = Transform(need_crs(request), ECEF)(control.xyz)
    given = options.get("principal_col")
    centre = request.size[0] / 2.0 if given is None else number(given, "principal_col", where)
    start = _initial_values(frame.to_enu(xyz[good]), control.colrow[good], request.size, centre, options, where)
    height = float(Transform(ECEF, geographic(ECEF))(frame.origin[None])[0, 2])
    factor = 10.0 if start.flying_height < AIRBORNE else 1.0
    sigmas = np.full(len(StraightFlight.names), np.inf)
    sigmas[6:8], sigmas[9:] = VIEW_SIGMA * factor, 0.0
    sides = np.array([0.0, float(request.size[0])])

    def model_at(values: FloatArray, focal: float, notes: tuple[str, ...] = ()) -> PushbroomModel:
        platform = StraightFlight(frame, request.size[1], focal)
        look = LookDirections(sides, (sides - centre) / focal, np.zeros(2))
        model = initial_model(platform, look, request.size, values, sigmas, height, where, crs=frame.crs)
        return replace(model, notes=notes)

    values, focal = np.concatenate([start.values, np.zeros(len(ADDITIONAL))]), start.focal
    try:
        solved = resect(model_at(values, focal), xyz[good], control.colrow[good], control.sigmas[good])
    except GeomosaicError as error:
        raise _undetermined(control, options) from error
    values = solved.model.parameters.values.copy()
    if options.get("focal_length_px") is None:
        # The view is better known now, and with it the distance that belongs to the flying height.
        scale = _slant(start.flying_height, float(np.prod(np.cos(np.radians(values[6:8]))))) / values[[2, 5]].mean()
        focal, values[[2, 5]] = focal * scale, values[[2, 5]] * scale
    # Only now: with the view still unknown, additional parameters would take up its error.
    own = np.concatenate([ANGLE_SIGMA * factor, np.full(2, LINE_SIGMA)])
    sigmas[9:] = np.where(np.isin(ADDITIONAL, additional), own, 0.0)
    notes = [f"camera constant {focal:.1f} px, {start.flying_height:.0f} m above the ground"]
    notes += [f"additional parameters: {', '.join(additional)}"] if additional else []
    try:
        found = resect_control(
            model_at(values, focal), xyz, control.colrow, control.sigmas, control.names, suspects=suspects
        )
    except GeomosaicError as error:
        raise _undetermined(control, options) from error
    model = model_at(found.solved.model.parameters.values, focal, tuple(notes))
    return replace(found, solved=replace(found.solved, model=model))


def _undetermined(control: ImageControl, options: Mapping[str, Any]) -> SolveError:
    """Error of points with which the direction of view turns without end."""
    # Measured on a SPOT scene, 6 points with 0.3 px over 1 to 800 m of relief, 20 seeds each: none of 60 with the
    # flying height, 3 of 60 with the camera constant; with one point 100 px off 0 to 12 of 20, most over flat ground.
    other = options.get("focal_length_px") is not None and options.get("flying_height") is None
    return SolveError(
        f"{counted(len(control), 'control point')} do not determine the flight and the direction of view: one of them "
        "is wrong, or they are few over flat ground",
        hint=f"check the points; give at least {ENOUGH}, spread over the image and over height"
        + ("; or give flying_height in place of focal_length_px" if other else ""),
    )


def _additional(given: Any, count: int, where: str) -> tuple[str, ...]:
    """Names of the additional parameters that are free."""
    if given is None:
        return ADDITIONAL if count >= ENOUGH else ()
    if given in ("all", "none"):
        chosen: tuple[str, ...] = ADDITIONAL if given == "all" else ()
    elif isinstance(given, list | tuple):
        known_keys(dict.fromkeys(map(str, given)), ADDITIONAL, f"{where}, additional")
        chosen = tuple(name for name in ADDITIONAL if name in given)
    else:
        raise InputError(
            f"additional = {given!r}", where=where, hint=f"all, none, or a list of {', '.join(ADDITIONAL)}"
        )
    if 2 * count < len(IDEAL) + len(chosen):
        raise InputError(
            f"{count} control points are too few for {len(chosen)} additional parameters",
            where=where,
            hint="give more points, or additional = none",
        )
    return chosen


def _initial_values(
    ground: FloatArray,
    colrow: FloatArray,
    size: tuple[int, int],
    principal: float,
    options: Mapping[str, Any],
    where: str,
) -> InitialValues:
    """Initial values of the straight flight, from a parallel projection of control points.

    Ground (N, 3) is east, north, up in metres, `principal` the column of the principal point.
    """
    constant, a, b = _parallel_projection(ground, colrow, where)
    view = np.cross(a, b)
    view /= -np.linalg.norm(view) * np.sign(view[2])  # downwards
    level = float(ground[:, 2].mean())
    plane = np.array([a[:2], b[:2]])

    def below(col: float, row: float) -> FloatArray:
        xy = np.linalg.solve(plane, np.array([col, row]) - constant - level * np.array([a[2], b[2]]))
        return np.array([*xy, level])

    pixel = np.linalg.solve(plane, np.array([1.0, 0.0]))
    across = np.array([*pixel, 0.0])
    across -= (across @ view) * view
    size_of_pixel = float(np.linalg.norm(across))
    if options.get("flying_height") is not None:
        flying = positive(options["flying_height"], "flying_height", where)
        distance = _slant(flying, -view[2])
        focal = distance / size_of_pixel
        if options.get("focal_length_px") is not None:
            focal = positive(options["focal_length_px"], "focal_length_px", where)
    elif options.get("focal_length_px") is not None:
        focal = positive(options["focal_length_px"], "focal_length_px", where)
        distance = focal * size_of_pixel
        flying = float(np.linalg.norm(distance * -view + [0.0, 0.0, EARTH_RADIUS]) - EARTH_RADIUS)
    else:
        raise InputError(
            "a scene without metadata needs its camera constant or its flying height",
            where=where,
            hint="give focal_length_px (SPOT 1 to 4 panchromatic: 83230) or flying_height in metres (SPOT: 830000)",
        )
    x = across / size_of_pixel
    rotation = np.array([x, np.cross(-view, x), -view])
    values = []
    for row in (0.0, float(size[1])):
        centre = below(principal, row) - distance * view
        reach = centre[2] / -view[2]  # along the view down to local height 0
        values += [*(centre + reach * view)[:2], reach]
    return InitialValues(np.array([*values, *np.degrees(angles_of(rotation))]), focal, flying)


def _slant(height: float, cosine: float) -> float:
    """Slant distance to a height above a round Earth."""
    # The line leaves the ground at an angle to the vertical of the given cosine; height and distance in metres.
    along = EARTH_RADIUS * cosine
    return float(np.sqrt(along**2 + 2.0 * EARTH_RADIUS * height + height**2) - along)


def _parallel_projection(
    ground: FloatArray, colrow: FloatArray, where: str
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Parallel projection from ground to image by least squares."""
    # Without relief the vertical parts are unknown; a view from straight above is put against that, with the weight of
    # one observation of a point 60° oblique.
    middle = ground.mean(axis=0)
    off = ground - middle
    flat, image = off[:, :2], colrow - colrow.mean(axis=0)
    spread = [np.linalg.svd(v, compute_uv=False) for v in (flat, image)]
    if any(s[-1] < 1e-3 * s[0] or s[0] == 0.0 for s in spread):
        raise SolveError("the control points lie on a line", where=where, hint="spread them over the whole image")
    gradients = np.linalg.lstsq(flat, image, rcond=None)[0].T
    # Where there are points enough, the curvature of the Earth and the perspective along the line are kept out of the
    # vertical part. One pixel of misfit for a view as oblique as can be: relief of more than a few pixels outweighs it.
    span = float(np.abs(flat).max())
    e, n = off[:, 0] / span, off[:, 1] / span
    curved = np.column_stack([np.ones(len(off)), e * e, e * n, n * n])[:, : 4 if len(off) >= ENOUGH else 1]
    steepest = _STEEPEST * np.linalg.norm(gradients, axis=1)
    forms = []
    for i in range(2):
        design = np.vstack([np.hstack([off, curved]), np.zeros(3 + curved.shape[1])])
        # A pseudo-observation: vertical part 0, weighted as one pixel at the steepest view.
        design[-1, 2] = 1.0 / steepest[i]
        forms.append(np.linalg.lstsq(design, np.append(image[:, i], 0.0), rcond=None)[0])
    a, b = (form[:3] for form in forms)
    constant = colrow.mean(axis=0) + [form[3] for form in forms] - np.array([a @ middle, b @ middle])
    return constant, a, b
