"""Pushbroom model of a scene from metadata, a track, or control points alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.errors import InputError, SensorInputError, default_where
from geomosaic.geo.crs import geographic
from geomosaic.geo.transform import Transform
from geomosaic.raster.info import corner_in_scene
from geomosaic.sensor.inputs import apriori_sigmas, number, scene_offset
from geomosaic.sensor.plausibility import require_vertical_datum
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.solve import resect_control
from geomosaic.types import FloatArray
from geomosaic_pushbroom.metadata import find_beside, metadata_in_folder, read_metadata
from geomosaic_pushbroom.model import ECEF, PushbroomModel, initial_model
from geomosaic_pushbroom.platform import CORRECTIONS, HIGHEST_DEGREE, ReportedFlight
from geomosaic_pushbroom.points import ImageControl, need_crs, read_points
from geomosaic_pushbroom.scene_metadata import AprioriSigmas, SceneMetadata
from geomosaic_pushbroom.track import read_track
from geomosaic_pushbroom.without_metadata import model_from_control

GROUPS = {"angles": CORRECTIONS[:3], "rates": CORRECTIONS[3:6], "position": CORRECTIONS[6:9]}
OF_TRACK = ("start_time", "line_period", "columns", "angle_unit")
OF_POINTS = ("flying_height", "additional")


def build_pushbroom(request: SensorRequest) -> PushbroomModel:
    """Pushbroom model of one image: from metadata, a track, or control points alone.

    Parameters
    ----------
    request : SensorRequest
        Image with its file, size in pixels, CRS of track and control points, and the options of the sensor.

    Returns
    -------
    PushbroomModel
        Geocentric, in metres; pixel origin at the outer corner of the upper-left pixel.

    Raises
    ------
    InputError
        An input is missing, unknown or out of range; names the image and the input.
    SolveError
        The control points do not determine the model.
    """
    where, options = request.image, request.options
    control = read_points(options["points"], where) if options.get("points") is not None else None
    if options.get("refine", "points") not in ("points", "none"):
        raise InputError(f"refine = {options['refine']!r}", where=where, hint="choose from: points, none")
    metadata = _metadata(request)
    if request.crs is not None and (control is not None or options.get("track") is not None):
        whose = "the track" if control is None else "the control points"
        require_vertical_datum(request.crs, whose, where, lambda crs: build_pushbroom(replace(request, crs=crs)))
    way = "metadata" if metadata else "track" if options.get("track") is not None else "points"
    _need_only(options, way, where)
    if metadata is not None:
        band = options.get("band")
        try:
            # A band may be given as a number, and metadata name bands by text.
            reported = read_metadata(metadata, None if band is None else str(band))
        except InputError as error:
            error.where = f"{where} ({error.where})"
            raise
        model = of_scene(reported, request)
    elif way == "track":
        model = _of_track(request)
    else:
        if control is None:
            raise InputError(
                "there is neither metadata nor a track nor control points",
                where=where,
                hint=_where_metadata(request.path),
            )
        return model_from_control(request, control)
    if control is None or options.get("refine", "points") == "none":
        return model
    return _refined(model, control, request)


def _where_metadata(image: str | None) -> str:
    """Hint that names the metadata beside an image, whatever their names."""
    others = "track = FILE, or control points"
    beside = metadata_in_folder(image)
    scenes = [f"{file.name} ({size[0]} x {size[1]} pixels)" for file, size in beside.items() if size]
    if scenes:
        return f"beside it there are metadata of {', '.join(scenes)}: give metadata = FILE, {others}"
    if beside:
        name = next(iter(beside)).name
        return f"{name} beside it has no orbit and attitude: use the sensor 'rpc' if it has an RPC, or give {others}"
    return f"put its metadata beside the image (METADATA.DIM, DIM_....XML), or give metadata = FILE, {others}"


def _metadata(request: SensorRequest) -> Path | None:
    """Metadata file that the inputs name, or the one beside the image; None for a track or metadata = none."""
    given = request.options.get("metadata")
    if given is None:
        return None if request.options.get("track") is not None else _beside(request)
    if not isinstance(given, str):
        raise InputError(
            f"metadata = {given!r} is not a file name",
            where=request.image,
            hint="give the name of the metadata file, or 'none'",
        )
    return None if given == "none" else Path(request.base) / given


def _beside(request: SensorRequest) -> Path | None:
    """Metadata beside the image by its name, else the only one that is of a scene of its size."""
    named = find_beside(request.path)
    fitting = [] if named else [f for f, size in metadata_in_folder(request.path).items() if size == request.size]
    return fitting[0] if len(fitting) == 1 else named


def _need_only(options: Mapping[str, Any], way: str, where: str) -> None:
    """Check that no input would have no effect for the way the model is made."""
    foreign = {
        "metadata": (*OF_TRACK, *OF_POINTS, "focal_length_px", "principal_col", "track"),
        "track": (*OF_POINTS, "band", "offset"),
        "points": (*OF_TRACK, "band", "offset", "sigmas", "attitude_degree"),
    }[way]
    odd = [name for name in foreign if options.get(name) is not None and name != "angle_unit"]
    if odd:
        raise InputError(
            f"{odd[0]} has no meaning for a model from {way}",
            where=where,
            hint="leave it out" + (", or give metadata = none" if way == "metadata" else ""),
        )


def of_scene(reported: SceneMetadata, request: SensorRequest) -> PushbroomModel:
    """Model of a whole scene or of a cut of it, from its metadata.

    Parameters
    ----------
    reported : SceneMetadata
        Of the whole scene.
    request : SensorRequest
        Image of the scene, or of a cut whose upper-left corner is the option `offset`, (col, row) in the scene.

    Returns
    -------
    PushbroomModel
        With a-priori sigmas of the mission for its corrections.

    Raises
    ------
    InputError
        The image is not of the scene's size and no offset is given, or it reaches beyond the scene.
    """
    where, size = request.image, request.size
    corner = corner_in_scene(request.path) if request.path is not None else None
    col, row = scene_offset(request.options.get("offset"), size, reported.size, reported.title, corner, where)
    height = reported.size[1]
    look = replace(reported.look, cols=reported.look.cols - col)
    flight = ReportedFlight(reported.path, reported.period, reported.middle - row)
    flight = _curved(flight, request.options, 0.5 * height * reported.period, where)
    sigmas = _sigmas(request.options, reported.quality, flight, where)
    notes = (reported.title, *reported.notes)
    height_of_ground = _ellipsoidal(request)
    model = initial_model(flight, look, size, np.zeros(len(sigmas)), sigmas, height_of_ground, where)
    return replace(model, notes=notes)


def _of_track(request: SensorRequest) -> PushbroomModel:
    """Model of a strip from the track of its flight."""
    flight, look, quality = read_track(request)
    flight = _curved(flight, request.options, flight.middle * flight.period, request.image)
    sigmas = _sigmas(request.options, quality, flight, request.image)
    height = _ellipsoidal(request, flight)
    return initial_model(flight, look, request.size, np.zeros(len(sigmas)), sigmas, height, request.image)


def _ellipsoidal(request: SensorRequest, flight: ReportedFlight | None = None) -> float:
    """Rough ellipsoidal height of the ground; a geoid's undulation is of no matter for a start."""
    given = request.options.get("ground_height")
    height = 0.0 if given is None else number(given, "ground_height", request.image)
    if flight is not None and given is None:
        # A flight below height 0, or over high ground of unknown height: half a kilometre down will do.
        position = flight.path.pose(np.zeros(1)).position
        z = Transform(ECEF, geographic(ECEF))(position)[0, 2]
        height = float(min(height, z - 500.0))
    return height


