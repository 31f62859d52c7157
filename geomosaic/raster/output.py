"""Final names: taken only with leave, and only by whole files."""

from __future__ import annotations

import os
from pathlib import Path

from geomosaic.errors import InputError, OutputExistsError


def check_output(path: Path, *, overwrite: bool) -> None:
    """Refuse a final name that is taken, or whose folder does not exist.

    Raises
    ------
    OutputExistsError
        The file exists and `overwrite` is false.
    InputError
        The name is a folder's, or its folder does not exist.
    """
    if path.is_dir():
        raise InputError("the output is a folder", where=str(path), mend="name a file")
    if not path.parent.is_dir():
        raise InputError("the folder of the output does not exist", where=str(path), mend="make it, or check the path")
    if path.exists() and not overwrite:
        raise OutputExistsError("the output exists", where=str(path), mend="choose another name, or give --overwrite")


def sync(path: Path) -> None:
    """Bring a file, or a folder's entries, to the disk."""
    if os.name == "nt" and path.is_dir():
        return
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
