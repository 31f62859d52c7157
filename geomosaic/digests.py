"""Digests (SHA-256, as hexadecimal digits) of files and values: whether a result still is that of its inputs."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.errors import InputError
from geomosaic.types import PathLike


def sha256(path: PathLike) -> str:
    """Digest of a file's bytes, in constant memory.

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


def digest_of(*parts: Any) -> str:
    """Digest of texts, bytes, arrays, and of what JSON can hold; what it cannot counts by its text.

    Each part counts with its length: ("ab", "c") is not ("a", "bc").
    """
    digest = hashlib.sha256()
    for part in parts:
        data = _bytes(part)
        digest.update(len(data).to_bytes(8, "little") + data)
    return digest.hexdigest()


def _bytes(part: Any) -> bytes:
    if isinstance(part, bytes):
        return part
    if isinstance(part, np.ndarray | np.generic):
        return np.asarray(part).tobytes()
    if isinstance(part, str):
        return part.encode()
    return json.dumps(part, sort_keys=True, separators=(",", ":"), default=str).encode()
