"""Checksums of files, read in pieces."""

from __future__ import annotations

import hashlib
from pathlib import Path

from geomosaic.errors import InputError
from geomosaic.types import PathLike


def sha256(path: PathLike) -> str:
    """SHA-256 of a file's bytes as 64 hexadecimal digits, in constant memory.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    try:
        with Path(path).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror})", where=str(path)) from error
