"""Frame model of a photo from its camera, position and orientation; cameras from tables, files and reconstructions."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError, SensorInputError
from geomosaic.geo.crs import has_heights, is_local, with_heights
from geomosaic.sensor.inputs import camera_file, choice, flag, known_keys, need, number, numbers, table_of
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.ray_corrections import requested_correction
from geomosaic.types import FloatArray
from geomosaic_frame.camera import KEYS, Camera, CameraModel
from geomosaic_frame.model import FrameModel
from geomosaic_frame.orientation import DIRECTIONS, FRAMES, FULL_CIRCLE, Attitude, read_attitude
from geomosaic_frame.other_programs import READERS, WORLDS, orthority_table, read_reconstruction
from geomosaic_frame.placement import (
    from_geocentric,
    from_offset,
    from_topocentric,
    need_heights,
    of_longitude_latitude,
    planar,
    rigorous,
    undo_linear_alteration,
)
from geomosaic_frame.start import allows_any_view, frame_model, unoriented_model

FILM_OPTIONS = ("fiducials", "fiducial_sigma", "interior", "mirrored")


def _camera_and_orientation(request: SensorRequest) -> tuple[Mapping[str, Any], Mapping[str, Any]]:
    """Camera table and orientation row of a photo, from its options or from a reconstruction."""
    where, options = request.image, request.options
    if options.get("points") is not None or flag(options, "unoriented", request.image):
        row: dict[str, Any] = {}
    else:
        row = dict(table_of(need(options, "orientation", where, "system and angles"), "orientation", where))
    table = options.get("camera")
    if isinstance(row.get("system"), str) and row["system"] in READERS and "reconstruction" in row:
        known_keys(row, ("system", "reconstruction"), where)
        path = Path(request.base) / str(row["reconstruction"])
        own, row = read_reconstruction(path, request.image, str(row["system"]), where)
        table = own if table is None else table
        _place_world(row, options, where)
    if isinstance(table, str):
        try:
            table = camera_file(Path(request.base) / table)
        except InputError as error:
            error.where = f"{where}, camera ({error.where})"
            raise
    if table is None:
        raise SensorInputError(
            "'camera' is missing",
            name="camera",
            where=where,
            hint="give the camera's table, or the name of a camera.toml or of orthority's YAML",
        )
    for option, key, words in (("matrix", "matrix", DIRECTIONS), ("angle_frame", "frame", FRAMES)):
        if options.get(option) is not None and row:
            row.setdefault(key, choice(options[option], words, option, where))
    return orthority_table(table_of(table, "camera", where), f"{where}, camera"), row


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


def check_camera_keys(table: Mapping[str, Any], where: str) -> None:
    """Check of the keys of a camera description: of a digital camera, or of a film camera's certificate.

    Parameters
    ----------
    table : mapping
        As in `camera.toml`; cameras of orthority, which have a `focal_len`, are checked when they are converted.
    where : str
        Named in errors.

    Raises
    ------
    SensorInputError
        Names an unknown key, and the nearest one that exists.
    """
    from geomosaic_frame import certificate

    if not any("focal_len" in one for one in (table, *table.values()) if isinstance(one, Mapping)):
        known_keys(table, dict.fromkeys((*KEYS, *certificate.KEYS)), where)


def _camera_of(table: Mapping[str, Any], request: SensorRequest) -> tuple[CameraModel, list[str]]:
    """Camera of the image at hand, scaled to a reduced copy, and notes on what was done to it."""
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


TREATMENTS = ("rigorous", "planar")


def build_frame(request: SensorRequest) -> FrameModel:
    """Frame model of one photo.

    Parameters
    ----------
    request : SensorRequest
        Image size in pixels, CRS of the position or of the control points, and the options of the sensor.

    Raises
    ------
    InputError
        An input is missing, unknown or out of range, or the photo looks at the sky; names the image and the input.
    """
    where, options = request.image, request.options
    table, row = _camera_and_orientation(request)
    camera, notes = _camera_of(table, request)
    # What a table of orientations tells is of use to a rolling shutter, and none to others.
    moving = {key: row[key] for key in ("velocity", "rates") if key in row}
    if camera.shutter is not None:
        options = moving | {k: v for k, v in options.items() if v is not None}
    row = {key: value for key, value in row.items() if key not in moving}
    if flag(options, "unoriented", where):
        for name in ("position", "orientation", "points"):
            if options.get(name) is not None:
                raise SensorInputError(
                    f"'{name}' is given for a photo that is unoriented", name=name, where=where, hint="leave one out"
                )
        return unoriented_model(camera, options, tuple(notes), where)
    unit = choice(options.get("angle_unit", "deg"), FULL_CIRCLE, "angle_unit", where)
    # A local frame that is nowhere on the Earth has but one.
    usual = "planar" if request.crs is not None and is_local(request.crs) else "rigorous"
    treatment = choice(options.get("treatment", usual), TREATMENTS, "treatment", where)
    ground = (
        number(options["ground_height"], "ground_height", where) if options.get("ground_height") is not None else None
    )
    if options.get("points") is not None:
        from geomosaic_frame.resection import resect_photo

        return resect_photo(camera, _named(request), treatment, ground, options, tuple(notes), where)
    attitude = read_attitude(row, unit, where)
    crs = _crs(request, attitude)
    anywhere = allows_any_view(crs, options, where)
    position, attitude = _position(crs, row, attitude, camera, options, where)
    # Geocentric z is no height, and a facade may lie above the camera.
    if ground is not None and not crs.is_geocentric and not anywhere and position[2] <= ground:
        raise InputError(
            f"the camera, at height {position[2]:.2f}, is not above the ground at {ground:.2f}",
            where=where,
            hint="check z, ground_height and their vertical datum",
        )
    if flag(options, "scale_correction", where):
        position, note = _unscaled(crs, position, ground, treatment, where)
        notes.append(note)
    place = (planar if treatment == "planar" else rigorous)(crs, position, attitude, where)
    correction, notes_of = requested_correction(options, crs, position, ground, treatment == "planar", where)
    if "fiducials" in table and not notes_of:
        from geomosaic_frame.film import omitted_corrections

        notes_of = omitted_corrections(camera, crs, position, ground, treatment)
    notes += notes_of
    return frame_model(camera, place, crs, ground, options, tuple(notes), correction, where)


def _position(
    crs: CRS, row: Mapping[str, Any], attitude: Attitude, camera: CameraModel, options: Mapping[str, Any], where: str
) -> tuple[FloatArray, Attitude]:
    """Projection centre in `crs`, and the attitude about it."""
    if attitude.position is None:
        given = need(options, "position", where, "the projection centre [x, y, z] in the CRS of the positions")
        position = np.array(numbers(given, 3, "position", where))
        need_heights(crs, position, _reach(camera), where)
        return position, attitude
    if options.get("position") is not None:
        raise InputError("position is given, but the orientation has its own", where=where, hint="leave it out")
    if attitude.frame == "geocentric":
        return from_geocentric(crs, attitude, where)
    if attitude.frame == "map":
        need_heights(crs, attitude.position, _reach(camera), where)
        if crs.is_geocentric:
            return from_geocentric(crs, attitude, where)
        return attitude.position, Attitude(attitude.rotation, "grid")
    lla = np.array(numbers(need(row, "reference", where, "longitude, latitude, altitude"), 3, "reference", where))
    reference = of_longitude_latitude(crs, lla)
    need_heights(crs, reference, _reach(camera), where)
    bring = from_topocentric if attitude.frame == "topocentric" else from_offset
    return bring(crs, reference, attitude, where)


def _reach(camera: CameraModel) -> float:
    return float(np.hypot(*camera.size)) / 2


def _crs(request: SensorRequest, attitude: Attitude) -> CRS:
    if request.crs is not None:
        # Geocentric positions say themselves how high they are.
        ellipsoidal = attitude.frame == "geocentric" and not has_heights(request.crs)
        return with_heights(request.crs, "ellipsoidal") if ellipsoidal else request.crs
    if attitude.crs is not None:
        return attitude.crs
    if attitude.frame == "topocentric":
        return CRS.from_epsg(4979)  # OpenSfM's own definition of its reference
    return _named(request)


def _named(request: SensorRequest) -> CRS:
    if request.crs is not None:
        return request.crs
    raise InputError(
        "the positions have no CRS", where=request.image, hint="name one with a vertical datum, for example EPSG:32633"
    )


def _unscaled(
    crs: CRS, position: FloatArray, ground: float | None, treatment: str, where: str
) -> tuple[FloatArray, str]:
    if treatment == "planar":
        raise SensorInputError(
            "scale_correction undoes what the planar treatment needs",
            name="scale_correction",
            where=where,
            hint="use treatment = 'rigorous'",
        )
    if ground is None:
        raise SensorInputError(
            "scale_correction needs to know the height of the ground",
            name="scale_correction",
            where=where,
            hint="give ground_height, the mean height of the ground under the photo in the vertical datum of the "
            "positions",
        )
    true = undo_linear_alteration(crs, position, ground, where)
    moved = true[2] - position[2]
    return true, f"linear alteration undone about {ground:.1f}: projection centre moved by {moved:+.3f} in height"
