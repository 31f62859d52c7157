"""Plane transformations: images of flat ground, map scans, and images that are georeferenced already."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from geomosaic_planar.entry_point import PlanarPlugin

plugin = PlanarPlugin()

# Loaded when first used: the program looks at the plugin of every sensor to find one by its capabilities.
_HOMES = {"PlanarFit": "fit", "PlanarModel": "model", "Transformation": "model", "fit_planar": "fit"}

__all__ = ["PlanarFit", "PlanarModel", "Transformation", "fit_planar", "plugin"]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(f"geomosaic_planar.{_HOMES[name]}"), name)
    raise AttributeError(f"module 'geomosaic_planar' has no attribute '{name}'")
