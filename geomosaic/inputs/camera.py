"""Camera description: interior orientation and calibration as a table that the sensor plugin reads."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from geomosaic.errors import InputError
from geomosaic.inputs.tables import read_text
from geomosaic.types import PathLike

LARGEST = 4 << 20


class Camera(Mapping[str, Any]):
    """Camera description: the keys of a camera file as values.

    Which keys there are, and in which units, is the sensor's affair: `geomosaic sensors NAME` and the page on sensors
    list them. Nested tables are mappings.

    Parameters
    ----------
    **values
        Keys of the camera file.

    Examples
    --------
    >>> Camera(focal_mm=153.2, pixel_um=14.0)["focal_mm"]
    153.2
    """

    def __init__(self, **values: Any) -> None:
        self._values = dict(values)

    @classmethod
    def read(cls, path: PathLike) -> Camera:
        """Camera of a TOML file.

        Raises
        ------
        InputError
            The file cannot be read; names file and line.
        """
        return cls(**read_camera(path))

    def __getitem__(self, key: str) -> Any:
        return self._values[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._values)

    def __len__(self) -> int:
        return len(self._values)

    def __repr__(self) -> str:
        return f"Camera({', '.join(f'{name}={value!r}' for name, value in self._values.items())})"


def read_toml(path: PathLike, what: str, largest: int = LARGEST) -> dict[str, Any]:
    """Table of a TOML file of limited size.

    Parameters
    ----------
    path : path-like
    what : str
        Kind of file for messages, such as 'camera file'.
    largest : int
        Bytes: a file picked by mistake is refused before it fills the memory.

    Returns
    -------
    dict

    Raises
    ------
    InputError
        The file cannot be read or is no TOML; names file and line.
    """
    try:
        return tomllib.loads(read_text(path, what, largest))
    except tomllib.TOMLDecodeError as error:
        raise InputError(f"the {what} is not valid TOML: {error}", where=str(path), hint="correct that line") from None
    except RecursionError:
        raise InputError(f"the {what} is nested too deeply", where=str(path)) from None


def read_camera(camera: PathLike | Camera) -> dict[str, Any]:
    """Camera description as a table; a single [camera] table at the top of a file is unwrapped.

    Parameters
    ----------
    camera : path-like or Camera
        TOML file, or values.

    Returns
    -------
    dict
        Keys as the sensor documents them.

    Raises
    ------
    InputError
        The file does not end in .toml, cannot be read, or is no TOML.
    """
    if isinstance(camera, Camera):
        return dict(camera)
    if Path(camera).suffix.lower() != ".toml":
        raise InputError(
            "a camera is described in a .toml file", where=str(camera), hint="see `geomosaic sensors NAME`"
        )
    values = read_toml(camera, "camera file")
    nested = values.get("camera")
    if isinstance(nested, dict) and len(values) == 1:
        return dict(nested)
    return values
