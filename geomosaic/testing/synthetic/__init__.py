"""Photos of a ground that is known exactly: analytic relief and colour, rendered through any sensor model.

ground = AnalyticGround(with_heights(parse_crs("EPSG:32633"), "egm96"), origin=(400000.0, 5500000.0))
for photo in synthetic_block(ground, CAMERA, FlightPlan(strips=3, photos=4)):
    pixels = render(photo.camera(CAMERA, ground), ground, vignetting=Vignetting(0.3))
"""

from __future__ import annotations

from geomosaic.testing.synthetic.block import CAMERA, FlightPlan, PlainCamera, SyntheticPhoto, synthetic_block
from geomosaic.testing.synthetic.ground import AnalyticGround
from geomosaic.testing.synthetic.photo import Exposure, Vignetting, coordinates, intersect, radiance, render, trace

__all__ = [
    "CAMERA",
    "AnalyticGround",
    "Exposure",
    "FlightPlan",
    "PlainCamera",
    "SyntheticPhoto",
    "Vignetting",
    "coordinates",
    "intersect",
    "radiance",
    "render",
    "synthetic_block",
    "trace",
]
