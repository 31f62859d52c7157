"""Monoplotting both ways: pixels to places on the ground with their error, and map vectors into a photo."""

from __future__ import annotations

from geomosaic.monoplotting.line_drawing import Drawing, View, draw
from geomosaic.monoplotting.places import Places, ground_crs, locate
from geomosaic.sensor.error_propagation import Ellipses, InputUncertainty, ellipses

__all__ = [
    "Drawing",
    "Ellipses",
    "InputUncertainty",
    "Places",
    "View",
    "draw",
    "ellipses",
    "ground_crs",
    "locate",
]
