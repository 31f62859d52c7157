"""COLMAP's sparse models as bytes: cameras.bin, images.bin, points3D.bin, little-endian (COLMAP, output format)."""

from __future__ import annotations

import struct

import numpy as np

from geomosaic.errors import InputError
from geomosaic.interchange.colmap import (
    CameraRecord,
    ImageRecord,
    PointRecords,
    SparseModel,
    check_quaternion,
    parameters_of,
    points_with_tracks,
)
from geomosaic.sensor.inputs import LARGEST
from geomosaic.types import FloatArray

# Models by their number in the file.
NUMBERS = (
    "SIMPLE_PINHOLE",
    "PINHOLE",
    "SIMPLE_RADIAL",
    "RADIAL",
    "OPENCV",
    "OPENCV_FISHEYE",
    "FULL_OPENCV",
    "FOV",
    "SIMPLE_RADIAL_FISHEYE",
    "RADIAL_FISHEYE",
    "THIN_PRISM_FISHEYE",
)
_FEATURE = np.dtype([("x", "<f8"), ("y", "<f8"), ("point", "<i8")])


class Cursor:
    """Place in the bytes of a file; an error names the file and the byte."""

    def __init__(self, data: bytes, path: str) -> None:
        self.data, self.path, self.at = data, path, 0

    def error(self, what: str) -> InputError:
        """Error about the place."""
        return InputError(what, where=f"{self.path}, byte {self.at}")

    def require(self, size: int) -> None:
        """Check that so many bytes follow."""
        if size > len(self.data) - self.at:
            raise self.error(f"the file ends, where {size} more bytes should follow")

    def take(self, form: str) -> tuple[int, ...]:
        """Whole numbers of a form of `struct`, little-endian."""
        size = struct.calcsize("<" + form)
        self.require(size)
        values = struct.unpack_from("<" + form, self.data, self.at)
        self.at += size
        return values

    def count(self, least: int) -> int:
        """Count of records that have at least so many bytes."""
        (count,) = self.take("Q")
        if count * least > len(self.data) - self.at:
            self.at -= 8
            raise self.error(f"{count} records cannot follow, the file is too short")
        return count

    def floats(self, count: int) -> FloatArray:
        """Finite numbers (count,)."""
        self.require(8 * count)
        values = np.frombuffer(self.data, "<f8", count, self.at).astype(np.float64)
        if not (np.abs(values) <= LARGEST).all():
            raise self.error("a number is not finite, or of no sensible size")
        self.at += 8 * count
        return values

    def rows(self, form: np.dtype, count: int) -> np.ndarray:
        """Records (count,) of a structured type."""
        self.require(form.itemsize * count)
        rows = np.frombuffer(self.data, form, count, self.at)
        self.at += form.itemsize * count
        return rows

    def text(self) -> str:
        """Text up to a zero byte."""
        end = self.data.find(b"\0", self.at)
        if end < 0:
            raise self.error("a name has no end")
        try:
            found = self.data[self.at : end].decode("utf-8")
        except UnicodeDecodeError:
            raise self.error("a name is not UTF-8") from None
        self.at = end + 1
        return found


def parse_cameras(data: bytes, path: str) -> list[CameraRecord]:
    """Cameras of `cameras.bin`.

    Parameters
    ----------
    data : bytes
    path : str
        Named in errors.
    """
    cursor, found = Cursor(data, path), []
    for _ in range(cursor.count(24)):
        number, kind, width, height = cursor.take("IiQQ")
        if not 0 <= kind < len(NUMBERS):
            raise cursor.error(f"camera {number} has the model {kind}, which is not known")
        if max(width, height) > LARGEST:
            raise cursor.error(f"camera {number} has {width} x {height} pixels")
        names = parameters_of(NUMBERS[kind], path)
        found.append(CameraRecord(str(number), NUMBERS[kind], (width, height), tuple(cursor.floats(len(names)))))
    return found


def parse_images(data: bytes, path: str, with_points: bool) -> list[ImageRecord]:
    """Images of `images.bin`.

    Parameters
    ----------
    data : bytes
    path : str
        Named in errors.
    with_points : bool
        Whether features are read.
    """
    cursor, found = Cursor(data, path), []
    for _ in range(cursor.count(73)):
        (number,) = cursor.take("I")
        pose = cursor.floats(7)
        check_quaternion(pose[:4], f"{path}, byte {cursor.at}")
        (camera,) = cursor.take("I")
        name = cursor.text()
        rows = cursor.rows(_FEATURE, cursor.count(_FEATURE.itemsize))[: None if with_points else 0]
        colrow = np.column_stack([rows["x"], rows["y"]])
        if not (np.abs(colrow) <= LARGEST).all():
            raise cursor.error(f"a feature of {name} is not at finite numbers")
        found.append(
            ImageRecord(str(number), pose[:4], pose[4:], str(camera), name, colrow, rows["point"].astype(np.int64))
        )
    return found


def parse_points(data: bytes, path: str) -> PointRecords:
    """Points of `points3D.bin`.

    Parameters
    ----------
    data : bytes
    path : str
        Named in errors.
    """
    cursor = Cursor(data, path)
    ids, xyz, colour = [], [], []
    for _ in range(cursor.count(51)):
        ids.append(cursor.take("q")[0])
        xyz.append(cursor.floats(3))
        colour.append(cursor.take("BBB"))
        cursor.require(8)
        cursor.at += 8  # the reprojection error, which tells nothing of a model that is read to be adjusted
        length = cursor.count(8)
        cursor.at += 8 * length
    return PointRecords(
        np.array(ids, dtype=np.int64), np.array(xyz).reshape(-1, 3), np.array(colour, dtype=np.uint8).reshape(-1, 3)
    )


def bytes_of(model: SparseModel) -> dict[str, bytes]:
    """Bytes of cameras.bin, images.bin and points3D.bin.

    Parameters
    ----------
    model : SparseModel

    Returns
    -------
    dict of str to bytes
        By the name of the file.
    """
    cameras = [struct.pack("<Q", len(model.cameras))]
    for camera in model.cameras:
        cameras.append(struct.pack("<IiQQ", int(camera.id), NUMBERS.index(camera.model), *camera.size))
        cameras.append(struct.pack(f"<{len(camera.parameters)}d", *camera.parameters))
    images = [struct.pack("<Q", len(model.images))]
    for image in model.images:
        rows = np.empty(len(image.points), _FEATURE)
        rows["x"], rows["y"] = image.colrow.T
        rows["point"] = image.points  # none is -1, which has the bytes of the largest unsigned number
        images += [
            struct.pack("<I7dI", int(image.id), *image.quaternion, *image.translation, int(image.camera)),
            image.name.encode() + b"\0",
            struct.pack("<Q", len(rows)),
            rows.tobytes(),
        ]
    points = [struct.pack("<Q", 0 if model.points is None else len(model.points.ids))]
    for number, xyz, colour, track in points_with_tracks(model):
        points.append(struct.pack("<Q3d3BdQ", number, *xyz, *colour, -1.0, len(track)))
        points.append(np.array(track, dtype="<u4").tobytes())
    return {"cameras.bin": b"".join(cameras), "images.bin": b"".join(images), "points3D.bin": b"".join(points)}
