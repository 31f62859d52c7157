"""Registry of sensor plugins: listed without loading, loaded when asked for, found by name or by capability."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from importlib.metadata import Distribution, EntryPoint, entry_points
from pathlib import Path
from typing import Any

import numpy as np

from geomosaic.errors import GeomosaicError, SensorError, SensorInputError, default_hint, did_you_mean
from geomosaic.geo.crs import has_heights
from geomosaic.sensor.plugin import Capabilities, HasCameraCheck, HasRational, SensorModel, SensorPlugin, SensorRequest

GROUP = "geomosaic.sensors"
# Distribution whose sensors come before those of others where one is found by capability.
OWN = "geomosaic"
# Members that every plugin has.
MEMBERS = ("name", "summary", "inputs", "capabilities", "model", "build")


@dataclass(frozen=True, eq=False)
class SensorEntry:
    """Installed sensor plugin, not loaded.

    Attributes
    ----------
    name : str
        Sensor.
    distribution, version : str
        Package that it comes from.
    target : str
        Object of the entry point, as 'module:attribute'.
    """

    name: str
    distribution: str
    version: str
    target: str


@cache
def _points() -> tuple[EntryPoint, ...]:
    """Entry points of all installed sensors; kept, as looking through what is installed takes some 10 ms."""
    return tuple(entry_points(group=GROUP))


@cache
def _owner(distribution: Distribution) -> tuple[str, str]:
    """Name and version of a distribution; kept, as its metadata are parsed each time they are asked for."""
    metadata = distribution.metadata
    return metadata["Name"], metadata["Version"]


def _entry(point: EntryPoint) -> SensorEntry:
    name, version = _owner(point.dist) if point.dist else ("unknown", "")
    return SensorEntry(point.name, name, version, point.value)


def sensors() -> list[SensorEntry]:
    """Sensors that are installed; none of them is loaded.

    Returns
    -------
    list of SensorEntry
        By name: `name`, `distribution`, `version` and `target` of each plugin. `geomosaic sensors NAME` lists the
        inputs of one.
    """
    return sorted(map(_entry, _points()), key=lambda entry: (entry.name, entry.distribution))


@lru_cache(maxsize=64)
def plugin(name: str) -> SensorPlugin:
    """Plugin of a name, loaded.

    Parameters
    ----------
    name : str
        Name of its entry point in the group `geomosaic.sensors`.

    Raises
    ------
    SensorError
        No such sensor, two of that name, the plugin fails to import (with its cause), or it lacks members.
    """
    found = [point for point in _points() if point.name == name]
    if not found:
        names = [entry.name for entry in sensors()]
        hint = f"{did_you_mean(name, names)} installed are: {', '.join(names) or 'none'}".strip()
        raise SensorError(f"no sensor named '{name}'", where="`sensor`", hint=hint)
    # An editable and a regular installation of one package list the same entry point twice: that is no conflict.
    if len({point.value for point in found}) > 1:
        entries = sorted(map(_entry, found), key=lambda entry: entry.distribution)
        owners = " and ".join(f"{e.distribution} {e.version} ({e.target})" for e in entries)
        raise SensorError(f"two sensors are named '{name}': {owners}", hint="uninstall one of them")
    try:
        loaded: SensorPlugin = found[0].load()
    except Exception as error:
        entry = _entry(found[0])
        raise SensorError(
            f"sensor '{name}' of {entry.distribution} {entry.version} cannot be loaded: "
            f"{type(error).__name__}: {error}",
            hint="reinstall or uninstall that distribution",
        ) from error
    # Of the class first: to ask the plugin itself for its model would load all that the sensor needs.
    missing = [part for part in MEMBERS if not (hasattr(type(loaded), part) or hasattr(loaded, part))]
    if missing:
        raise SensorError(f"sensor '{name}' of {_entry(found[0]).distribution} has no {', '.join(missing)}")
    return loaded


def capabilities(name: str) -> Capabilities:
    """Capabilities of a sensor.

    Parameters
    ----------
    name : str

    Raises
    ------
    SensorError
        As `plugin`.
    """
    return plugin(name).capabilities


def _names_by_origin() -> Iterator[str]:
    """Names of the installed sensors: geomosaic's own first, so that no other plugin takes over a default."""
    entries = sensors()
    yield from dict.fromkeys(
        entry.name for entry in sorted(entries, key=lambda entry: (entry.distribution != OWN, entry.name))
    )


def _loadable() -> Iterator[tuple[str, SensorPlugin]]:
    """Names and plugins of the installed sensors that can be loaded, in the order of `_names_by_origin`."""
    for name in _names_by_origin():
        try:
            tool = plugin(name)
        except SensorError:
            continue
        yield name, tool


