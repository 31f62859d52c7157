"""Monoplotting both ways: pixels to places on the ground with their error, and map vectors into a photo."""

from __future__ import annotations

from geomosaic.product.locate.certainty import Certainty, orientation
from geomosaic.product.locate.draw import Drawing, draw
from geomosaic.product.locate.ellipse import Ellipses, ellipses
from geomosaic.product.locate.places import Places, ground_crs, locate
from geomosaic.product.locate.view import View

__all__ = [
    "Certainty",
    "Drawing",
    "Ellipses",
    "Places",
    "View",
    "draw",
    "ellipses",
    "ground_crs",
    "locate",
    "orientation",
]
