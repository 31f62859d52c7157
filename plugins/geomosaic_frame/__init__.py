"""The frame camera: aerial and drone photos, film scans, fisheye lenses. Nothing is loaded until it is used."""

from __future__ import annotations

from geomosaic_frame.entry_point import FramePlugin

plugin = FramePlugin()
