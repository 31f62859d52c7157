"""Camera and orientation of one image from an OpenSfM or OpenDroneMap `reconstruction.json`."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from geomosaic.errors import InputError
from geomosaic.sensor.inputs import need, number, numbers, table_of

_COEFFICIENTS = {
    "perspective": ("brown", ("k1", "k2")),
    "simple_radial": ("brown", ("k1",)),
    "radial": ("brown", ("k1", "k2")),
    "brown": ("brown", ("k1", "k2", "k3", "p1", "p2")),
    "fisheye": ("fisheye", ("k1", "k2")),
    "fisheye_opencv": ("fisheye", ("k1", "k2", "k3", "k4")),
}


def camera_table(camera: Mapping[str, Any], where: str) -> dict[str, Any]:
    """Camera table, as in `camera.toml`, of an OpenSfM camera.

    Focal length and principal point are given there in units of the longer side; the principal point counts from the
    image's centre, y down.

    Parameters
    ----------
    camera : mapping
        Entry of `cameras` in a reconstruction.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        The camera is of another type, or lacks a value.
    """
    kind = str(need(camera, "projection_type", where, "the camera's kind"))
    if kind not in _COEFFICIENTS:
        raise InputError(
            f"OpenSfM cameras of the type '{kind}' are not supported",
            where=where,
            hint=f"supported are: {', '.join(_COEFFICIENTS)}",
        )
    model, names = _COEFFICIENTS[kind]
    w, h = numbers([need(camera, key, where, "pixels") for key in ("width", "height")], 2, "width, height", where)
    longest = max(w, h)
    focal = camera.get("focal")
    fx, fy = camera.get("focal_x", focal), camera.get("focal_y", focal)
    if fx is None:
        raise InputError("the camera has no focal length", where=where, hint="give focal, or focal_x and focal_y")
    fy = fx if fy is None else fy
    cx, cy = (number(camera.get(key, 0.0), key, where) for key in ("c_x", "c_y"))
    return {
        "size": [w, h],
        "focal_length_px": [number(fx, "focal", where) * longest, number(fy, "focal_y", where) * longest],
        "principal_point_px": [w / 2 + cx * longest, h / 2 + cy * longest],
        "distortion": {"model": model, **{name: camera[name] for name in names if name in camera}},
    }


def read_shot(path: Path, image: str, system: str, where: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """Camera table and orientation row of one image.

    Parameters
    ----------
    path : Path
        The reconstruction.
    image : str
        File name, with or without extension.
    system : str
        'opensfm' or 'odm'.
    where : str
        Named in errors.

    Returns
    -------
    camera : dict
        As `camera.toml`.
    orientation : dict
        Row of that system.
    """
    try:
        parts = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"the reconstruction {path} cannot be read: {error}", where=where) from error
    stem = Path(image).stem
    for part in parts if isinstance(parts, list) else [parts]:
        shots = table_of(table_of(part, "the reconstruction", where).get("shots", {}), "shots", where)
        name = next((key for key in shots if key in (image, stem) or Path(key).stem == stem), None)
        if name is None:
            continue
        shot = table_of(shots[name], name, where)
        if part.get("reference_lla") is None:
            raise InputError(f"{path} has no reference_lla: the reconstruction is not georeferenced", where=where)
        lla = table_of(part["reference_lla"], "reference_lla", where)
        text = "a number of reference_lla"
        cameras = table_of(need(part, "cameras", where, "a table of cameras"), "cameras", where)
        camera = cameras.get(str(need(shot, "camera", where, "the name of its camera")))
        if camera is None:
            raise InputError(f"{path} has no camera named {shot['camera']!r}", where=where)
        row = {
            "system": system,
            "rotation": need(shot, "rotation", where, "rotation vector"),
            "translation": need(shot, "translation", where, "translation"),
            "reference": [
                number(need(lla, key, where, text), key, where) for key in ("longitude", "latitude", "altitude")
            ],
        }
        return camera_table(table_of(camera, "camera", where), where), row
    raise InputError(
        f"{path} has no shot named '{image}'", where=where, hint="check the name; it may not be in the block"
    )
