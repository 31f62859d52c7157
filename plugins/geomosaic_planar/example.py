"""An example for `geomosaic sensors planar`: four control points and a projective transformation."""

from __future__ import annotations

from geomosaic.sensor.plugin import SensorExample

EXAMPLE = SensorExample(
    (1200, 800),
    """\
[sensor]
name = "planar"
kind = "projective"
points = [
  { x = 500000.0, y = 5500080.0, col = 0.0, row = 0.0 },
  { x = 500118.0, y = 5500082.0, col = 1200.0, row = 0.0 },
  { x = 500121.0, y = 5500001.0, col = 1200.0, row = 800.0 },
  { x = 500001.0, y = 5499999.0, col = 0.0, row = 800.0 },
]

[exterior]
crs = "EPSG:32633"
""",
)
