"""The camera description: a TOML file handed to the sensor plugin as it is."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from geomosaic.errors import InputError
from geomosaic.project.tables import read_text
from geomosaic.types import PathLike

LARGEST = 4 << 20


def read_toml(path: PathLike, what: str, largest: int = LARGEST) -> dict[str, Any]:
    """Read a TOML file of limited size.

    Raises
    ------
    InputError
        Names file and line.
    """
    try:
        return tomllib.loads(read_text(path, what, largest))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"the {what} is not valid TOML: {error}", where=str(path), mend="mend that line") from None
    except RecursionError:
        raise InputError(f"the {what} is nested too deeply", where=str(path)) from None


def read_camera(path: PathLike) -> dict[str, Any]:
    """Read a camera file; a single [camera] table at the top is unwrapped."""
    if Path(path).suffix.lower() != ".toml":
        raise InputError("a camera is described in a .toml file", where=str(path), mend="see `geomosaic sensors frame`")
    values = read_toml(path, "camera file")
    camera = values.get("camera")
    if isinstance(camera, dict) and len(values) == 1:
        return dict(camera)
    return values
