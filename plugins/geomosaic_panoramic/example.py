"""An example for `geomosaic sensors panoramic`: an across-track scanner, 3000 m above the ground."""

from __future__ import annotations

from geomosaic.sensor.plugin import SensorExample

EXAMPLE = SensorExample(
    (1000, 1200),
    """\
[sensor]
name = "panoramic"
kind = "scanner"
position = [500000.0, 5500000.0, 3300.0]
heading = 30.0
advance = 6.0
field_of_view = 90.0
ground_height = 300.0

[exterior]
crs = "EPSG:32633"
heights = "egm96"

[dem]
height = 300.0
""",
)
