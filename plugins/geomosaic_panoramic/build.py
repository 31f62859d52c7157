"""Models of panoramic images and scanned strips from numbers of the flight, corrected by control points.

Over level ground the place of a scanner and the tilt of its view are nearly one thing: a shift ahead and a pitch move
the whole image alike, and so, near the nadir, do a shift aside and a roll. So nothing is free by default. The sigmas
share a correction between the two, and relief tells them apart where there is enough of it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError, SensorInputError, default_hint, default_where
from geomosaic.geo.crs import horizontal
from geomosaic.geo.local_frames import LocalFrame, map_place
from geomosaic.geo.transform import Transform
from geomosaic.sensor.inputs import apriori_sigmas, point_rows
from geomosaic.sensor.plausibility import require_vertical_datum
from geomosaic.sensor.plugin import Parameters, SensorRequest
from geomosaic.sensor.ray_corrections import requested_correction
from geomosaic.sensor.solve import resect_control
from geomosaic.types import FloatArray
from geomosaic.whole_files import read_text
from geomosaic_panoramic.flight import (
    PER_STEP,
    declared_orbit,
    number_option,
    read_table,
    require_cover,
    straight_motion,
    table_poses,
    triple_option,
    warn_of_cell_shape,
    word,
)
from geomosaic_panoramic.geometry import KINDS, Scan, Sweeps
from geomosaic_panoramic.model import NAMES, PanoramicModel, RelativeStrip
from geomosaic_panoramic.optical_bar import read_optical_bar
from geomosaic_panoramic.trajectory import Poses

POINT = ("x", "y", "z", "col", "row")
GROUPS = {
    "position": ("east", "north", "up"),
    "speed": ("speed_east", "speed_north"),
    "angles": ("heading", "pitch", "roll"),
    "rates": ("heading_rate", "pitch_rate", "roll_rate"),
}
# Of a flight described by nominal numbers: shares of the height above ground and of the advance; degrees.
NOMINAL = {"position": 0.05, "speed": 0.05, "angles": math.degrees(0.05), "rates": 0.0}
# Of a track: metres, and degrees of a boresight before it is calibrated.
MEASURED = {"position": 1.0, "speed": 0.0, "angles": 0.5, "rates": 0.0}


def _adjusted(model: PanoramicModel, request: SensorRequest, crs: CRS, above: float) -> PanoramicModel:
    """Model corrected by the control points of a request, where it has any, `above` metres over the ground."""
    where, options = request.image, request.options
    sigmas = _sigmas(model, request, above)
    refine = word(options, "refine", ("points", "none"), where, "points")
    if options.get("points") is None:
        return model
    names, rows = point_rows(options["points"], POINT, where)
    if refine == "none" or not rows:
        return model
    table = np.array(rows)
    ground = Transform(crs, model.crs)(table[:, :3])
    with default_where(where):
        found = resect_control(model, ground, table[:, 3:5], table[:, 5], names, priors=sigmas)
    return found.noted(names, where)


def _sigmas(model: PanoramicModel, request: SensorRequest, above: float) -> FloatArray:
    """A-priori sigmas: those of what is known of the flight, then of groups, then of single parameters."""
    units = {"position": above, "speed": model.track.pace, "angles": 1.0, "rates": 1.0}
    known = MEASURED if "track" in request.options else {name: NOMINAL[name] * units[name] for name in GROUPS}
    usual = dict.fromkeys(model.parameters.names, 0.0)
    for group, members in GROUPS.items():
        usual |= dict.fromkeys(members, known[group])
    return np.array(apriori_sigmas(request.options.get("sigmas", {}), usual, GROUPS, request.image))


# Inputs of a straight flight, which a table or an orbit replaces.
STRAIGHT = ("heading", "course", "rates", "advance", "v_over_h", "climb")
# Inputs that a strip without a place has not.
PLACED = (
    "position", "heading", "north", "course", "track", "start_time", "ground_height", "treatment", "refraction",
    "curvature",
)  # fmt: skip
TREATMENTS = ("rigorous", "planar")
# Inputs that mean something for some kinds only.
OF_KIND = {
    "focal_length": ("panoramic",), "pixel_size": ("panoramic",), "image_motion": ("sweeps", "panoramic"),
    "lines_per_sweep": ("sweeps",), "directions": ("sweeps",), "active": ("sweeps",), "line_angle": ("sweeps",),
}  # fmt: skip


def build_model(request: SensorRequest) -> PanoramicModel | RelativeStrip:
    """Model of a panoramic image or scanned strip.

    Parameters
    ----------
    request : SensorRequest
        Size in pixels, 3-D CRS of position or track, and the options of the sensor.

    Returns
    -------
    PanoramicModel or RelativeStrip
        The latter where the option `relative` is true: a strip without a place.

    Raises
    ------
    InputError
        An input is missing, unknown or out of range.
    HeightDatumError
        The position has no vertical datum.
    SolveError
        The scanner sees none of the control points.
    """
    where = request.image
    relative = request.options.get("relative", False)
    if not isinstance(relative, bool):
        raise SensorInputError(
            f"input 'relative' is {relative!r}", name="relative", where=where, hint="give true or false"
        )
    if not relative:
        extra = [name for name in ("height_above_ground", "latitude", "drift") if name in request.options]
        if extra:
            raise SensorInputError(
                f"input '{extra[0]}' is given without relative", name="relative", where=where, hint="leave it out"
            )
        return _placed(request)
    options = _without_place(request)
    model = _placed(replace(request, options=options, crs=CRS.from_epsg(4979)))
    return RelativeStrip(model, options["position"][2], "orbit" in options)


def _without_place(request: SensorRequest) -> dict[str, Any]:
    """Inputs at a nominal place, instead of those without one."""
    where, options = request.image, dict(request.options)
    for name in (*PLACED, "points", "refine", "sigmas"):
        if name in options:
            raise InputError(f"input '{name}' is given together with relative", where=where, hint="leave one out")
    above = number_option(options, "height_above_ground", where)
    latitude = number_option(options, "latitude", where, None if "orbit" in options else 0.0)
    if above <= 0.0 or not -90.0 < latitude < 90.0:
        raise SensorInputError(
            f"height_above_ground is {above:g}, latitude {latitude:g}",
            name="height_above_ground",
            where=where,
            hint="give metres and degrees",
        )
    drift = number_option(options, "drift", where, 0.0)
    if "orbit" in options and "drift" in options:
        raise SensorInputError(
            "input 'drift' is given together with 'orbit'", name="drift", where=where, hint="leave one out"
        )
    for name in ("relative", "height_above_ground", "latitude", "drift"):
        options.pop(name, None)
    options |= {"position": [0.0, latitude, above], "ground_height": 0.0}
    return options if "orbit" in options else {**options, "heading": 0.0, "course": -drift, "north": "true"}


def _of_optical_bar(request: SensorRequest) -> PanoramicModel:
    """Model of an optical bar camera of the Ames Stereo Pipeline."""
    where, options = request.image, request.options
    # What the program fills in is the mean height of the ground, which the file has too.
    other = sorted(options.keys() - {"optical_bar", "points", "refine", "sigmas", "ground_height"})
    if other:
        raise SensorInputError(
            f"input '{other[0]}' is given together with optical_bar", name=other[0], where=where, hint="leave it out"
        )
    if options.get("points") and request.crs is None:
        raise InputError("the control points have no CRS", where=where, hint="give `crs`")
    file = Path(request.base) / str(options["optical_bar"])
    with default_hint(f"write {file.name} again with the program it comes from, or correct what was edited in it"):
        scan, frame, values, above = read_optical_bar(read_text(file, "camera"), request.size, str(file))
    x, y, z = frame.origin.tolist()
    model = PanoramicModel(scan, frame, _parameters("panoramic", scan, values, above), (x, y, z))
    return _adjusted(_seen(model, above), request, request.crs or frame.crs, above)


def _placed(request: SensorRequest) -> PanoramicModel:
    """Model at its place."""
    where, options = request.image, request.options
    if "optical_bar" in options:
        return _of_optical_bar(request)
    kind = word(options, "kind", KINDS, where)
    for name, kinds in OF_KIND.items():
        if name in options and kind not in kinds:
            raise SensorInputError(
                f"{name} has no meaning for a {kind.removesuffix('s')}", name="kind", where=where, hint="leave it out"
            )
    if request.crs is None:
        raise InputError("sensor 'panoramic' needs the CRS of the position", where=where, hint="give `crs`")
    require_vertical_datum(request.crs, "the position", where, lambda crs: _placed(replace(request, crs=crs)))
    scan = _scan(kind, request)
    table, tau = _table(request, scan.periods)
    if table is None:
        position = np.array(triple_option(options, "position", where))
    else:
        position = np.array([np.interp(0.0, tau, table[:, i]) for i in (1, 2, 3)])
    treatment = word(options, "treatment", TREATMENTS, where, "rigorous")
    if treatment == "planar" and "orbit" in options:
        raise SensorInputError(
            "an orbit goes round the Earth, which the planar treatment takes for flat",
            name="treatment",
            where=where,
            hint="leave treatment out",
        )
    planar = treatment == "planar"
    frame = LocalFrame.of_map(request.crs, position, where) if planar else LocalFrame.at(request.crs, position)
    if not np.isfinite(frame.origin).all():
        raise InputError(
            f"position {position.tolist()} has no place in '{request.crs.name}'",
            where=where,
            hint="check its order, x before y, and the CRS",
        )
    ground = number_option(options, "ground_height", where, 0.0)
    known = ground if options.get("ground_height") is not None else None
    correction, notes = requested_correction(options, request.crs, position, known, planar, where)
    above = float(position[2] - ground)
    if above <= 0.0:
        raise InputError(f"the position is {-above:g} m below ground_height", where=where, hint="check both heights")
    grid = word(options, "north", ("grid", "true"), where, "grid") == "grid"
    poses: Poses | None = None
    motion = np.zeros(12)
    motion[7:9] = number_option(options, "pitch", where, 0.0), number_option(options, "roll", where, 0.0)
    if table is not None:
        poses = table_poses(table, tau, request.crs, frame, grid=grid)
    elif "orbit" in options:
        poses = declared_orbit(options, frame, scan.periods / 2, where)
    else:
        # Headings count from grid or true north, and the axes of the frame from the other one or not.
        turn = 0.0
        if grid != planar and horizontal(request.crs).is_projected:
            turn = map_place(request.crs, position[0], position[1]).convergence * (-1.0 if planar else 1.0)
        motion = straight_motion(options, kind, above, turn, where)
    beta = _field(options, kind, where) / request.size[0]
    if kind == "scanner" and poses is None:
        warn_of_cell_shape(float(np.hypot(motion[3], motion[4])), above * math.radians(beta), where)
    values = np.array([*motion, beta, *_inner(options, kind, beta, where)])
    seed = position.copy()
    seed[2] = ground
    x, y, z = Transform(request.crs, frame.crs)(seed[None])[0].tolist()
    parameters = _parameters(kind, scan, values, above)
    model = _seen(PanoramicModel(scan, frame, parameters, (x, y, z), poses, tuple(notes), correction), above)
    return _adjusted(model, request, request.crs, above)


def _scan(kind: str, request: SensorRequest) -> Scan:
    """Scan of the options: kind, size, side of the columns, sweeps."""
    where, options = request.image, request.options
    side = 1 if word(options, "columns", ("right", "left"), where, "right") == "right" else -1
    lines = number_option(options, "lines_per_sweep", where, 16.0)
    both = word(options, "directions", ("one", "both"), where, "one") == "both"
    active = number_option(options, "active", where, 1.0)
    if lines < 1 or lines != round(lines) or not 0.0 < active <= 1.0:
        raise SensorInputError(
            f"lines_per_sweep is {lines:g}, active {active:g}",
            name="lines_per_sweep",
            where=where,
            hint="give a whole number of lines, and a share above 0, up to 1",
        )
    return Scan(kind, request.size, side, Sweeps(int(lines), both, active))


def _table(request: SensorRequest, periods: float) -> tuple[np.ndarray | None, np.ndarray]:
    """Rows of the track and their τ; none without a track. Refuses inputs that a track or an orbit replaces."""
    where, options = request.image, request.options
    curved = [name for name in ("track", "orbit") if name in options]
    if not curved:
        for name in ("start_time", "period"):
            if name in options:
                raise SensorInputError(
                    f"input '{name}' needs a track or an orbit", name="track", where=where, hint="leave it out"
                )
        return None, np.zeros(0)
    taken = [name for name in (*curved[1:], *STRAIGHT) if name in options]
    taken += [name for name in ("position",) if curved[0] == "track" and name in options]
    if taken:
        raise InputError(
            f"input '{taken[0]}' is given together with '{curved[0]}'", where=where, hint="leave one of them out"
        )
    if curved[0] == "orbit":
        return None, np.zeros(0)
    if not isinstance(options["track"], str):
        raise SensorInputError(
            f"track = {options['track']!r} is not a file name",
            name="track",
            where=where,
            hint="give the name of a table: track = 'flight.csv'",
        )
    start, period = number_option(options, "start_time", where), number_option(options, "period", where)
    if period <= 0.0:
        raise SensorInputError(
            f"period is {period:g} s", name="period", where=where, hint="give the seconds of one line or sweep"
        )
    file = Path(request.base) / options["track"]
    table = read_table(file, where)
    tau = (table[:, 0] - start) / period - periods / 2
    require_cover(tau, periods / 2, f"{where} ({file})")
    return table, tau


def _field(options: Mapping[str, Any], kind: str, where: str) -> float:
    """Field of view of the option, degrees."""
    field = number_option(options, "field_of_view", where)
    # A scanner's ground cells grow with sec² of the angle and have no end at 90 degrees to the side.
    limit = 180.0 if kind == "panoramic" else 170.0
    if not 0.0 < field < limit:
        raise SensorInputError(
            f"field_of_view is {field:g}",
            name="field_of_view",
            where=where,
            hint=f"give degrees between 0 and {limit:g}",
        )
    return field


def _inner(options: Mapping[str, Any], kind: str, beta: float, where: str) -> list[float]:
    """Focal length and image motion in pixels; a scanner has none."""
    if kind == "scanner":
        return []
    motion = number_option(options, "image_motion", where, 0.0)
    if kind == "sweeps":
        angle = number_option(options, "line_angle", where, beta)
        if angle <= 0.0:
            raise SensorInputError(
                f"line_angle is {angle:g}", name="line_angle", where=where, hint="give degrees above 0"
            )
        return [1.0 / math.radians(angle), motion]
    focal, pixel = number_option(options, "focal_length", where), number_option(options, "pixel_size", where)
    if focal <= 0.0 or pixel <= 0.0:
        raise SensorInputError(
            "focal_length and pixel_size must be greater than 0",
            name="focal_length",
            where=where,
            hint="give both in mm",
        )
    return [focal / pixel, motion]


def _seen(model: PanoramicModel, above: float) -> PanoramicModel:
    """Model with its seed on the centre ray of the image, where that comes down by the height above ground."""
    row = model.size[1] / 2
    if model.scan.kind == "sweeps":  # in the middle of a sweep: at its border there are no derivatives
        row = (np.floor(row / model.scan.sweeps.lines) + 0.5) * model.scan.sweeps.lines
    middle = np.array([[model.size[0] / 2, row]])
    origins, directions = model.rays(middle)
    down = -(directions @ model.frame.axes.T)[0, 2]
    # Closer to the horizon than 3 degrees, a small error of the attitude moves the seed by kilometres.
    if down <= 0.05:
        raise InputError("the middle of the image looks at the sky", hint="check roll and pitch, in degrees")
    x, y, z = (origins + directions * above / down)[0].tolist()
    return replace(model, seed=(x, y, z))


def _parameters(kind: str, scan: Scan, values: np.ndarray, above: float) -> Parameters:
    """Parameters with steps of about a pixel in the image."""
    # Field of view, focal length, image motion and the rates are held fixed unless an adjustment frees them.
    beta, size = math.radians(values[12]), scan.size
    pixel, reach = above * beta, max(1.0, scan.periods / 2) if kind != "panoramic" else 0.5
    angle = math.degrees(beta)
    # Numeric derivatives of pixel-sized steps are smooth; rates act over half the image, so their steps are smaller.
    steps = [
        pixel, pixel, pixel, pixel / reach, pixel / reach, pixel / reach, angle, angle, angle, angle / reach,
        angle / reach, angle / reach, values[12] / size[0] * 2,
    ]  # fmt: skip
    if kind != "scanner":
        lines = size[1] if kind == "panoramic" else scan.sweeps.lines
        steps += [values[13] / lines * 2, 1.0]
    sigmas = [math.inf] * 5 + [0.0] + [math.inf] * 3
    sigmas += [0.0] * (len(values) - len(sigmas))
    unit = PER_STEP[kind]
    units = ("m",) * 3 + (f"m/{unit}",) * 3 + ("deg",) * 3 + (f"deg/{unit}",) * 3 + ("deg", "px", "px")
    return Parameters(NAMES[kind], units[: len(values)], values, np.array(sigmas), np.array(steps))
