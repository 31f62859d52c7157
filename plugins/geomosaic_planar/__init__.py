"""Plane transformations: images of flat ground, map scans, and images that are georeferenced already."""

from __future__ import annotations

from geomosaic_planar.build import PlanarPlugin
from geomosaic_planar.fit import PlanarFit, fit_planar
from geomosaic_planar.model import PlanarModel

plugin = PlanarPlugin()

__all__ = ["PlanarFit", "PlanarModel", "PlanarPlugin", "fit_planar", "plugin"]
