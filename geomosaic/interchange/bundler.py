"""Bundler's v0.3 files, and problems of BAL (Bundle Adjustment in the Large), whose camera is the same.

P = R·X + t, p = −P / P.z, p' = f·(1 + k1·|p|² + k2·|p|⁴)·p: the camera looks along −z with x right and y up, and p'
counts from the middle of the image (Bundler user's manual, output format). The sizes of images are in neither file.
Bundler's images are those of a list of files beside it; BAL's have numbers.
"""

from __future__ import annotations

import bz2
import gzip
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from geomosaic.errors import InputError, counted
from geomosaic.geo.local_frames import angle_axis
from geomosaic.interchange.files import LARGEST, all_numbers, decoded, number_text
from geomosaic.interchange.reconstruction import (
    ImagePoints,
    ImagePose,
    ObjectPoints,
    Reconstruction,
    pixel_camera,
)
from geomosaic.types import ByteArray, FloatArray, IntArray

HEADER = "# Bundle file v0.3"
NOTE = "sizes of images are not in the file: pixels count from the middle of each image, rows downwards"
# From our camera axes (y down, z forward) to those of the files, and back.
_FLIP = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True, eq=False)
class Views:
    """Cameras and measurements as both formats have them.

    Attributes
    ----------
    lens : array (M, 3)
        f in pixels, k1, k2 of each image.
    rotation : array (M, 3, 3)
    translation : array (M, 3)
    xyz : array (S, 3)
    image, point : array (N,)
    xy : array (N, 2)
        Pixels from the middle, y up.
    """

    lens: FloatArray
    rotation: FloatArray
    translation: FloatArray
    xyz: FloatArray
    image: IntArray
    point: IntArray
    xy: FloatArray


def read_bundler(text: str, path: str, names: Sequence[str] | None = None) -> Reconstruction:
    """Reconstruction of a Bundler file; images of focal length 0 have no pose.

    Parameters
    ----------
    text : str
        Whole file.
    path : str
        Named in errors.
    names : sequence of str, optional
        Images in the file's order; numbers from 0 otherwise.

    Raises
    ------
    InputError
        The file is damaged, or there are fewer names than images.
    """
    head, _, rest = text.lstrip("\ufeff").partition("\n")
    if not head.startswith("# Bundle file"):
        raise InputError(f"the first line is not '{HEADER}'", where=path, hint="give the file bundle.out of Bundler")
    values = all_numbers(rest, path, 2)
    images, points = _counts(values, 2, path)
    at = 2 + 15 * images
    if len(values) < at + 7 * points:
        raise InputError(f"the file ends before its {images} cameras and {points} points", where=path)
    cameras = values[2:at].reshape(images, 15)
    xyz, colour = np.empty((points, 3)), np.empty((points, 3))
    image, point, xy = [], [], []
    for index in range(points):
        if at + 7 > len(values):
            raise InputError(f"the file ends before point {index}", where=path)
        xyz[index], colour[index], views = values[at : at + 3], values[at + 3 : at + 6], values[at + 6]
        at += 7
        if not 0 <= views <= images or views % 1 or at + 4 * int(views) > len(values):
            raise InputError(f"point {index} has {views:g} views, which are not there", where=path)
        rows = values[at : at + 4 * int(views)].reshape(-1, 4)
        at += rows.size
        image.append(rows[:, 0])
        point.append(np.full(len(rows), index))
        xy.append(rows[:, 2:])
    if at != len(values):
        raise InputError(f"{counted(len(values) - at, 'number')} too many follow the last point", where=path)
    which, whose = (np.concatenate([np.zeros(0), *parts]) for parts in (image, point))
    found = Views(
        cameras[:, :3],
        cameras[:, 3:12].reshape(-1, 3, 3),
        cameras[:, 12:],
        xyz,
        _index(which, images, "image", path),
        whose.astype(np.int64),
        np.concatenate([np.zeros((0, 2)), *xy]),
    )
    return _reconstruction(found, path, names, np.clip(colour, 0, 255).astype(np.uint8))