def _curved(flight: ReportedFlight, options: Mapping[str, Any], half: float, where: str) -> ReportedFlight:
    """Flight whose corrections of the attitude are polynomials over the scene, where that is asked for."""
    degree = options.get("attitude_degree", 1)
    if not isinstance(degree, int) or not 1 <= degree <= HIGHEST_DEGREE:
        raise SensorInputError(
            f"attitude_degree = {degree!r} is not a whole number from 1 to {HIGHEST_DEGREE}",
            name="attitude_degree",
            where=where,
            hint="1 corrects each angle and its rate; 2 and more also what bends over the scene",
        )
    return replace(flight, half=half, degree=degree)


def _sigmas(options: Mapping[str, Any], quality: AprioriSigmas, flight: ReportedFlight, where: str) -> FloatArray:
    """A-priori sigmas of the corrections: those of the mission, then groups, then single ones."""
    groups = {**GROUPS, **({"curve": flight.names[len(CORRECTIONS) :]} if flight.degree > 1 else {})}
    # A curve may be as large as what the sigma of a rate makes in half a scene.
    known = {**vars(quality), "curve": quality.rates * flight.half}
    usual = dict.fromkeys(flight.names, 0.0)
    for group, names in groups.items():
        usual |= dict.fromkeys(names, known[group])
    return np.array(apriori_sigmas(options.get("sigmas", {}), usual, groups, where))


def _refined(model: PushbroomModel, control: ImageControl, request: SensorRequest) -> PushbroomModel:
    """Model with the reported flight corrected by control points, each parameter within its sigma."""
    xyz = Transform(need_crs(request), model.crs)(control.xyz)
    with default_where(request.image):
        found = resect_control(model, xyz, control.colrow, control.sigmas, control.names)
    return found.noted(control.names, request.image)
