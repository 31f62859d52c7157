"""The camera of a photo, from a table, a file or a reconstruction."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from geomosaic.errors import SensorInputError
from geomosaic.sensor.inputs import choice, known_keys, need, numbers, table_of
from geomosaic.sensor.plugin import SensorRequest
from geomosaic_frame.camera import Camera
from geomosaic_frame.camera_capabilities import CameraModel
from geomosaic_frame.orientation import DIRECTIONS, FRAMES
from geomosaic_frame.other_programs import READERS, WORLDS, read_reconstruction

FILM_OPTIONS = ("fiducials", "interior", "mirrored")


def camera_and_orientation(request: SensorRequest) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """Camera table and orientation row of a photo, from its options or from a reconstruction.

    Parameters
    ----------
    request : SensorRequest

    Returns
    -------
    camera : mapping
        As in `camera.toml`.
    row : mapping
        Orientation as in a table of orientations; empty where control points are to place the photo.

    Raises
    ------
    InputError
        The camera or the orientation is missing, or a file cannot be read.
    """
    where, options = request.image, request.options
    if options.get("points") is not None:
        row: dict[str, Any] = {}
    else:
        row = dict(table_of(need(options, "orientation", where, "system and angles"), "orientation", where))
    table = options.get("camera")
    if row.get("system") in READERS and "reconstruction" in row:
        known_keys(row, ("system", "reconstruction"), where)
        path = Path(request.base) / str(row["reconstruction"])
        own, row = read_reconstruction(path, request.image, str(row["system"]), where)
        table = own if table is None else table
        _place_world(row, options, where)
    if isinstance(table, str):
        table = _toml(Path(request.base) / table, f"{where}, camera")
    if table is None:
        raise SensorInputError(
            "'camera' is missing",
            name="camera",
            where=where,
            hint="give the camera's table or the name of a camera.toml file",
        )
    for option, key, words in (("matrix", "matrix", DIRECTIONS), ("angle_frame", "frame", FRAMES)):
        if options.get(option) is not None and row:
            row.setdefault(key, choice(options[option], words, option, where))
    return table_of(table, "camera", where), row


def _place_world(row: dict[str, Any], options: Mapping[str, Any], where: str) -> None:
    """Completion of a pose with options on its world, where its file does not name it or names it wrongly."""
    system = str(row["system"])
    if system in ("opensfm", "odm"):
        return
    if options.get("world") is not None:
        row["world"] = choice(options["world"], WORLDS, "world", where)
    elif system == "colmap":
        raise SensorInputError(
            "COLMAP's files do not say what their world is",
            name="world",
            where=where,
            hint="say it under [sensor]: world = 'map' (the CRS that is named), 'geocentric', or 'local' with "
            "reference = [longitude, latitude, altitude]",
        )
    row.setdefault("world", "map")
    if options.get("reference") is not None:
        row["reference"] = numbers(options["reference"], 3, "reference", where)
    if options.get("offset") is not None:
        shift = numbers(options["offset"], 3, "offset", where)
        # Programs count from an offset to save digits; the CRS needs the whole coordinates.
        row["position"] = [a + b for a, b in zip(row["position"], shift, strict=True)]


def _toml(path: Path, where: str) -> Mapping[str, Any]:
    try:
        values = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SensorInputError(f"the camera file {path} cannot be read: {error}", name="camera", where=where) from error
    inner = values.get("camera")
    return inner if isinstance(inner, dict) and len(values) == 1 else values


def camera_of(table: Mapping[str, Any], request: SensorRequest) -> tuple[CameraModel, list[str]]:
    """Camera of the image at hand, scaled to a reduced copy.

    Parameters
    ----------
    table : mapping
        As in `camera.toml`.
    request : SensorRequest
        Size in pixels, options on film.

    Returns
    -------
    camera : CameraModel
    notes : list of str
        What was done to it.

    Raises
    ------
    InputError
        The table is not complete or does not fit the image, or options on film are given for a digital camera.
    """
    where = f"{request.image}, camera"
    if "fiducials" in table:
        from geomosaic_frame.fiducials import film_camera

        return film_camera(table, request, where)
    for key in FILM_OPTIONS:
        if request.options.get(key) is not None:
            raise SensorInputError(
                f"'{key}' is about film, but the camera has no fiducials",
                name="fiducials",
                where=request.image,
                hint="give the camera's calibration certificate, with the table [fiducials] in mm",
            )
    full = Camera.from_table(table, request.size, where)
    camera = full.scaled(request.size, where)
    camera.warn_of_fold(where)
    if camera is full:
        return camera, []
    w, h = full.size
    factor = w / camera.size[0]
    return camera, [f"the image is a copy of the camera's {w} x {h} pixels, reduced by {factor:g}: camera scaled to it"]
