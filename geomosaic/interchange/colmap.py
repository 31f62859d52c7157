"""COLMAP's sparse models: cameras, images and points3D as text; the binary form is in `colmap_binary.py`.

A pose takes the world to the camera, X_c = R(q)·X_w + t, with q = (w, x, y, z) after Hamilton, and camera axes x right,
y down, z forward. (0.5, 0.5) is the centre of the upper-left pixel, as here. What the world is, the files do not say.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from geomosaic.errors import InputError, counted
from geomosaic.interchange.files import all_numbers
from geomosaic.interchange.reconstruction import (
    ImagePoints,
    ImagePose,
    ObjectPoints,
    Reconstruction,
    pixel_camera,
)
from geomosaic.sensor.inputs import finite_numbers
from geomosaic.types import ByteArray, FloatArray, IntArray
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
# Point of a measurement that belongs to none.
NO_POINT = -1


@dataclass(frozen=True)
class CameraRecord:
    """Camera as the file has it: number, model of `MODELS`, width and height, parameters."""

    id: str
    model: str
    size: tuple[int, int]
    parameters: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class ImageRecord:
    """Image as the file has it: number, pose, camera, name; columns and rows (K, 2) and points (K,) of its features."""

    id: str
    quaternion: FloatArray
    translation: FloatArray
    camera: str
    name: str
    colrow: FloatArray
    points: IntArray


@dataclass(frozen=True, eq=False)
class PointRecords:
    """Points as the file has them: numbers (S,), coordinates (S, 3), colours (S, 3)."""

    ids: IntArray
    xyz: FloatArray
    colour: ByteArray


@dataclass(frozen=True, eq=False)
class SparseModel:
    """Records of a whole model; `points` is None where they were not asked for."""

    cameras: Sequence[CameraRecord]
    images: Sequence[ImageRecord]
    points: PointRecords | None = None


def parse_cameras(text: str, path: str) -> list[CameraRecord]:
    """Cameras of `cameras.txt`; `path` is named in errors with the line.

    Parameters
    ----------
    text : str
    path : str
        Named in errors.
    """
    check_rows(text.count("\n"), path)
    found = []
    for at, line in enumerate(text.splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        where = f"{path}, line {at}"
        names = parameters_of(words[1] if len(words) > 1 else line[:40], where)
        if len(words) != 4 + len(names):
            raise InputError(
                f"{words[1]} has {counted(len(names), 'parameter')} ({', '.join(names)}), the line has "
                f"{len(words) - 4}",
                where=where,
            )
        width, height, *rest = finite_numbers(words[2:], 2 + len(names), f"camera {words[0][:20]}", where)
        found.append(CameraRecord(words[0], words[1], (int(width), int(height)), tuple(rest)))
    return found


def parameters_of(model: str, where: str) -> tuple[str, ...]:
    """Names of a camera model's parameters; an error where it is not known.

    Parameters
    ----------
    model : str
        Name of the camera model.
    where : str
        Named in errors.
    """
    if model not in MODELS:
        raise InputError(f"no camera model '{model}' is known", where=where, hint=f"known are: {', '.join(MODELS)}")
    return MODELS[model][1]


def parse_images(text: str, path: str, with_points: bool) -> list[ImageRecord]:
    """Images of `images.txt`; every second line lists features of the image, and may be empty.

    Parameters
    ----------
    text : str
    path : str
        Named in errors.
    with_points : bool
        Whether features are read.
    """
    check_rows(text.count("\n"), path)
    found: list[ImageRecord] = []
    head: tuple[list[str], list[float]] | None = None
    nothing = np.zeros((0, 3))
    for at, line in enumerate([*text.splitlines(), ""], 1):
        if line.lstrip().startswith("#"):
            continue
        where = f"{path}, line {at}"
        if head is not None:
            words, values = head
            rows = nothing
            if with_points and line.strip():
                listed = all_numbers(line, path, at)
                if len(listed) % 3:
                    raise InputError("the list of features is not one of X, Y, POINT3D_ID", where=where)
                rows = listed.reshape(-1, 3)
            found.append(
                ImageRecord(
                    words[0],
                    np.array(values[:4]),
                    np.array(values[4:]),
                    words[8],
                    words[9],
                    rows[:, :2],
                    rows[:, 2].astype(np.int64),
                )
            )
            head = None
        elif line.strip():
            words = line.strip().split(maxsplit=9)
            if len(words) != 10:
                raise InputError(
                    f"{counted(len(words), 'word')} where an image has 10: IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID "
                    "NAME",
                    where=where,
                    hint="each image has two lines, the second of them for its points, which may be empty",
                )
            values = finite_numbers(words[1:8], 7, "the pose", where)
            check_quaternion(np.array(values[:4]), where)
            head = words, values
    return found


def parse_points(text: str, path: str) -> PointRecords:
    """Points of `points3D.txt`; their tracks are those of `images.txt`.

    Parameters
    ----------
    text : str
    path : str
        Named in errors.
    """
    check_rows(text.count("\n"), path)
    rows = []
    for at, line in enumerate(text.splitlines(), 1):
        if line.strip() and not line.lstrip().startswith("#"):
            words = line.split(maxsplit=7)
            rows.append(finite_numbers(words[:7], 7, "the point", f"{path}, line {at}"))
    values = np.array(rows).reshape(-1, 7)
    return PointRecords(
        values[:, 0].astype(np.int64), values[:, 1:4], np.clip(values[:, 4:], 0.0, 255.0).astype(np.uint8)
    )


def check_quaternion(q: FloatArray, where: str) -> None:
    """Check that a quaternion (4,) has length 1, but for the digits it is printed with.

    Parameters
    ----------
    q : array (4,)
    where : str
        Named in errors.
    """
    length = float(np.linalg.norm(q))
    if not 0.99 < length < 1.01:
        raise InputError(f"the quaternion has length {length:.4g}, not 1", where=where)


def quaternion_matrix(q: FloatArray) -> FloatArray:
    """Matrix of a quaternion (w, x, y, z).

    Parameters
    ----------
    q : array (4,)
    """
    w, x, y, z = q / float(np.linalg.norm(q))
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def camera_table(camera: CameraRecord) -> dict[str, Any]:
    """Camera table of a record; one focal length where the model has one, so that the way back is the same.

    Parameters
    ----------
    camera : CameraRecord

    Returns
    -------
    dict
        As in `camera.toml`; pixels.
    """
    lens, names = MODELS[camera.model]
    values = dict(zip(names, camera.parameters, strict=True))
    return {
        "size": list(camera.size),
        "focal_length_px": values["f"] if "f" in values else [values["fx"], values["fy"]],
        "principal_point_px": [values["cx"], values["cy"]],
        "distortion": {"model": lens, **{k: v for k, v in values.items() if k[0] in "kp"}},
    }


def pose_of(image: ImageRecord) -> ImagePose:
    """Pose of a record.

    Parameters
    ----------
    image : ImageRecord
        World to camera, as COLMAP has it.

    Returns
    -------
    ImagePose
        With the projection centre in the world.
    """
    rotation = quaternion_matrix(image.quaternion)
    return ImagePose(image.name, image.camera, rotation, -rotation.T @ image.translation)


def from_records(model: SparseModel, where: str) -> Reconstruction:
    """Reconstruction of a COLMAP model.

    Parameters
    ----------
    model : SparseModel
    where : str
        Folder, named in errors.

    Raises
    ------
    InputError
        A feature's point is not in the model.
    """
    images = [pose_of(image) for image in model.images]
    cameras = {camera.id: camera_table(camera) for camera in model.cameras}
    notes = ("the files do not say what the world is",)
    if model.points is None:
        return Reconstruction(cameras, tuple(images), notes=notes)
    order = np.argsort(model.points.ids, kind="stable")
    numbers = model.points.ids[order]
    index, points, colrow = [], [], []
    for at, image in enumerate(model.images):
        used = image.points != NO_POINT
        place = np.searchsorted(numbers, image.points[used])
        missing = place >= len(numbers)
        missing[~missing] = numbers[place[~missing]] != image.points[used][~missing]
        if missing.any():
            point = image.points[used][missing][0]
            raise InputError(
                f"point {point} of image {image.name} is not among the points of the model",
                where=where,
                hint="write the model again: images and points are not of one state",
            )
        index.append(np.full(len(place), at, dtype=np.int64))
        points.append(order[place])
        colrow.append(image.colrow[used])
    seen = ImagePoints.none()
    if images:
        seen = ImagePoints(np.concatenate(index), np.concatenate(points), np.concatenate(colrow))
    own = ObjectPoints(tuple(map(str, model.points.ids.tolist())), model.points.xyz, model.points.colour)
    return Reconstruction(cameras, tuple(images), own, seen, notes=notes)


def to_records(found: Reconstruction) -> SparseModel:
    """COLMAP model of the oriented images of a reconstruction.

    Parameters
    ----------
    found : Reconstruction
        Points without coordinates are left out, names of cameras and points that are no numbers are numbered anew.

    Raises
    ------
    InputError
        A camera has no size, or a lens that COLMAP has not.
    """
    from scipy.spatial.transform import Rotation

    used = [at for at, image in enumerate(found.images) if image.oriented]
    wanted = {str(found.images[at].camera) for at in used}
    names = [name for name in found.cameras if name in wanted]
    numbers = dict(zip(names, _numbers(names), strict=True))
    cameras = [_camera(str(numbers[name]), found.cameras[name], name) for name in names]
    known = found.points.known
    ids = np.array(_numbers(found.points.ids), dtype=np.int64)
    seen = found.observations
    order = np.argsort(seen.image, kind="stable")
    first = np.searchsorted(seen.image[order], np.arange(len(found.images) + 1))
    images = []
    for number, at in enumerate(used, 1):
        image = found.images[at]
        rotation, centre = image.pose
        found.camera_of(image)
        x, y, z, w = Rotation.from_matrix(rotation).as_quat(canonical=True)
        own = order[first[at] : first[at + 1]]
        own = own[known[seen.point[own]]]
        images.append(
            ImageRecord(
                str(number),
                np.array([w, x, y, z]),
                -rotation @ centre,
                str(numbers[str(image.camera)]),
                image.name,
                seen.colrow[own],
                ids[seen.point[own]],
            )
        )
    return SparseModel(cameras, images, PointRecords(ids[known], found.points.xyz[known], found.points.colours[known]))


def _numbers(names: Sequence[str]) -> list[int]:
    """Names as numbers, where all of them are; else 1, 2, 3, ..."""
    if all(name.isdecimal() and len(name) < 10 for name in names):
        values = [int(name) for name in names]
        if len(set(values)) == len(values):
            return values
    return list(range(1, len(names) + 1))


def _camera(number: str, table: Mapping[str, Any], name: str) -> CameraRecord:
    """Record of a camera table: the smallest model that has all it gives."""
    camera = pixel_camera(table, f"camera {name}")
    size = camera.known_size(f"camera {name}")
    # Only the rational model has r⁶, of which the polynomial one is a case.
    kind = "opencv" if camera.model == "brown" and camera.lens.get("k3") else camera.model
    fitting = sorted((len(names), model) for model, (lens, names) in MODELS.items() if lens == kind)
    most = MODELS[fitting[-1][1]][1] if fitting else ()
    camera.known_only("COLMAP", f"camera {name}", **{camera.model: most})
    given = set(camera.lens) & set(most)
    one = camera.one_focal and camera.focal[0] == camera.focal[1]
    model = next(m for _, m in fitting if given <= set(MODELS[m][1]) and (one or "f" not in MODELS[m][1]))
    focal = camera.focal[:1] if "f" in MODELS[model][1] else camera.focal
    rest = [camera.lens.get(key, 0.0) for key in MODELS[model][1][len(focal) + 2 :]]
    return CameraRecord(number, model, size, (*focal, *camera.principal, *rest))


def text_of(model: SparseModel) -> dict[str, str]:
    """Texts of cameras.txt, images.txt and points3D.txt, all digits of their numbers.

    Parameters
    ----------
    model : SparseModel
    """
    points = points_with_tracks(model)
    cameras = [
        f"{c.id} {c.model} {c.size[0]} {c.size[1]} {' '.join(map(repr, map(float, c.parameters)))}"
        for c in model.cameras
    ]
    images = []
    for image in model.images:
        pose = " ".join(map(repr, (*image.quaternion.tolist(), *image.translation.tolist())))
        features = zip(image.colrow.tolist(), image.points.tolist(), strict=True)
        images += [
            f"{image.id} {pose} {image.camera} {image.name}",
            " ".join(f"{x!r} {y!r} {point}" for (x, y), point in features),
        ]
    lists = [
        f"{number} {' '.join(map(repr, xyz))} {' '.join(map(str, colour))} -1.0 "
        + " ".join(f"{image} {feature}" for image, feature in track)
        for number, xyz, colour, track in points
    ]
    return {
        "cameras.txt": "\n".join(("# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]", *cameras, "")),
        "images.txt": "\n".join(
            (
                "# IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME",
                "# POINTS2D[] as (X, Y, POINT3D_ID)",
                *images,
                "",
            )
        ),
        "points3D.txt": "\n".join(
            ("# POINT3D_ID, X, Y, Z, R, G, B, ERROR, TRACK[] as (IMAGE_ID, POINT2D_IDX)", *lists, "")
        ),
    }


def points_with_tracks(
    model: SparseModel,
) -> Iterator[tuple[int, list[float], list[int], list[tuple[int, int]]]]:
    """Number, coordinates, colour and track of each point of a model, the track as images and their features.

    Parameters
    ----------
    model : SparseModel

    Yields
    ------
    number : int
    xyz : list of float
        World coordinates.
    colour : list of int
        Red, green, blue, 0 to 255.
    track : list of (int, int)
        Number of the image and index of its feature.
    """
    if model.points is None:
        return
    tracks: dict[int, list[tuple[int, int]]] = {number: [] for number in model.points.ids.tolist()}
    for image in model.images:
        for feature, point in enumerate(image.points.tolist()):
            if point != NO_POINT:
                tracks[point].append((int(image.id), feature))
    rows = zip(model.points.ids.tolist(), model.points.xyz.tolist(), model.points.colour.tolist(), strict=True)
    for number, xyz, colour in rows:
        yield number, xyz, colour, tracks[number]
