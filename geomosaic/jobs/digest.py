"""The key of a step: everything its result depends on."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from typing import Any

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
