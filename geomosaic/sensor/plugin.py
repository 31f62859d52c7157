"""What a sensor plugin offers at its door."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from pyproj import CRS

from geomosaic.sensor.model import SensorModel


@dataclass(frozen=True, eq=False)
class SensorInput:
    """One input of a plugin, for `geomosaic sensors NAME` and for error messages."""

    name: str
    text: str
    unit: str = ""
    default: str | None = None


@dataclass(frozen=True, eq=False)
class SensorExample:
    """A whole example for `geomosaic sensors NAME`: it runs as it is shown, with any image of that size.

    Attributes
    ----------
    size : tuple of int
        Width and height of the image in pixels.
    project : str
        Sections of a project file without [project]: [sensor] and what it needs.
    files : mapping of str to str
        Files that it names, beside the project: name to text.
    """

    size: tuple[int, int]
    project: str
    files: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class SensorRequest:
    """What is known about one image when its model is asked for.

    Attributes
    ----------
    image : str
        The image's name, for messages.
    size : tuple of int
        Width and height in pixels.
    options : mapping
        The plugin's own inputs: numbers, strings, lists and nested mappings, as TOML has them.
    crs : CRS, optional
        3-D (or 2-D, for models without heights) CRS in which positions in `options` are given.
    base : str
        Folder that relative file names in `options` start from.
    path : str, optional
        The image's own file, for sensors that read what it carries or what lies beside it.
    """

    image: str
    size: tuple[int, int]
    options: Mapping[str, Any] = field(default_factory=dict)
    crs: CRS | None = None
    base: str = "."
    path: str | None = None


class SensorPlugin(Protocol):
    """A sensor, as found through the entry point group 'geomosaic.sensors'."""

    name: str
    summary: str
    inputs: tuple[SensorInput, ...]
    model: type[SensorModel]

    def build(self, request: SensorRequest) -> SensorModel:
        """Make the model of one image.

        Raises
        ------
        InputError
            An input is missing, unknown or out of range; it names the image and the input.
        """


@runtime_checkable
class HasExample(Protocol):
    """Optional power of a plugin: an example that runs."""

    example: SensorExample


@runtime_checkable
class HasFiles(Protocol):
    """Optional power of a plugin: which files beside an image its model comes from, so that their change is noticed."""

    def files(self, path: Path) -> tuple[Path, ...]:
        """Files that belong to the image by their names, as far as they are there."""