def read_bal(data: bytes, path: str) -> Reconstruction:
    """Reconstruction of a problem of BAL.

    Parameters
    ----------
    data : bytes
        Text, or text that bzip2 or gzip has packed.
    path : str
        Named in errors.

    Raises
    ------
    InputError
        The file is damaged.
    """
    values = all_numbers(decoded(_unpacked(data, path), path, path), path)
    images, points = _counts(values, 3, path)
    count = int(values[2]) if 0 <= values[2] <= len(values) and values[2] % 1 == 0 else -1
    if count < 0 or len(values) != 3 + 4 * count + 9 * images + 3 * points:
        raise InputError(
            f"{len(values)} numbers are not those of {images} cameras, {points} points and {values[2]:g} measurements",
            where=path,
            hint="is it a problem of BAL, and whole?",
        )
    rows = values[3 : 3 + 4 * count].reshape(-1, 4)
    cameras = values[3 + 4 * count :][: 9 * images].reshape(-1, 9)
    found = Views(
        cameras[:, 6:],
        np.array([angle_axis(vector) for vector in cameras[:, :3]]).reshape(-1, 3, 3),
        cameras[:, 3:6],
        values[len(values) - 3 * points :].reshape(-1, 3),
        _index(rows[:, 0], images, "image", path),
        _index(rows[:, 1], points, "point", path),
        rows[:, 2:],
    )
    return _reconstruction(found, path, None, None)


def _unpacked(data: bytes, path: str) -> bytes:
    """Bytes that bzip2 or gzip has packed, else as they are; an error where they are too many."""
    kinds: Mapping[bytes, Any] = {b"BZh": bz2.BZ2Decompressor(), b"\x1f\x8b": zlib.decompressobj(wbits=31)}
    packed = next((kind for start, kind in kinds.items() if data.startswith(start)), None)
    if packed is None:
        return data
    try:
        # Bounded: a few bytes can unpack to any number of them.
        out: bytes = packed.decompress(data, LARGEST + 1)
    except (OSError, zlib.error, EOFError) as error:
        raise InputError(f"the packed file is damaged: {error}", where=path, hint="get the file again") from None
    if len(out) > LARGEST:
        raise InputError(f"the file unpacks to more than {LARGEST >> 20} MB", where=path, hint="is it the right file?")
    if not packed.eof:
        raise InputError("the packed file ends too early", where=path, hint="get the file again")
    return out


def _counts(values: FloatArray, least: int, path: str) -> tuple[int, int]:
    """Counts of images and points, the first two numbers."""
    if len(values) < least or (values[:2] < 0).any() or (values[:2] % 1).any() or (values[:2] > len(values)).any():
        raise InputError("the file does not begin with its counts of cameras and points", where=path)
    return int(values[0]), int(values[1])


def _index(values: FloatArray, count: int, what: str, path: str) -> IntArray:
    """Indices (N,), checked."""
    wrong = (values < 0) | (values >= count) | (values % 1 != 0)
    if wrong.any():
        raise InputError(
            f"measurement {int(np.argmax(wrong))} is of {what} {values[wrong][0]:g}, of {count}", where=path
        )
    return values.astype(np.int64)


def _reconstruction(views: Views, path: str, names: Sequence[str] | None, colour: ByteArray | None) -> Reconstruction:
    count = len(views.lens)
    if names is None:
        names = [str(index) for index in range(count)]
    if len(names) < count:
        raise InputError(
            f"the list names {counted(len(names), 'image')}, the file has {count}", where=path, hint="give its own list"
        )
    cameras: dict[str, dict[str, Any]] = {}
    images = []
    for index, (focal, k1, k2) in enumerate(views.lens.tolist()):
        if focal <= 0.0:
            images.append(ImagePose(names[index]))
            continue
        rotation = views.rotation[index]
        if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-4 or np.linalg.det(rotation) < 0.0:
            raise InputError(f"the rotation of camera {index} is none", where=path, hint=None)
        cameras[str(index)] = {
            "focal_length_px": focal,
            "principal_point_px": [0.0, 0.0],
            "distortion": {"model": "brown", "k1": k1, "k2": k2},
        }
        images.append(ImagePose(names[index], str(index), _FLIP @ rotation, -rotation.T @ views.translation[index]))
    seen = ImagePoints(views.image, views.point, views.xy * [1.0, -1.0])
    posed = np.array([image.camera is not None for image in images], dtype=bool)
    keep = posed[seen.image]
    if not keep.all():
        seen = ImagePoints(seen.image[keep], seen.point[keep], seen.colrow[keep])
    points = ObjectPoints(tuple(map(str, range(len(views.xyz)))), views.xyz, colour)
    return Reconstruction(cameras, tuple(images), points, seen, notes=(NOTE, "the file does not say what the world is"))


