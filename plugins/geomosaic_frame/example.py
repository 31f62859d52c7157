"""An example for `geomosaic sensors frame`: one nadir photo, 1200 m above the ground."""

from __future__ import annotations

from geomosaic.sensor.plugin import SensorExample

EXAMPLE = SensorExample(
    (4000, 3000),
    """\
[sensor]
name = "frame"
camera = "camera.toml"
position = [500000.0, 5500000.0, 1500.0]
orientation = { system = "opk", omega = 1.5, phi = -0.8, kappa = 91.0 }

[exterior]
crs = "EPSG:32633"
heights = "egm96"

[dem]
height = 300.0
""",
    {
        "camera.toml": """\
focal_length = 24.0          # mm
sensor_size = [36.0, 27.0]   # mm
distortion = { model = "brown", k1 = -0.05 }
"""
    },
)
