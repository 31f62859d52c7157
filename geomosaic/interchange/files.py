"""Bytes of files of other programs, within bounds, their numbers, and the program that wrote them."""

from __future__ import annotations

import re
import warnings
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from geomosaic.errors import InputError
from geomosaic.sensor.inputs import LARGEST as LARGEST_NUMBER
from geomosaic.sensor.inputs import finite_number
from geomosaic.types import FloatArray

# Bytes; no file of orientations is that long.
LARGEST = 256 << 20

# Bytes of a file that are looked at to recognise it.
_FIRST = 4096

# How names of Pix4D's files of cameras end.
PIX4D = ("_calibrated_camera_parameters.txt", "_pmatrix.txt")


def read_bytes(path: Path, where: str) -> bytes:
    """Bytes of a file of limited size; kept, since all images of a block ask for them.

    Parameters
    ----------
    path : Path
    where : str
        Named in errors.

    Raises
    ------
    InputError
        The file is missing, unreadable or too large.
    """
    try:
        status = path.stat()
        if status.st_size > LARGEST:
            raise InputError(f"{path} is larger than {LARGEST >> 20} MB", where=where, hint="is it the right file?")
        return _kept(path, status.st_size, status.st_mtime_ns)
    except OSError as error:
        raise InputError(
            f"the file {path} cannot be read: {error.strerror or error}", where=where, hint="check the path"
        ) from error


@lru_cache(maxsize=8)
def _kept(path: Path, size: int, changed: int) -> bytes:
    return path.read_bytes()


def decoded(data: bytes, path: Path | str, where: str) -> str:
    """Text of UTF-8 bytes, without a byte order mark.

    Parameters
    ----------
    data : bytes
    path : Path or str
        File that they come from.
    where : str
        Named in errors.

    Raises
    ------
    InputError
        They are no UTF-8.
    """
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            f"{path} is not UTF-8 text (byte {error.start})", where=where, hint="save it as UTF-8 text"
        ) from None


def read_text(path: Path, where: str) -> str:
    """Text of a file, as `read_bytes` and `decoded`.

    Parameters
    ----------
    path : Path
    where : str
        Named in errors.
    """
    return decoded(read_bytes(path, where), path, where)


def all_numbers(text: str, where: str, first_line: int = 1) -> FloatArray:
    """Numbers (N,) of a text that holds nothing else.

    Parameters
    ----------
    text : str
        Numbers between blanks and line ends.
    where : str
        File, named in errors with the line.
    first_line : int
        Number of the text's first line in the file.

    Raises
    ------
    InputError
        A word is no finite number of a sensible size.
    """
    try:
        # Ten times as fast as a list of words, of which millions would not fit into memory.
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            values = np.fromstring(text, sep=" ")
        if (np.abs(values) <= LARGEST_NUMBER).all():  # NaN and inf are not
            return values
    except (DeprecationWarning, ValueError):
        pass
    for at, line in enumerate(text.splitlines(), first_line):
        for word in line.split():
            if np.isnan(finite_number(word)):
                what = f"'{word[:40]}' is not a finite number of a sensible size"
                raise InputError(what, where=f"{where}, line {at}", hint=None)
    raise InputError("the file holds something else than numbers", where=where, hint=None)


def number_text(values: ArrayLike) -> str:
    """Numbers with all their digits and blanks between, as texts of other programs have them.

    Parameters
    ----------
    values : array
    """
    return " ".join(map(repr, np.asarray(values, dtype=np.float64).ravel().tolist()))


def program_of(path: Path) -> str | None:
    """Program that wrote an orientation file, recognised by its name and first bytes.

    Parameters
    ----------
    path : Path

    Returns
    -------
    str or None
        'pix4d', 'metashape', 'colmap', 'ori' or 'tsai', which are angle systems, too; None for any other file.
    """
    try:
        with path.open("rb") as file:
            data = file.read(_FIRST)
    except OSError:
        return None
    start, ending = data.decode("utf-8", "replace").lower(), path.suffix.lower()
    if ending == ".xml" and "<document" in start and "<chunk" in start:
        return "metashape"
    if ending == ".xml" and "<orientation" in start and "<extrinseque" in start:
        return "ori"
    if "# photoid, x, y, z, omega, phi, kappa" in start:
        return "metashape"
    if start.startswith("version_") and "\nfu" in start and "\npitch" in start:
        return "tsai"
    if ending == ".adjust":
        return "tsai"
    if "camera model m = k [r|-rt] x" in start or path.name.endswith(PIX4D):
        return "pix4d"
    if path.name == "images.bin" or (path.name == "images.txt" and "qw, qx, qy, qz" in start):
        return "colmap"
    return None


def of_image(stem: str, image: str) -> bool:
    """Whether a file [PREFIX-]STEM belongs to an image by its name, as the files of the Ames Stereo Pipeline do.

    Parameters
    ----------
    stem : str
        Name of the file without extension.
    image : str
        Name of the image.
    """
    return re.fullmatch(rf"(.*[^0-9A-Za-z])?{re.escape(Path(image).stem)}", stem) is not None


def pinhole_files(file: Path) -> tuple[tuple[Path, ...], tuple[Path, ...]]:
    """Cameras (.tsai) that are read with one of them, and adjustments (.adjust) that are read with one of these.

    Parameters
    ----------
    file : Path
        A folder of them, a camera, or an adjustment, whose cameras lie beside it or a folder up: bundle_adjust writes
        into a folder of its own.
    """
    folder = file.absolute() if file.is_dir() else file.absolute().parent
    cameras = sorted(folder.glob("*.tsai"))
    if not file.is_dir() and file.suffix.lower() != ".adjust":
        return tuple(sorted({*cameras, file.absolute()})), ()
    return tuple(cameras or sorted(folder.parent.glob("*.tsai"))), tuple(sorted(folder.glob("*.adjust")))
