"""Content hashes of files, remembered by size and time, and the key of a step."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from geomosaic.errors import InputError
from geomosaic.raster.checksum import sha256

LIBRARIES = ("geomosaic", "numpy", "numba", "scipy", "rasterio", "pyproj", "shapely")
"""What can change the bytes of a result."""


@lru_cache
def versions() -> dict[str, str]:
    """Installed versions of the libraries that matter."""
    found = {}
    for name in LIBRARIES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "absent"
    return found


@dataclass
class Hashes:
    """SHA-256 of files; a file of known size and modification time is not read again.

    Attributes
    ----------
    known : dict
        Path to [size, mtime in ns, sha256].
    """

    known: dict[str, list[Any]] = field(default_factory=dict)

    def of(self, path: Path) -> str:
        """Hash of a file's content.

        Raises
        ------
        InputError
            The file is missing or unreadable.
        """
        try:
            stat = path.stat()
        except OSError:
            raise InputError("the file does not exist", where=str(path), mend="check the path") from None
        entry = self.known.get(str(path))
        if entry and entry[0] == stat.st_size and entry[1] == stat.st_mtime_ns:
            return str(entry[2])
        digest = sha256(path)
        self.known[str(path)] = [stat.st_size, stat.st_mtime_ns, digest]
        return digest


def ingredients(
    name: str, step_version: int, parameters: Mapping[str, Any], files: Mapping[str, str]
) -> dict[str, str]:
    """Everything a step's result depends on, each with its digest, so that a change can be named."""
    parts = {"step": f"{name} {step_version}"}
    parts |= {f"parameter {key}": digest_of(value) for key, value in parameters.items()}
    parts |= {f"file {path}": digest for path, digest in files.items()}
    parts |= {f"library {library}": found for library, found in versions().items()}
    return parts


def digest_of(value: Any) -> str:
    """SHA-256 of a value as JSON; what JSON does not know counts by its text."""
    text = json.dumps(value, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()
