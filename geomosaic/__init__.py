"""geomosaic: from raw photos and scenes to georeferenced, colour-balanced mosaics and map sheets.

The public names load their modules on first use, so that `import geomosaic` costs next to nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_HOMES = {
    "Grid": "geomosaic.geo.grid",
    "Window": "geomosaic.geo.grid",
    "parse_crs": "geomosaic.geo.crs",
    "with_heights": "geomosaic.geo.crs",
    "Transform": "geomosaic.geo.transform",
    "Parameters": "geomosaic.sensor.model",
    "SensorModel": "geomosaic.sensor.model",
    "SensorRequest": "geomosaic.sensor.plugin",
    "GeomosaicError": "geomosaic.errors",
}

__all__ = ["__version__", *sorted(_HOMES)]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'geomosaic' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
