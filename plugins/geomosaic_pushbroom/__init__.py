"""Line scanners: SPOT and Pléiades scenes, airborne strips, scenes without metadata. Nothing loads until it is used."""

from __future__ import annotations

from geomosaic_pushbroom.entry_point import PushbroomPlugin

plugin = PushbroomPlugin()
