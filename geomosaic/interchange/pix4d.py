"""Pix4D's `..._calibrated_camera_parameters.txt`: camera and orientation of every image; and its `..._pmatrix.txt`.

After a header that names them, each image has ten lines: name, width and height; K (3 × 3); radial distortion R1, R2,
R3; tangential distortion T1, T2; position t; and the rotation R (3 × 3) of m = K [R | −R·t] X, whose camera axes are x
right, y down, z forward. With x = X'/Z', y = Y'/Z' and r² = x² + y² ("How are the internal and external camera
parameters defined", Pix4D),

    x_d = x·(1 + R1·r² + R2·r⁴ + R3·r⁶) + 2·T1·x·y + T2·(r² + 2x²)
    y_d = y·(1 + R1·r² + R2·r⁴ + R3·r⁶) + 2·T2·x·y + T1·(r² + 2y²)

Pixels count from the outer corner of the upper-left pixel: a default principal point is half the size. t counts from
`..._offset.xyz`, where there is one, in the map of the project.

`..._pmatrix.txt` has one line for each image, its name and P = K [R | −R·t] row by row: the camera of the undistorted
image. K and R are its RQ decomposition.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.errors import InputError
from geomosaic.interchange.files import PIX4D, number_text
from geomosaic.interchange.reconstruction import Reconstruction, pixel_camera
from geomosaic.sensor.inputs import finite_numbers
from geomosaic.whole_files import check_rows

PARAMETERS, PMATRIX = PIX4D
OFFSET = "_offset.xyz"
# What follows the name of an image: lines and numbers in each.
LAYOUT = (("K", 3, 3), ("radial distortion", 1, 3), ("tangential distortion", 1, 2), ("position", 1, 3), ("R", 3, 3))

Cameras = dict[str, tuple[dict[str, Any], dict[str, Any]]]


def offset_file(path: Path, ending: str) -> Path | None:
    """Another file of the same project, of the same name but for its ending.

    Parameters
    ----------
    path : Path
        File whose name ends with `PARAMETERS` or `PMATRIX`.
    ending : str
        Such as `OFFSET`.

    Returns
    -------
    Path or None
        None where it is not there.
    """
    own = next((name for name in (PARAMETERS, PMATRIX) if path.name.endswith(name)), None)
    if own is None:
        return None
    other = path.with_name(path.name.removesuffix(own) + ending)
    return other if other.is_file() else None


def read_offset(text: str, where: str) -> tuple[float, ...]:
    """Offset of the project's positions, from `..._offset.xyz`.

    Parameters
    ----------
    text : str
        Whole file.
    where : str
        Named in errors.

    Returns
    -------
    tuple of float
        x, y, z in the map of the project.

    Raises
    ------
    InputError
        The text is not three numbers.
    """
    return tuple(finite_numbers(text.split(), 3, "the offset", where))


@lru_cache(maxsize=4)
def read_pix4d(text: str, offset: tuple[float, ...] | None, where: str) -> Cameras:
    """Cameras and orientations of all images.

    Parameters
    ----------
    text : str
    offset : tuple of float or None
        To be added to the positions.
    where : str
        File.

    Returns
    -------
    dict
        Name → camera table and orientation row.

    Raises
    ------
    InputError
        The header is missing, or an image is not complete; names the line.
    """
    check_rows(text.count("\n"), where)
    lines = [(number, line) for number, line in enumerate(text.splitlines(), 1) if line.strip()]
    last = next((i for i, (_, line) in enumerate(lines) if line.split()[:2] == ["camera", "model"]), None)
    if last is None:
        raise InputError(
            "this is not Pix4D's list of calibrated camera parameters: its header is missing",
            where=where,
            hint=f"give the file PROJECT{PARAMETERS}; the list of omega, phi, kappa is read with angles = 'opk'",
        )
    body = lines[last + 1 :]
    count = 1 + sum(rows for _, rows, _ in LAYOUT)
    found: Cameras = {}
    for first in range(0, len(body), count):
        number = body[first][0]
        part = [line for _, line in body[first : first + count]]
        if len(part) < count:
            raise InputError("the last image is not complete", where=f"{where}, line {number}")
        name, size = _head(part[0], f"{where}, line {number}")
        at, values = 1, {}
        for what, rows, columns in LAYOUT:
            values[what] = np.array(
                [finite_numbers(line.split(), columns, what, f"{where}, {name}") for line in part[at : at + rows]]
            )
            at += rows
        k = values["K"]
        if k[1, 0] or k[2, 0] or k[2, 1] or k[2, 2] != 1.0:
            raise InputError("K is no camera matrix", where=f"{where}, {name}")
        r1, r2, r3 = values["radial distortion"][0]
        t1, t2 = values["tangential distortion"][0]
        lens = {"model": "brown", "k1": r1, "k2": r2, "k3": r3, "p1": t1, "p2": t2, "shear": k[0, 1] / k[0, 0]}
        camera = {
            "size": list(size),
            "focal_length_px": [k[0, 0], k[1, 1]],
            "principal_point_px": [k[0, 2], k[1, 2]],
            "distortion": lens,
        }
        position = values["position"][0] + (0.0 if offset is None else np.array(offset))
        found[name] = (
            camera,
            {"system": "pix4d", "rotation": values["R"].ravel().tolist(), "position": position.tolist()},
        )
    return found


@lru_cache(maxsize=4)
def read_pmatrix(text: str, offset: tuple[float, ...] | None, where: str) -> Cameras:
    """Cameras and orientations of all undistorted images, from their projection matrices.

    Parameters
    ----------
    text : str
        Whole file.
    offset : tuple of float or None
        To be added to the positions.
    where : str
        File.

    Returns
    -------
    dict
        Name → camera table and orientation row.

    Raises
    ------
    InputError
        A line is not a name and 12 numbers; names the line.
    """
    check_rows(text.count("\n"), where)
    found: Cameras = {}
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip():
            continue
        words = line.rsplit(maxsplit=12)
        at = f"{where}, line {number}"
        p = np.array(finite_numbers(words[1:], 12, f"the matrix of '{words[0][:60]}'", at)).reshape(3, 4)
        # P is known up to a factor: with det(K·R) > 0, R is a rotation and not a reflection.
        p = p * np.sign(np.linalg.det(p[:, :3]))
        # A = K·R with K upper triangular: QR of the rows and columns in reverse.
        q, r = np.linalg.qr(p[::-1, :3].T)
        k, rotation = r.T[::-1, ::-1], q.T[::-1]
        signs = np.where(np.diag(k) < 0.0, -1.0, 1.0)
        k, rotation = k * signs, rotation * signs[:, None]
        if not (np.diag(k) > 1e-9 * np.abs(k).max()).all():
            raise InputError("this is no projection matrix: a part of it is singular", where=at)
        k = k / k[2, 2]
        position = -np.linalg.solve(p[:, :3], p[:, 3]) + (0.0 if offset is None else np.array(offset))
        camera = {
            "focal_length_px": [float(k[0, 0]), float(k[1, 1])],
            "principal_point_px": [float(k[0, 2]), float(k[1, 2])],
            "distortion": {"model": "brown", "shear": float(k[0, 1] / k[0, 0])},
        }
        pose = {"system": "pix4d", "rotation": rotation.ravel().tolist(), "position": position.tolist()}
        found[words[0]] = (camera, pose)
    return found


def _head(line: str, where: str) -> tuple[str, tuple[int, int]]:
    words = line.rsplit(maxsplit=2)
    # Python refuses to read whole numbers of thousands of digits.
    if len(words) != 3 or not all(word.isdecimal() and len(word) < 10 for word in words[1:]):
        raise InputError(f"'{line[:60]}' is not the name, width and height of an image", where=where)
    return words[0], (int(words[1]), int(words[2]))


def pix4d_texts(found: Reconstruction, name: str) -> dict[str, str]:
    """Texts of the calibrated camera parameters and of the offset, by file name.

    Parameters
    ----------
    found : Reconstruction
        In the axes of a map; images without a pose are left out.
    name : str
        File of the parameters, PROJECT + `PARAMETERS`.

    Raises
    ------
    InputError
        The name has another ending, or a camera no size or a lens that Pix4D has not.
    """
    if not name.endswith(PARAMETERS):
        raise InputError("the name has another ending than Pix4D's", where=name, hint=f"call it PROJECT{PARAMETERS}")
    found.require_map("Pix4D")
    images = [image for image in found.images if image.oriented]
    centres = np.array([image.pose[1] for image in images], dtype=np.float64).reshape(-1, 3)
    # Whole kilometres, so that sums with the offset are exact to the digits that are written.
    offset = np.floor(centres.mean(axis=0) / 1000.0) * 1000.0 if len(images) else np.zeros(3)
    lines = [
        "fileName imageWidth imageHeight", "camera matrix K [3x3]", "radial distortion [3x1]",
        "tangential distortion [2x1]", "camera position t [3x1]", "camera rotation R [3x3]",
        "camera model m = K [R|-Rt] X", "",
    ]  # fmt: skip
    for image, centre in zip(images, centres, strict=True):
        where = f"camera of {image.name}"
        camera = pixel_camera(found.camera_of(image), where)
        width, height = camera.known_size(where)
        brown = ("k1", "k2", "k3", "p1", "p2", "shear")
        camera.known_only("Pix4D", where, none=("shear",), brown=brown)
        (fx, fy), (cx, cy), k = camera.focal, camera.principal, camera.lens
        matrix = np.array([[fx, camera.shear * fx, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
        radial, tangential = ([k.get(key, 0.0) for key in keys] for keys in (brown[:3], brown[3:5]))
        rows = (*matrix, radial, tangential, centre - offset, *image.pose[0])
        lines += [f"{image.name} {width} {height}", *map(number_text, rows)]
    own = name.removesuffix(PARAMETERS) + OFFSET
    return {name: "\n".join([*lines, ""]), own: number_text(offset) + "\n"}
