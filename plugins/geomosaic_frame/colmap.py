"""COLMAP's sparse model as text: `cameras.txt` and `images.txt` (COLMAP documentation, "Output Format").

A pose takes the world to the camera, X_c = R(q)·X_w + t, with q = (w, x, y, z) after Hamilton, and camera axes x right,
y down, z forward. (0.5, 0.5) is the centre of the upper-left pixel, as here. What the world is, the files do not say.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from geomosaic.errors import InputError
from geomosaic.sensor.inputs import finite_number
from geomosaic.types import FloatArray

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
"""Lens and parameters of each camera model, in the order of the file."""


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
    found = {}
    for number, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        where = f"{path}, line {number}"
        if len(words) < 4 or words[1] not in MODELS:
            kind = words[1] if len(words) > 1 else line[:40]
            raise InputError(f"no camera model '{kind}' is known", where=where, hint=f"known are: {', '.join(MODELS)}")
        lens, names = MODELS[words[1]]
        if len(words) != 4 + len(names):
            raise InputError(
                f"{words[1]} has {len(names)} parameters ({', '.join(names)}), the line has {len(words) - 4}",
                where=where,
            )
        width, height, *rest = _numbers(words[2:], where)
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
    found: dict[str, Pose] = {}
    of_points = False
    for number, line in enumerate(text.splitlines(), 1):
        if line.lstrip().startswith("#"):
            continue
        if of_points:
            of_points = False
            continue
        if not line.strip():
            continue
        where = f"{path}, line {number}"
        words = line.strip().split(maxsplit=9)
        if len(words) != 10:
            raise InputError(
                f"{len(words)} words where an image has 10: IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME",
                where=where,
                hint="each image has two lines, the second of them for its points, which may be empty",
            )
        values = _numbers(words[1:8], where)
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


def _numbers(words: list[str], where: str) -> list[float]:
    values = []
    for word in words:
        value = finite_number(word)
        if math.isnan(value):
            raise InputError(f"'{word[:40]}' is no finite number of a sensible size", where=where)
        values.append(value)
    return values
