"""Public test tools: the conformance kit for sensor plugins and synthetic blocks with exact truth."""

from __future__ import annotations

from importlib import import_module
from typing import Any

_HOMES = {
    "SensorModelTests": "geomosaic.testing.conformance",
    "check_plugin": "geomosaic.testing.plugin_tests",
    "failures": "geomosaic.testing.conformance",
}

__all__ = sorted(_HOMES)


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(_HOMES[name]), name)
    raise AttributeError(f"module 'geomosaic.testing' has no attribute '{name}'")


def __dir__() -> list[str]:
    return sorted(__all__)
