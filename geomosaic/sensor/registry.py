"""Finding sensor plugins: listed without loading, loaded when asked for."""

from __future__ import annotations

import difflib
from dataclasses import dataclass, replace
from functools import lru_cache
from importlib.metadata import EntryPoint, entry_points

import numpy as np

from geomosaic.errors import SensorError
from geomosaic.geo.crs import has_heights
from geomosaic.sensor.model import SensorModel
from geomosaic.sensor.plugin import SensorPlugin, SensorRequest

GROUP = "geomosaic.sensors"


@dataclass(frozen=True, eq=False)
class SensorEntry:
    """An installed plugin, not loaded: its name, and the distribution and version it comes from."""

    name: str
    distribution: str
    version: str
    target: str


def _entry(point: EntryPoint) -> SensorEntry:
    """Read the distribution's metadata: parsing it takes longer than finding the sensor."""
    dist = point.dist
    return SensorEntry(point.name, dist.name if dist else "unknown", dist.version if dist else "", point.value)


def installed() -> list[SensorEntry]:
    """List the installed sensors, in the order of their names; none is imported."""
    return sorted(map(_entry, entry_points(group=GROUP)), key=lambda entry: (entry.name, entry.distribution))


@lru_cache(maxsize=64)
def plugin(name: str) -> SensorPlugin:
    """Load one plugin.

    Raises
    ------
    SensorError
        No such sensor, two of that name, or the plugin fails to import (with its cause).
    """
    found = list(entry_points(group=GROUP, name=name))
    if not found:
        names = [entry.name for entry in installed()]
        close = difflib.get_close_matches(name, names, 1)
        hint = f"did you mean '{close[0]}'? " if close else ""
        raise SensorError(f"no sensor named '{name}'", hint=f"{hint}installed are: {', '.join(names) or 'none'}")
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
    missing = [part for part in ("name", "summary", "inputs", "model", "build") if not hasattr(loaded, part)]
    if missing:
        raise SensorError(f"sensor '{name}' of {_entry(found[0]).distribution} has no {', '.join(missing)}")
    return loaded


def build(name: str, request: SensorRequest) -> SensorModel:
    """Make the model of one image with the sensor `name`.

    Raises
    ------
    HeightDatumError
        The model depends on heights, and its CRS does not say from where they count. No plugin guesses in silence.
    """
    tool = plugin(name)
    model = tool.build(request)
    if not has_heights(model.crs) and _depends_on_heights(model):
        from geomosaic.sensor.vertical_datum import need_heights

        positions = f"the positions of sensor '{name}'"
        need_heights(model.crs, positions, request.image, lambda crs: tool.build(replace(request, crs=crs)))
    return model


def _depends_on_heights(model: SensorModel) -> bool:
    """Whether a place moves in the image when its height changes; half-way to the edge, as below a camera none does."""
    x, y, z = model.seed
    step = 1e-6 * max(abs(x), 1.0)
    image = model.ground_to_image(np.array([[x, y, z], [x + step, y, z]]))
    moved = float(np.abs(image[1] - image[0]).max())
    aside = step * 0.25 * min(model.size) / moved if moved > 0.0 else 0.0
    image = model.ground_to_image(np.array([[x + aside, y, z], [x + aside, y, z + 10.0]]))
    return bool(np.abs(image[1] - image[0]).max() > 1e-6)  # NaN is neither
