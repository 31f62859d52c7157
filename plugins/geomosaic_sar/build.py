"""Radar model of one image: from its metadata, corrected by control points."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from geomosaic.errors import InputError, SolveError
from geomosaic.geo.transform import Transform
from geomosaic.raster.info import corner_in_scene
from geomosaic.sensor.inputs import choice, flag, point_rows, scene_offset
from geomosaic.sensor.plausibility import require_vertical_datum
from geomosaic.sensor.plugin import SensorRequest
from geomosaic.sensor.solve import resect_control
from geomosaic.types import FloatArray
from geomosaic_sar.calibration import CALIBRATIONS
from geomosaic_sar.metadata import find_beside, read_metadata
from geomosaic_sar.model import ECEF, KINDS, SarModel
from geomosaic_sar.scene_calibration import scene_calibration

POINT = ("x", "y", "z", "col", "row")


def build_sar(request: SensorRequest) -> SarModel:
    """Radar model of one image, from its metadata.

    Parameters
    ----------
    request : SensorRequest
        Image with its file, size in pixels, CRS of the control points, and the options of the sensor.

    Returns
    -------
    SarModel
        Geocentric, in metres.

    Raises
    ------
    InputError
        An input is missing, unknown or out of range; names the image and the input.
    SolveError
        The control points do not determine the corrections.
    """
    where, options = request.image, request.options
    points = options.get("points")
    kind = choice(options.get("refine", "shift"), KINDS, "refine", where)
    wanted = choice(options.get("calibration", "none"), CALIBRATIONS, "calibration", where)
    denoised = flag(options, "noise_removal", where)
    if denoised and wanted == "none":
        raise InputError(
            "noise_removal would do nothing without a calibration", where=where,
            hint=f"give calibration = one of {', '.join(CALIBRATIONS[1:])}, or leave noise_removal out",
        )  # fmt: skip
    given = options.get("metadata")
    if given is not None and not isinstance(given, str):
        raise InputError(
            f"metadata = {given!r} is not a file name", where=where, hint="give the name of the metadata file"
        )
    file = find_beside(request.path) if given is None else Path(request.base) / given
    if file is None:
        raise InputError(
            "there are no radar metadata beside the image",
            where=where,
            hint="give metadata = FILE: the annotation of Sentinel-1, the main XML of TerraSAR-X, or a JSON table",
        )
    try:
        scene = read_metadata(file)
    except InputError as error:
        error.where = f"{where} ({error.where})"
        raise
    corner = corner_in_scene(request.path) if request.path is not None else None
    col, row = scene_offset(options.get("offset"), request.size, scene.size, scene.title, corner, where)
    model = SarModel.of(
        scene.geometry.cut(col, row),
        request.size,
        kind,
        height=scene.height,
        where=where,
        notes=(scene.title, *scene.notes),
    )
    if wanted != "none":
        found = scene_calibration(file, scene, wanted, denoised=denoised, image=request.path or request.image)
        removed = "without" if denoised else "with its"
        model = replace(
            model, calibration=found.cut(col, row), notes=(*model.notes, f"{found.quantity}, {removed} thermal noise")
        )
    return _refined(model, request) if points and kind != "none" else model


def _refined(model: SarModel, request: SensorRequest) -> SarModel:
    """Model corrected by control points; wrong ones are named and left out."""
    where = request.image
    if request.crs is None:
        raise InputError("the control points have no CRS", where=where, hint="name it, e.g. EPSG:32633")
    require_vertical_datum(request.crs, "the control points", where, lambda _: model)
    names, rows = point_rows(request.options["points"], POINT, where)
    table = np.array(rows)
    ground = Transform(request.crs, ECEF)(table[:, :3])
    _require_place(model, ground, where)
    known = all("sigma" in point for point in request.options["points"])
    try:
        found = resect_control(model, ground, table[:, 3:5], table[:, 5] if known else None, names)
    except SolveError as error:
        error.where = where
        raise
    found.warn(where)
    solved = found.solved.model
    return replace(solved, notes=(*solved.notes, found.summary(names)), left_out=found.left_out)


def _require_place(model: SarModel, ground: FloatArray, where: str) -> None:
    """Check that some of the control points are where the orbit passes."""
    image = model.ground_to_image(ground)
    reach = np.array(model.size)
    if not ((image > -reach) & (image < 2 * reach)).all(axis=1).any():
        raise InputError(
            "no control point lies near the scene: its orbit passes none of them at the ranges of the image",
            where=where,
            hint="check that metadata and points are of this place, the CRS of the points and the order of x and y",
        )
