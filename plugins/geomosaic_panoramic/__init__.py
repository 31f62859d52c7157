"""Airborne and spaceborne across-track scanners and panoramic cameras."""

from __future__ import annotations

from geomosaic_panoramic.entry_point import PanoramicPlugin

plugin = PanoramicPlugin()
