"""Sensor 'panoramic': airborne across-track scanners and panoramic cameras."""

from __future__ import annotations

from geomosaic_panoramic.build import PanoramicPlugin

plugin = PanoramicPlugin()
