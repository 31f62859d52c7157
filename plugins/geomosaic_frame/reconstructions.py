"""Reconstructions of COLMAP, OpenSfM and OpenDroneMap as our camera and orientation tables.

A pose takes the world to the camera, X_c = R(q)·X_w + t, with q = (w, x, y, z) after Hamilton, and camera axes x right,
y down, z forward. (0.5, 0.5) is the centre of the upper-left pixel, as here. What the world is, the files do not say.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.errors import InputError, counted
from geomosaic.sensor.inputs import finite_numbers, need, number, numbers, table_of
from geomosaic.types import FloatArray
from geomosaic.whole_files import check_rows

# Lens and parameters of each camera model, in the order of the file.
MODELS: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "SIMPLE_PINHOLE": ("none", ("f", "cx", "cy")),
    "PINHOLE": ("none", ("fx", "fy", "cx", "cy")),
    "SIMPLE_RADIAL": ("brown", ("f", "cx", "cy", "k1")),
    "RADIAL": ("brown", ("f", "cx", "cy", "k1", "k2")),
    "OPENCV": ("brown", ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")),
    "FULL_OPENCV": ("opencv", ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")),
    "OPENCV_FISHEYE": ("fisheye", ("fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4")),
    "SIMPLE_RADIAL_FISHEYE": ("fisheye", ("f", "cx", "cy", "k1")),
    "RADIAL_FISHEYE": ("fisheye", ("f", "cx", "cy", "k1", "k2")),
}


@dataclass(frozen=True)
class Pose:
    """Orientation of one image.

    Attributes
    ----------
    camera : str
        Number of its camera.
    row : dict
        Orientation row.
    """

    camera: str
    row: dict[str, Any]


@dataclass(frozen=True)
class SparseModel:
    """Cameras and orientations of a COLMAP reconstruction.

    Attributes
    ----------
    cameras : mapping
        Camera tables by number.
    images : mapping
        Poses by image name.
    """

    cameras: Mapping[str, dict[str, Any]]
    images: Mapping[str, Pose]


@lru_cache(maxsize=4)
def read_colmap(cameras: str, images: str, where: tuple[str, str]) -> SparseModel:
    """Sparse model of both text files; kept, since all images of a block ask for it.

    Parameters
    ----------
    cameras, images : str
        Texts of `cameras.txt` and `images.txt`.
    where : tuple of str
        Names of the two files, for errors.

    Raises
    ------
    InputError
        A line is damaged; names file and line.
    """
    return SparseModel(_cameras(cameras, where[0]), _images(images, where[1]))


def _cameras(text: str, path: str) -> dict[str, dict[str, Any]]:
    check_rows(text.count("\n"), path)
    found = {}
    for at, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        where = f"{path}, line {at}"
        if len(words) < 4 or words[1] not in MODELS:
            kind = words[1] if len(words) > 1 else line[:40]
            raise InputError(f"no camera model '{kind}' is known", where=where, hint=f"known are: {', '.join(MODELS)}")
        lens, names = MODELS[words[1]]
        if len(words) != 4 + len(names):
            raise InputError(
                f"{words[1]} has {counted(len(names), 'parameter')} ({', '.join(names)}), the line has "
                f"{len(words) - 4}",
                where=where,
            )
        width, height, *rest = finite_numbers(words[2:], 2 + len(names), f"camera {words[0][:20]}", where)
        values = dict(zip(names, rest, strict=True))
        focal = [values.get("fx", values.get("f", 0.0)), values.get("fy", values.get("f", 0.0))]
        found[words[0]] = {
            "size": [width, height],
            "focal_length_px": focal,
            "principal_point_px": [values["cx"], values["cy"]],
            "distortion": {"model": lens, **{k: v for k, v in values.items() if k[0] in "kp"}},
        }
    return found


def _images(text: str, path: str) -> dict[str, Pose]:
    """Poses; every second line lists points of the image, and may be empty."""
    check_rows(text.count("\n"), path)
    found: dict[str, Pose] = {}
    of_points = False
    for at, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith("#"):
            continue
        if of_points:
            of_points = False
            continue
        if not line.strip():
            continue
        where = f"{path}, line {at}"
        words = line.strip().split(maxsplit=9)
        if len(words) != 10:
            raise InputError(
                f"{counted(len(words), 'word')} where an image has 10: IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME",
                where=where,
                hint="each image has two lines, the second of them for its points, which may be empty",
            )
        values = finite_numbers(words[1:8], 7, "the pose", where)
        rotation = _rotation(np.array(values[:4]), where)
        found[words[9]] = Pose(
            words[8],
            {
                "system": "colmap",
                "rotation": rotation.ravel().tolist(),
                "position": (-rotation.T @ np.array(values[4:])).tolist(),
            },
        )
        of_points = True
    return found


def _rotation(q: FloatArray, where: str) -> FloatArray:
    """Matrix of a quaternion (w, x, y, z)."""
    length = float(np.linalg.norm(q))
    if not 0.99 < length < 1.01:
        raise InputError(f"the quaternion has length {length:.4g}, not 1", where=where)
    w, x, y, z = q / length
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


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
        raise InputError(
            f"the reconstruction {path} cannot be read: {error}",
            where=where,
            hint="give the file reconstruction.json of OpenSfM or ODM",
        ) from error
    stem = Path(image).stem
    for part in parts if isinstance(parts, list) else [parts]:
        shots = table_of(table_of(part, "the reconstruction", where).get("shots", {}), "shots", where)
        name = next((key for key in shots if key in (image, stem) or Path(key).stem == stem), None)
        if name is None:
            continue
        shot = table_of(shots[name], name, where)
        if part.get("reference_lla") is None:
            raise InputError(
                f"{path} has no reference_lla: the reconstruction is not georeferenced",
                where=where,
                hint="run OpenSfM again on photos with GPS positions, or with control points",
            )
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
