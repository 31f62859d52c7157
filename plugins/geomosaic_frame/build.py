"""A photo's model from what the user gives: camera, position, orientation."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.geo.crs import geographic
from geomosaic.geo.rotation import angles_of
from geomosaic.geo.transform import Transform
from geomosaic.sensor.parameters import Parameters
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.sanity import centre_dip
from geomosaic.types import FloatArray
from geomosaic_frame.camera import Camera
from geomosaic_frame.inputs import OPTIONS
from geomosaic_frame.model import NAMES, FrameModel
from geomosaic_frame.opensfm import read_shot
from geomosaic_frame.orientation import DIRECTIONS, FRAMES, FULL_CIRCLE, SYSTEMS, Attitude, read_attitude
from geomosaic_frame.place import (
    Place,
    from_offset,
    from_topocentric,
    need_heights,
    of_longitude_latitude,
    planar,
    rigorous,
    undo_linear_alteration,
)
from geomosaic_frame.read import choice, known_keys, need, number, numbers, table_of

TREATMENTS = ("rigorous", "planar")
GROUPS = {"position": NAMES[:3], "angles": NAMES[3:]}
FARTHEST = 20.0
"""Seed of a flat ray: at most this many flying heights away."""
GUESSED_HEIGHT = 100.0
"""Flying height above an unknown ground where height 0 lies above the camera."""


def build_frame(request: SensorRequest) -> FrameModel:
    """Make the model of one photo.

    Raises
    ------
    InputError
        An input is missing, unknown or out of range, or the photo looks at the sky; names the image and the input.
    """
    where, options = request.image, request.options
    known_keys(options, OPTIONS, where)
    table, row = _tables(request)
    camera, notes = _camera(table, request)
    unit = choice(options.get("angle_unit", "deg"), FULL_CIRCLE, "angle_unit", where)
    treatment = choice(options.get("treatment", "rigorous"), TREATMENTS, "treatment", where)
    ground = (
        number(options["ground_height"], "ground_height", where) if options.get("ground_height") is not None else None
    )
    attitude = read_attitude(row, unit, where)
    crs = _crs(request, attitude)
    if attitude.position is not None:
        if "position" in options:
            raise InputError("position is given, but the orientation has its own", where=where, mend="leave it out")
        lla = np.array(numbers(need(row, "reference", where, "longitude, latitude, altitude"), 3, "reference", where))
        reference = of_longitude_latitude(crs, lla)
        need_heights(crs, reference, _reach(camera), where)
        bring = from_topocentric if attitude.frame == "topocentric" else from_offset
        position, attitude = bring(crs, reference, attitude, where)
    else:
        given = need(options, "position", where, "the projection centre [x, y, z] in the CRS of the positions")
        position = np.array(numbers(given, 3, "position", where))
        need_heights(crs, position, _reach(camera), where)
    if ground is not None and not crs.is_geocentric and position[2] <= ground:
        raise InputError(
            f"the camera, at height {position[2]:.2f}, is not above the ground at {ground:.2f}",
            where=where,
            mend="check z, ground_height and their vertical datum",
        )
    if _flag(options, "scale_correction", where):
        position, note = _unscaled(crs, position, ground, treatment, where)
        notes.append(note)
    place = (planar if treatment == "planar" else rigorous)(crs, position, attitude, where)
    return _model(camera, place, crs, ground, options, tuple(notes), where)


def _tables(request: SensorRequest) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """Camera table and orientation row, wherever they come from."""
    where, options = request.image, request.options
    row = dict(table_of(need(options, "orientation", where, "system and angles"), "orientation", where))
    table = options.get("camera")
    if row.get("system") in ("opensfm", "odm") and "reconstruction" in row:
        known_keys(row, ("system", "reconstruction"), where)
        path = Path(request.base) / str(row["reconstruction"])
        own, row = read_shot(path, request.image, str(row["system"]), where)
        table = own if table is None else table
    if isinstance(table, str):
        table = _toml(Path(request.base) / table, f"{where}, camera")
    if table is None:
        raise InputError(
            "'camera' is missing", where=where, mend="give the camera's table or the name of a camera.toml file"
        )
    for option, key, words in (("matrix", "matrix", DIRECTIONS), ("angle_frame", "frame", FRAMES)):
        if options.get(option) is not None:
            row.setdefault(key, choice(options[option], words, option, where))
    return table_of(table, "camera", where), row


def _toml(path: Path, where: str) -> Mapping[str, Any]:
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"the camera file {path} cannot be read: {error}", where=where) from error
    inner = values.get("camera")
    return inner if isinstance(inner, dict) and len(values) == 1 else values


def _camera(table: Mapping[str, Any], request: SensorRequest) -> tuple[Camera, list[str]]:
    """Camera for the image at hand, and what was done to it."""
    where = f"{request.image}, camera"
    full = Camera.from_table(table, request.size, where)
    camera = full.scaled(request.size, where)
    camera.warn_of_fold(where)
    if camera is full:
        return camera, []
    w, h = full.size
    factor = w / camera.size[0]
    return camera, [f"the image is a copy of the camera's {w} x {h} pixels, reduced by {factor:g}: camera scaled to it"]


def _reach(camera: Camera) -> float:
    return float(np.hypot(*camera.size)) / 2


def _crs(request: SensorRequest, attitude: Attitude) -> CRS:
    if request.crs is not None:
        return request.crs
    if attitude.frame == "topocentric":
        return CRS.from_epsg(4979)  # OpenSfM's own definition of its reference
    raise InputError(
        "the positions have no CRS", where=request.image, mend="name one with a vertical datum, for example EPSG:32633"
    )


def _flag(options: Mapping[str, Any], key: str, where: str) -> bool:
    value = options.get(key, False)
    if not isinstance(value, bool):
        raise InputError(f"{key} = {value!r} is neither true nor false", where=where)
    return value


def _unscaled(
    crs: CRS, position: FloatArray, ground: float | None, treatment: str, where: str
) -> tuple[FloatArray, str]:
    if treatment == "planar":
        raise InputError(
            "scale_correction undoes what the planar treatment needs", where=where, mend="use treatment = 'rigorous'"
        )
    if ground is None:
        raise InputError(
            "scale_correction needs to know the height of the ground",
            where=where,
            mend="give ground_height, the mean height of the ground under the photo in the vertical datum of the "
            "positions",
        )
    true = undo_linear_alteration(crs, position, ground, where)
    moved = true[2] - position[2]
    return true, f"linear alteration undone about {ground:.1f}: projection centre moved by {moved:+.3f} in height"


def _sigmas(options: Mapping[str, Any], where: str) -> FloatArray:
    """A-priori sigmas of the six parameters; free where nothing is said."""
    table = table_of(options.get("sigmas", {}), "sigmas", where)
    where = f"{where}, sigmas"
    known_keys(table, (*GROUPS, *NAMES), where)
    values = dict.fromkeys(NAMES, np.inf)
    for group, names in GROUPS.items():
        if group in table:
            values.update(dict.fromkeys(names, number(table[group], group, where)))
    values.update({name: number(table[name], name, where) for name in NAMES if name in table})
    negative = [name for name, value in values.items() if value < 0.0]
    if negative:
        raise InputError(f"the sigma of {negative[0]} is negative", where=where, mend="0 holds it fixed")
    return np.array([values[name] for name in NAMES])


def _model(
    camera: Camera,
    place: Place,
    crs: CRS,
    ground: float | None,
    options: Mapping[str, Any],
    notes: tuple[str, ...],
    where: str,
) -> FrameModel:
    values = np.array([0.0, 0.0, 0.0, *np.degrees(angles_of(place.rotation))])
    unit = "m" if place.frame.crs.is_geocentric else str(crs.axis_info[0].unit_name)
    units = (unit,) * 3 + ("deg",) * 3
    parameters = Parameters(NAMES, units, values, _sigmas(options, where), np.ones(6))
    x, y, z = place.frame.origin
    start = FrameModel(camera, place.frame, parameters, (float(x), float(y), float(z)), notes)
    dip = centre_dip(start)
    if dip is None or not dip > 0.0:
        raise InputError(
            "the photo looks at the sky: its centre ray does not go below the horizon"
            + (f" but {-dip:.1f}° above it" if dip is not None else ""),
            where=where,
            mend=f"check the angle system ({', '.join(SYSTEMS)}), angle_unit, the direction of a matrix, and whether "
            f"a roll or omega near 180° turns the camera over",
        )
    seed, distance = _ground_ahead(start, crs, place.height, ground)
    focal = float(np.sqrt(camera.focal[0] * camera.focal[1]))
    steps = np.array([distance / focal] * 3 + [float(np.degrees(1.0 / focal))] * 3)
    return replace(start, parameters=replace(parameters, steps=steps), seed=seed)


def _ground_ahead(
    model: FrameModel, crs: CRS, height: float, ground: float | None
) -> tuple[tuple[float, float, float], float]:
    """Ground point on the centre ray in the model's CRS, and its distance in the model's unit.

    The ray is followed down to the height of the ground, and on by what is missing, until it is there; a ray that
    hardly goes down stops after twenty flying heights.
    """
    w, h = model.size
    origin, direction = (a[0] for a in model.rays(np.array([[w / 2, h / 2]])))
    dip = np.sin(np.radians(centre_dip(model) or 90.0))
    level = geographic(crs) if crs.is_geocentric else crs
    to_level = Transform(model.crs, level)
    if crs.is_geocentric:
        height = float(to_level(origin[None])[0, 2])
    unit = 1.0 if not model.crs.is_geocentric else float(level.axis_info[-1].unit_conversion_factor)
    if ground is None:
        ground = 0.0 if height * unit > 1.0 else height - GUESSED_HEIGHT / unit
    above = (height - ground) * unit
    distance = min(above / dip, FARTHEST * above)
    for _ in range(8):
        here = to_level((origin + distance * direction)[None])[0, 2]
        if not np.isfinite(here):
            break
        distance = float(np.clip(distance + (here - ground) * unit / dip, 0.1 * above, FARTHEST * above))
    x, y, z = origin + distance * direction
    return (float(x), float(y), float(z)), distance
