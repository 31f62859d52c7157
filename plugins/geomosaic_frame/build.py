"""Frame model of a photo from its camera, position and orientation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError, SensorInputError
from geomosaic.geo.crs import has_heights, with_heights
from geomosaic.geo.local_frames import is_free
from geomosaic.sensor.inputs import choice, flag, need, number, numbers
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.types import FloatArray
from geomosaic_frame.camera_capabilities import CameraModel
from geomosaic_frame.cameras import camera_and_orientation, camera_of
from geomosaic_frame.initial_model import allows_any_view, frame_model
from geomosaic_frame.model import FrameModel
from geomosaic_frame.orientation import FULL_CIRCLE, Attitude, read_attitude
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
from geomosaic_frame.ray_corrections import omitted_corrections, requested_correction

TREATMENTS = ("rigorous", "planar")


def build_frame(request: SensorRequest) -> FrameModel:
    """Frame model of one photo.

    Parameters
    ----------
    request : SensorRequest
        Image size in pixels, CRS of the position or of the control points, and the options of the sensor.

    Returns
    -------
    FrameModel

    Raises
    ------
    InputError
        An input is missing, unknown or out of range, or the photo looks at the sky; names the image and the input.
    """
    where, options = request.image, request.options
    table, row = camera_and_orientation(request)
    camera, notes = camera_of(table, request)
    unit = choice(options.get("angle_unit", "deg"), FULL_CIRCLE, "angle_unit", where)
    treatment = choice(options.get("treatment", _usual(request.crs)), TREATMENTS, "treatment", where)
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
    bending, said = requested_correction(options, crs, position, ground, treatment, where)
    notes += said or omitted_corrections(camera, crs, position, ground, treatment)
    return frame_model(camera, place, crs, ground, options, tuple(notes), bending, where)


def _usual(crs: CRS | None) -> str:
    """Treatment where none is given: a local frame that is nowhere on the Earth has but one."""
    return "planar" if crs is not None and is_free(crs) else "rigorous"


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
        crs: CRS = attitude.crs
        return crs
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
