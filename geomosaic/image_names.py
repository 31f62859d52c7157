"""Names of images in tables and files: file name, name without extension, and the entry that belongs to an image."""

from __future__ import annotations

import unicodedata
from collections.abc import Iterable, Mapping
from pathlib import Path, PurePath
from typing import TypeVar

from geomosaic.errors import InputError, did_you_mean
from geomosaic.stores.path import to_path

Value = TypeVar("Value")


def stem(name: str) -> str:
    """Name of an image without folders and extension; slashes may be of either kind.

    Parameters
    ----------
    name : str
    """
    # Only what looks like an extension is cut: 'IMG_0.5' keeps its '.5'.
    last = PurePath(name.replace("\\", "/")).name
    base, dot, extension = last.rpartition(".")
    return base if dot and base and extension.isalnum() and not extension.isdigit() else last


def file_name(name: str) -> str:
    """File name without folders in Unicode normal form C, for comparisons.

    Parameters
    ----------
    name : str
        Slashes may be of either kind.
    """
    # File systems of Macs separate letters from their accents (form D), tables do not.
    return unicodedata.normalize("NFC", PurePath(name.replace("\\", "/")).name)


def file_of_image(pattern: str, image: str) -> Path:
    """File that belongs to an image, by a pattern: its correction grid, its cloud mask.

    Parameters
    ----------
    pattern : str
        Path in which '{image}' is replaced by the image's name without folder and extension.
    image : str
    """
    return to_path(pattern.replace("{image}", stem(image)))


def find_by_name(rows: Mapping[str, Value], image: str) -> Value | None:
    """Entry of a table for an image, by its file name, else with the extension of either left off.

    Parameters
    ----------
    rows : mapping
        Entries by image name as written.
    image : str
        Name or path.
    """
    last = file_name(image)
    for key, value in rows.items():
        if file_name(key) == last:
            return value
    bare = stem(last)
    for key, value in rows.items():
        if bare in (file_name(key), stem(file_name(key))):
            return value
    return None


def missing_row(path: str, image: str, known: Iterable[str]) -> InputError:
    """Error about a table without a row for an image.

    Parameters
    ----------
    path : str
        Table.
    image : str
        Name or path.
    known : iterable of str
        Names in the table, for the hint.

    Returns
    -------
    InputError
        To be raised by the caller.
    """
    hint = did_you_mean(stem(image), known)
    return InputError(
        f"the table has no row for {PurePath(image).name}",
        where=path,
        hint=f"{hint} Add the row, or leave the image out" if hint else "add the row, or leave the image out",
    )