def _first(power: Callable[[SensorPlugin], bool], what: str) -> str:
    """Name of the first sensor with a capability; a broken plugin is an error only where no other has it."""
    broken: SensorError | None = None
    for name in _names_by_origin():
        try:
            if power(plugin(name)):
                return name
        except SensorError as error:
            broken = broken or error
    raise broken or SensorError(f"no installed sensor {what}", hint="reinstall geomosaic")


@cache
def plane_sensor() -> str:
    """Name of the sensor of plane transformations, which also takes georeferenced images."""
    return _first(lambda tool: tool.capabilities.plane_transformations, "fits plane transformations")


@cache
def rational_sensor() -> str:
    """Name of the sensor of rational polynomials (RPC)."""
    return _first(lambda tool: isinstance(tool, HasRational), "fits RPCs")


@cache
def photo_sensor() -> str:
    """Name of the sensor of photos, which are placed by a camera file and an exterior orientation."""
    return _first(
        lambda tool: tool.capabilities.needs_camera and tool.capabilities.needs_exterior, "takes photos with a camera"
    )


@cache
def relative_sensor() -> str:
    """Name of the sensor that makes models without a place, in relative metres."""
    return _first(lambda tool: tool.capabilities.relative, "makes models in relative metres")


def embedded_sensors() -> list[str]:
    """Names of the sensors whose models images may carry: rigorous ones before rational polynomials made of them."""
    found = [name for name, tool in _loadable() if tool.capabilities.embedded]
    return sorted(found, key=lambda name: isinstance(plugin(name), HasRational))


def carried_sensors(images: Sequence[tuple[Path, tuple[int, int]]]) -> list[str]:
    """Names of the sensors whose models every image carries, tried out, in the order of `embedded_sensors`.

    Parameters
    ----------
    images : sequence of (Path, (int, int))
        Files with their widths and heights.
    """
    requests = [SensorRequest(path.name, size, {}, None, str(path.parent), str(path)) for path, size in images]

    def carries(name: str, request: SensorRequest) -> bool:
        error = trial(name, request)
        # What lacks but a value that the error proposes is carried, too.
        return error is None or getattr(error, "proposed", None) is not None

    return [name for name in embedded_sensors() if all(carries(name, request) for request in requests)]


def check_camera(camera: Mapping[str, Any], where: str) -> None:
    """Check of a camera description's keys by the sensors that take one, of which one has to know them all.

    Parameters
    ----------
    camera : mapping
        As a camera file has it.
    where : str
        Named in errors.

    Raises
    ------
    SensorInputError
        No sensor knows a key; names it, and the nearest one that exists. A sensor that checks no keys takes any.
    """
    refusal: SensorInputError | None = None
    for _, tool in _loadable():
        if any(entry.name == "camera" for entry in tool.inputs):
            if not isinstance(tool, HasCameraCheck):
                return
            try:
                return tool.check_camera(camera, where)
            except SensorInputError as error:
                refusal = refusal or error
    if refusal is not None:
        raise refusal


def trial(name: str, request: SensorRequest) -> GeomosaicError | None:
    """Error of building a model, if any; its warnings are told when the model is built in earnest.

    Parameters
    ----------
    name : str
    request : SensorRequest
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            build(name, request)
    except GeomosaicError as error:
        return error
    return None


def build(name: str, request: SensorRequest) -> SensorModel:
    """Sensor model of one image.

    Parameters
    ----------
    name : str
        Sensor.
    request : SensorRequest
        Image, size, CRS and inputs of the sensor.

    Raises
    ------
    HeightDatumError
        The model depends on heights, and its CRS does not say from where they count. No plugin guesses in silence.
    SensorError
        As `plugin`, or an input of the sensor is wrong.
    """
    tool = plugin(name)
    with default_hint("correct that value, in the project or in the file it comes from"):
        model = tool.build(request)
    if not has_heights(model.crs) and _depends_on_heights(model):
        from geomosaic.sensor.plausibility import require_vertical_datum

        positions = f"the positions of sensor '{name}'"
        require_vertical_datum(model.crs, positions, request.image, lambda crs: tool.build(replace(request, crs=crs)))
    return model


def _depends_on_heights(model: SensorModel) -> bool:
    """Whether a point moves in the image when its height changes."""
    x, y, z = model.seed
    step = 1e-6 * max(abs(x), 1.0)
    image = model.ground_to_image(np.array([[x, y, z], [x + step, y, z]]))
    moved = float(np.abs(image[1] - image[0]).max())
    # Half-way to the edge of the image: a point straight below a camera does not move with its height.
    aside = step * 0.25 * min(model.size) / moved if moved > 0.0 else 0.0
    image = model.ground_to_image(np.array([[x + aside, y, z], [x + aside, y, z + 10.0]]))
    # NaN, where the model cannot see the points, compares as False: nothing is known, nothing is refused.
    return bool(np.abs(image[1] - image[0]).max() > 1e-6)
