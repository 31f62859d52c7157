"""Start of a photo at a place: its frame, a ground point that it shows, and what is known of its motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import SensorInputError
from geomosaic.geo.crs import geographic, is_local
from geomosaic.geo.engineering_crs import local_frame_crs
from geomosaic.geo.local_frames import LocalFrame, angles_of
from geomosaic.geo.transform import Transform
from geomosaic.geo.units import height_unit
from geomosaic.sensor.inputs import apriori_sigmas, flag, numbers
from geomosaic.sensor.plausibility import SkyError, centre_dip
from geomosaic.sensor.ray_corrections import RayCorrection
from geomosaic.types import FloatArray
from geomosaic_frame.camera import CameraModel
from geomosaic_frame.model import NAMES, FrameModel, parameters_of
from geomosaic_frame.orientation import FLIP, SYSTEMS
from geomosaic_frame.placement import Place
from geomosaic_frame.rolling_shutter import NAMES as MOTION
from geomosaic_frame.rolling_shutter import turn_of

GROUPS = {"position": NAMES[:3], "angles": NAMES[3:]}
MOTION_GROUPS = {"motion": MOTION[:3], "turn": MOTION[3:]}
# m/s that a camera with a rolling shutter may be faster than its velocity says: without one, that of any drone.
UNKNOWN_SPEED, GIVEN_SPEED = 15.0, 1.0
# Seed of a flat ray: at most this many flying heights away.
FARTHEST = 20.0
# Metres to whatever a photo without control points shows in a local frame: where searches start.
AHEAD = 10.0
# Flying height above an unknown ground where height 0 lies above the camera.
GUESSED_HEIGHT = 100.0


def _sigmas(camera: CameraModel, options: Mapping[str, Any], where: str) -> FloatArray:
    """A-priori sigmas of the parameters; the pose is free where none are given, and a motion as large as speeds are."""
    usual, groups = dict.fromkeys(NAMES, np.inf), GROUPS
    if camera.shutter is not None:
        groups = GROUPS | MOTION_GROUPS
        speed = GIVEN_SPEED if options.get("velocity") is not None else UNKNOWN_SPEED
        usual |= dict.fromkeys(MOTION[:3], speed * camera.shutter.readout_time) | dict.fromkeys(MOTION[3:], 0.0)
    if camera.deformation is not None:
        usual |= dict.fromkeys(camera.deformation.names, camera.deformation.sigma)
    return np.array(apriori_sigmas(options.get("sigmas", {}), usual, groups, where))


def _motion(
    camera: CameraModel, place: Place, pose: FloatArray, crs: CRS, options: Mapping[str, Any], where: str
) -> FloatArray:
    """Way of a photo during its readout (3,), in its local frame, and turn (3,), degrees; (0,) of a global shutter."""
    if camera.shutter is None:
        for name in ("velocity", "rates"):
            if options.get(name) is not None:
                raise SensorInputError(
                    f"'{name}' is given, and the camera has no rolling shutter",
                    name=name,
                    where=where,
                    hint=f"give the camera rolling_shutter = {{ readout_time = ... }}, or leave {name} out",
                )
        return np.zeros(0)
    turn, given = np.zeros(3), options.get("velocity")
    if options.get("rates") is not None:
        turning = np.array(numbers(options["rates"], 3, "rates", where)) * camera.shutter.readout_time
        turn = turn_of(pose[3:], turning)
    if given is None:
        return np.concatenate([np.zeros(3), turn])
    way = np.array(numbers(given, 3, "velocity", where)) * camera.shutter.readout_time
    origin, to_frame = place.frame.origin, Transform(crs, place.frame.crs)
    here = origin if crs == place.frame.crs else Transform(place.frame.crs, crs)(origin[None])[0]
    both = np.array([here, here + way])
    ends = both if crs == place.frame.crs else to_frame(both)
    return np.concatenate([place.frame.axes @ (ends[1] - ends[0]), turn])


def allows_any_view(crs: CRS, options: Mapping[str, Any], where: str) -> bool:
    """Whether a photo may look above the horizon: the option `upwards` says so, or its frame has no horizon.

    Parameters
    ----------
    crs : CRS
    options : mapping
    where : str
        Named in errors.
    """
    return is_local(crs) or flag(options, "upwards", where)


def frame_model(
    camera: CameraModel,
    place: Place,
    crs: CRS,
    ground: float | None,
    options: Mapping[str, Any],
    notes: tuple[str, ...],
    ray_correction: RayCorrection,
    where: str,
) -> FrameModel:
    """Frame model of a photo at a place, with seed and parameter steps.

    Parameters
    ----------
    camera : CameraModel
    place : Place
        Frame and rotation of the photo.
    crs : CRS
        3-D, of the position.
    ground : float, optional
        Height of the ground in the unit and vertical datum of `crs`.
    options : mapping
        With the a-priori `sigmas`, `upwards` and `points`.
    notes : tuple of str
        What was assumed so far.
    ray_correction : RayCorrection
        Refraction and curvature.
    where : str
        Named in errors.

    Returns
    -------
    FrameModel
        Position in the frame's unit, angles in degrees; steps of about a pixel.

    Raises
    ------
    SkyError
        The photo looks at the sky and may not.
    InputError
        The sigmas are wrong.
    """
    anywhere = allows_any_view(crs, options, where)
    if anywhere:
        # Omega, phi and kappa have no value where a camera looks along x: they count from the attitude given.
        turned = LocalFrame(place.frame.crs, place.frame.origin, place.rotation @ place.frame.axes)
        place = Place(turned, np.eye(3), place.height)
    pose = np.array([0.0, 0.0, 0.0, *np.degrees(angles_of(place.rotation))])
    film = () if camera.deformation is None else camera.deformation.values
    values = np.concatenate([pose, _motion(camera, place, pose, crs, options, where), film])
    sigmas = _sigmas(camera, options, where)
    parameters = parameters_of(camera, place.frame.crs, values, sigmas, 1.0)
    if camera.shutter is not None and options.get("velocity") is None:
        notes = (
            *notes,
            "rolling shutter: neither velocity nor times of the orientations are given, motion starts at 0",
        )
    x, y, z = place.frame.origin
    start = FrameModel(camera, place.frame, parameters, (float(x), float(y), float(z)), notes, ray_correction)
    dip = 90.0 if anywhere else centre_dip(start)
    if dip is None or not dip > 0.0:
        raise SkyError(
            "the photo looks at the sky: its centre ray does not go below the horizon"
            + (f" but {-dip:.1f}° above it" if dip is not None else ""),
            where=where,
            hint=f"check the angle system ({', '.join(SYSTEMS)}), angle_unit, the direction of a matrix, and whether "
            "a roll or omega near 180° turns the camera over; a photo of a facade that is right as it is needs "
            "upwards = true",
        )
    seed, distance = (
        _some_way_ahead(start, crs, options) if anywhere else _ground_ahead(start, crs, place.height, ground)
    )
    return replace(start, parameters=parameters_of(camera, place.frame.crs, values, sigmas, distance), seed=seed)


def unoriented_model(camera: CameraModel, options: Mapping[str, Any], notes: tuple[str, ...], where: str) -> FrameModel:
    """Frame model of a photo that knows its camera alone: at the origin of a frame without a place, looking down.

    Parameters
    ----------
    camera : CameraModel
    options : mapping
        With the a-priori `sigmas`.
    notes : tuple of str
        On the camera.
    where : str
        Named in errors.
    """
    crs, origin = local_frame_crs(), np.zeros(3)
    sigmas = _sigmas(camera, options, where)
    parameters = parameters_of(camera, crs, np.zeros(len(sigmas)), sigmas, AHEAD)
    start = FrameModel(camera, LocalFrame(crs, origin, np.eye(3)), parameters, (0.0, 0.0, 0.0), notes)
    return start.posed(origin, FLIP, np.array([0.0, 0.0, -AHEAD]))


def _some_way_ahead(
    model: FrameModel, crs: CRS, options: Mapping[str, Any]
) -> tuple[tuple[float, float, float], float]:
    """Point on the centre ray at the distance of the control points, else `AHEAD`, and that distance."""
    # A facade is no ground to look for; searches only start there.
    w, h = model.size
    origin, direction = (a[0] for a in model.rays(np.array([[w / 2, h / 2]])))
    points = options.get("points")
    distance = AHEAD
    if points:
        known = np.array([[point[key] for key in ("x", "y", "z")] for point in points], dtype=np.float64)
        known = known if model.crs == crs else Transform(crs, model.crs)(known)
        distance = max(float(np.median(np.linalg.norm(known - origin, axis=1))), 1e-6)
    x, y, z = origin + distance * direction
    return (float(x), float(y), float(z)), distance


def _ground_ahead(
    model: FrameModel, crs: CRS, height: float, ground: float | None
) -> tuple[tuple[float, float, float], float]:
    """Ground point on the centre ray in the model's CRS, and its distance in the model's unit."""
    # The ray is followed down to the height of the ground, and on by what is missing, until it is there; a ray that
    # hardly goes down stops after twenty flying heights.
    w, h = model.size
    origin, direction = (a[0] for a in model.rays(np.array([[w / 2, h / 2]])))
    dip = np.sin(np.radians(centre_dip(model) or 90.0))
    level = geographic(crs) if crs.is_geocentric else crs
    to_level = Transform(model.crs, level)
    if crs.is_geocentric:
        height = float(to_level(origin[None])[0, 2])
    # Distances along the ray are in the model's unit, heights in that of their CRS, which may be feet.
    unit = 1.0 if not model.crs.is_geocentric else height_unit(level)
    if ground is None:
        ground = 0.0 if height * unit > 1.0 else height - GUESSED_HEIGHT / unit
    above = (height - ground) * unit
    # A ray that hardly goes down would meet the ground behind the horizon, where no search should start.
    distance = min(above / dip, FARTHEST * above)
    for _ in range(8):
        here = to_level((origin + distance * direction)[None])[0, 2]
        if not np.isfinite(here):
            break
        distance = float(np.clip(distance + (here - ground) * unit / dip, 0.1 * above, FARTHEST * above))
    x, y, z = origin + distance * direction
    return (float(x), float(y), float(z)), distance