def _views(found: Reconstruction, program: str) -> Views:
    """What both formats hold of a reconstruction, its images all oriented and its points all known."""
    lens, rotation, translation, middle = [], [], [], []
    for image in found.images:
        camera = pixel_camera(found.camera_of(image), image.name)
        camera.known_only(program, image.name, none=(), brown=("k1", "k2"))
        turn, centre = image.pose
        if camera.focal[0] != camera.focal[1] or any(camera.from_middle):
            raise InputError(
                f"{program} has one focal length, and the principal point in the middle of the image",
                where=image.name,
                hint="adjust the camera so, or write another format",
            )
        lens.append((camera.focal[0], camera.lens.get("k1", 0.0), camera.lens.get("k2", 0.0)))
        rotation.append(_FLIP @ turn)
        translation.append(-rotation[-1] @ centre)
        middle.append(camera.middle)
    known = found.points.known
    number = np.cumsum(known) - 1
    seen = found.observations
    keep = known[seen.point]
    at = seen.image[keep]
    return Views(
        np.array(lens).reshape(-1, 3),
        np.array(rotation).reshape(-1, 3, 3),
        np.array(translation).reshape(-1, 3),
        found.points.xyz[known],
        at,
        number[seen.point[keep]],
        (seen.colrow[keep] - np.array(middle).reshape(-1, 2)[at]) * [1.0, -1.0],
    )


def bundler_texts(found: Reconstruction) -> dict[str, str]:
    """Texts of bundle.out and of list.txt with the images' names.

    Parameters
    ----------
    found : Reconstruction
        All images oriented; points without coordinates are left out.

    Raises
    ------
    InputError
        A camera has more than a focal length and k1, k2, or an image no pose.
    """
    views = _views(found, "Bundler")
    lines = [HEADER, f"{len(views.lens)} {len(views.xyz)}"]
    for lens, rotation, translation in zip(views.lens, views.rotation, views.translation, strict=True):
        lines += [number_text(row) for row in (lens, *rotation, translation)]
    colour = found.points.colours[found.points.known]
    order = np.argsort(views.point, kind="stable")
    first = np.searchsorted(views.point[order], np.arange(len(views.xyz) + 1))
    keys = np.zeros(len(views.lens), dtype=np.int64)
    for index, (xyz, tint) in enumerate(zip(views.xyz, colour, strict=True)):
        listed = [str(first[index + 1] - first[index])]
        for at in order[first[index] : first[index + 1]]:
            image = views.image[at]
            listed.append(f"{image} {keys[image]} {number_text(views.xy[at])}")
            keys[image] += 1
        lines += [number_text(xyz), " ".join(map(str, tint.tolist())), " ".join(listed)]
    names = [image.name for image in found.images]
    return {"bundle.out": "\n".join([*lines, ""]), "list.txt": "\n".join([*names, ""])}


def _bal_text(found: Reconstruction) -> str:
    """Text of a problem of BAL, as `bundler_texts`."""
    from scipy.spatial.transform import Rotation

    views = _views(found, "BAL")
    lines = [f"{len(views.lens)} {len(views.xyz)} {len(views.xy)}"]
    rows = zip(views.image.tolist(), views.point.tolist(), views.xy, strict=True)
    lines += [f"{image} {point}     {number_text(xy)}" for image, point, xy in rows]
    vectors = Rotation.from_matrix(views.rotation).as_rotvec() if len(views.lens) else np.zeros((0, 3))
    cameras = np.column_stack([vectors, views.translation, views.lens])
    lines += [repr(value) for value in (*cameras.ravel().tolist(), *views.xyz.ravel().tolist())]
    return "\n".join([*lines, ""])


def bal_bytes(found: Reconstruction, ending: str) -> bytes:
    """Bytes of a problem of BAL, packed where the ending of the name is .bz2 or .gz.

    Parameters
    ----------
    found : Reconstruction
    ending : str
        Of the name of the file.
    """
    data = _bal_text(found).encode()
    if ending == ".bz2":
        return bz2.compress(data)
    return gzip.compress(data, mtime=0) if ending == ".gz" else data
