"""Synthetic aperture radar: range-Doppler models of detected and stripmap scenes. Nothing loads until it is used."""

from __future__ import annotations

from geomosaic_sar.entry_point import SarPlugin

plugin = SarPlugin()
