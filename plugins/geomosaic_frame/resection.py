"""Space resection: place and attitude of a photo from control points, with no initial values.

Grunert's solutions of three points start a least squares adjustment over all of them (`geomosaic.sensor.solve`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import GeomosaicError, InputError, SensorInputError, SolveError, counted, warn
from geomosaic.estimation.expected_errors import residual_text
from geomosaic.estimation.statistics import correlations
from geomosaic.geo.crs import geocentric
from geomosaic.geo.transform import Transform
from geomosaic.sensor.inputs import flag, known_keys, need, number, numbers, positive, table_of
from geomosaic.sensor.ray_corrections import requested_correction
from geomosaic.sensor.solve import (
    ControlResection,
    Pose,
    Resection,
    dangerous_cylinder,
    poses,
    resect,
    resect_control,
)
from geomosaic.types import FloatArray
from geomosaic_frame.camera import CameraModel
from geomosaic_frame.film import omitted_corrections
from geomosaic_frame.model import NAMES, FrameModel
from geomosaic_frame.orientation import FLIP, Attitude
from geomosaic_frame.placement import local_frame, need_heights, planar, rigorous
from geomosaic_frame.start import allows_any_view, frame_model

COLUMNS = ("x", "y", "z", "col", "row")
# Pixels on the ground per pixel of measurement: a centre less certain than that is reported as badly determined.
WEAK = 50.0
# Multiple of the least sigma0 up to which solutions are about as good.
ALIKE = 3.0
# Share of the dangerous cylinder's radius within which a centre is reported to be near it.
NEAR = 0.1


def _read_points(given: Any, where: str) -> tuple[list[str], FloatArray, FloatArray, FloatArray]:
    """Names, ground (N, 3), image (N, 2) and sigmas (N,), both pixels, of three or more tables of control points."""
    if isinstance(given, str) or not isinstance(given, Sequence):
        raise SensorInputError(
            f"points = {given!r} is not a list of tables",
            name="points",
            where=where,
            hint="give points = [{x, y, z, col, row}, ...]",
        )
    names, rows = list[str](), []
    for i, item in enumerate(given):
        table, here = table_of(item, f"points[{i}]", where), f"{where}, points[{i}]"
        known_keys(table, ("id", *COLUMNS, "sigma"), here)
        names.append(str(table.get("id", i + 1)))
        row = [number(need(table, key, here, "ground in the CRS, image in pixels"), key, here) for key in COLUMNS]
        rows.append([*row, positive(table.get("sigma", 1.0), "sigma", here)])
    if len(rows) < 3:
        raise SensorInputError(
            f"{counted(len(rows), 'control point')} do{'es' * (len(rows) == 1)} not place a photo",
            name="points",
            where=where,
            hint="give three; a fourth is a check",
        )
    values = np.array(rows)
    return names, values[:, :3], values[:, 3:5], values[:, 5]


def resect_photo(
    camera: CameraModel,
    crs: CRS,
    treatment: str,
    ground: float | None,
    options: Mapping[str, Any],
    notes: tuple[str, ...],
    where: str,
) -> FrameModel:
    """Space resection: model of a photo from its control points.

    Parameters
    ----------
    camera : CameraModel
    crs : CRS
        3-D, of the points.
    treatment : str
        'rigorous' or 'planar'.
    ground : float or None
        Mean height of the ground; that of the points where not given.
    options : mapping
        With `points`.
    notes : tuple of str
        On the camera.
    where : str
        Named in errors.

    Returns
    -------
    FrameModel
        With notes on its fit.

    Raises
    ------
    InputError
        Points are missing or no numbers, or they do not place the photo; says why.
    """
    if options.get("orientation") is not None:
        raise SensorInputError(
            "both 'points' and 'orientation' are given", name="points", where=where, hint="give one of them"
        )
    if flag(options, "scale_correction", where):
        raise SensorInputError(
            "scale_correction is about given positions, not about points",
            name="scale_correction",
            where=where,
            hint="leave it out",
        )
    names, known, image, sigmas = _read_points(options["points"], where)
    # Three points allow up to four places of the camera, and only a rough position tells them apart.
    near = options.get("position")
    if near is not None:
        if len(known) > 3:
            raise InputError(
                "position chooses among the places that three points allow, and more points allow one",
                where=where,
                hint="leave position out",
            )
        near = np.array(numbers(near, 3, "position", where))
    need_heights(crs, known[0], float(np.hypot(*camera.size)) / 2, where)
    xyz = known if treatment == "planar" else Transform(crs, geocentric(crs))(known)
    if not np.isfinite(xyz).all():
        raise InputError("a control point has no place in the CRS", where=where, hint="check x, y, z and the CRS")

    def photo(pose: Pose, level: float) -> FrameModel:
        """The model at a pose, in a frame of its own, over ground at a height."""
        return _photo(camera, crs, treatment, level, options, pose, where)

    # A height that is wrong by kilometres moves the mean above the camera, and not the median.
    levels = [float(known[:, 2].mean()), float(np.median(known[:, 2]))] if ground is None else [ground]
    solved: list[ControlResection[FrameModel]] = []
    refused: GeomosaicError | None = None
    tried = poses(camera.directions(image), xyz)
    for pose, level in ((pose, level) for level in levels for pose in tried):
        if solved and level != levels[0]:
            break
        try:
            first = resect_control(photo(pose, level), xyz, image, sigmas, names)
            used = first.used
            mean = float(known[used, 2].mean()) if ground is None else ground
            # Once more about the centre found, so that the parameters are offsets of zero from it.
            final = resect(photo(Pose(*first.solved.model.pose), mean), xyz[used], image[used], sigmas[used])
        except (InputError, SolveError) as error:
            refused = error
            continue
        if np.isfinite(final.residuals).all():
            solved.append(replace(first, solved=final))
    if not solved:
        raise InputError(
            "the control points do not place the photo" + (f": {refused.what}" if refused else ": they are in line"),
            where=where,
            hint="check that the points are the ones measured, (col, row) in pixels, and their CRS",
        )
    found = _choose(solved, xyz, crs, near, where)
    found.warn(where)
    best, used = found.solved, found.used
    ground = float(known[used, 2].mean()) if ground is None else ground
    _warn_of_weakness(best, xyz[used], sigmas[used], where)
    model = best.model
    position = Transform(model.crs, crs)(model.centre[None])[0]
    applied = requested_correction(options, crs, position, ground, treatment == "planar", where)[1]
    corrections = applied or omitted_corrections(camera, crs, position, ground, treatment)
    summary = _summary(best, len(xyz), crs, options)
    return replace(model, notes=(*notes, *corrections, *summary), left_out=found.left_out)


def _photo(
    camera: CameraModel,
    crs: CRS,
    treatment: str,
    ground: float,
    options: Mapping[str, Any],
    pose: Pose,
    where: str,
) -> FrameModel:
    """Frame model at a pose, in a frame of its own at the projection centre."""
    rotation = FLIP @ pose.rotation
    if treatment == "planar":
        position = pose.centre
        place = planar(crs, position, Attitude(rotation, "grid"), where)
    else:
        position = Transform(geocentric(crs), crs)(pose.centre[None])[0]
        axes = local_frame(crs, position, where).axes
        place = rigorous(crs, position, Attitude(rotation @ axes.T, "local"), where)
    if not crs.is_geocentric and not allows_any_view(crs, options, where) and position[2] <= ground:
        raise InputError(
            "the camera would be below the ground",
            where=where,
            hint="check the heights of the points and of the ground, or whether the scan is mirrored",
        )
    ray_correction = requested_correction(options, crs, position, ground, treatment == "planar", where)[0]
    return frame_model(camera, place, crs, ground, options, (), ray_correction, where)


def _choose(
    solved: list[ControlResection[FrameModel]], xyz: FloatArray, crs: CRS, near: FloatArray | None, where: str
) -> ControlResection[FrameModel]:
    """Best of the solutions; with three points all fit, and several are an error that lists them."""
    if len(xyz) > 3:
        # Of those about as good the one that the most points agree with: a wrong pose may fit some of them.
        least = min(one.solved.sigma0 for one in solved)
        good = [one for one in solved if not one.solved.sigma0 > ALIKE * max(least, 1.0)]
        return min(good, key=lambda one: (len(one.left_out), float((one.solved.residuals**2).sum())))
    distinct = [solved[0]]
    for one in solved[1:]:
        centre = one.solved.model.centre
        apart = min(float(np.linalg.norm(centre - other.solved.model.centre)) for other in distinct)
        # A step is a pixel on the ground: centres a hundredth of it apart are one solution, reached twice.
        if apart > 0.01 * one.solved.model.parameters.steps[0]:
            distinct.append(one)
    to_map = Transform(distinct[0].solved.model.crs, crs)
    if near is not None:
        wanted = Transform(crs, distinct[0].solved.model.crs)(near[None])[0]
        return min(distinct, key=lambda one: float(np.linalg.norm(one.solved.model.centre - wanted)))
    if len(distinct) > 1:
        centres = [to_map(one.solved.model.centre[None])[0] for one in distinct]
        listed = "; ".join(f"({x:.2f}, {y:.2f}, {z:.2f})" for x, y, z in centres)
        raise InputError(
            f"three points fit {len(distinct)} places of the camera: {listed}",
            where=where,
            hint="give a fourth point, or position, roughly, to choose the nearest of them",
        )
    return distinct[0]


def _warn_of_weakness(one: Resection[FrameModel], xyz: FloatArray, sigmas: FloatArray, where: str) -> None:
    """Warning where the centre is on the dangerous cylinder, or as badly determined as if it were."""
    gap = dangerous_cylinder(one.model.centre, xyz) if len(xyz) == 3 else float("inf")
    worst = float(one.sigmas[:3].max())  # of the geometry alone, whatever the residuals are
    pixels = worst / float(one.model.parameters.steps[0] * np.median(sigmas))
    if not gap < NEAR and not pixels > WEAK:
        return
    cause = (
        f"the camera is near the dangerous cylinder through them ({100.0 * gap:.0f} % of its radius away)"
        if gap < NEAR
        else "they are too few, or too close together"
    )
    warn(
        f"{where}: the control points hardly determine the photo: {cause}; the projection centre is uncertain by "
        f"{worst:.2f} m, {pixels:.0f} pixels on the ground. Add points, one in the middle or at another height."
    )


def _summary(one: Resection[FrameModel], given: int, crs: CRS, options: Mapping[str, Any]) -> list[str]:
    count = len(one.residuals)
    rms = float(np.sqrt((one.residuals**2).sum(axis=1).mean()))
    exact = one.redundancy <= 0
    numbers = {"redundancy": one.redundancy, "observations": 2 * count, "solutions": 1, "without_redundancy": +exact}
    fit = residual_text(rms, numbers) + ("" if exact else f", sigma0 {one.sigma0:.2f}")
    rho = correlations(one.covariance)
    i, j = np.unravel_index(int(np.argmax(np.abs(np.triu(rho, 1)))), rho.shape)
    unit = "m" if (name := one.model.parameters.units[0]) == "metre" else name
    names = one.model.parameters.names
    place = ", ".join(f"{value:.2f}" for value in Transform(one.model.crs, crs)(one.model.centre[None])[0])
    sigmas = np.sqrt(np.diag(one.pooled_covariance))  # those of the orientation table, which rounds less
    length, angle = (", ".join(f"{s:.2g}" for s in part) for part in (sigmas[:3], sigmas[3:6]))
    about = " (along and about the image's x, its y and the camera's axis)" if allows_any_view(crs, options, "") else ""
    return [
        f"resected from {count}{f' of {given}' if count < given else ''} points: {fit}; projection centre {place}",
        f"sigmas of {', '.join(NAMES[:3])}{about}: {length} {unit}; of {', '.join(NAMES[3:])}: {angle} deg; largest "
        f"correlation {rho[i, j]:+.3f}, of {names[int(i)]} and {names[int(j)]}",
    ]
