"""An example for `geomosaic sensors pushbroom`: an airborne strip with its track; SPOT needs METADATA.DIM alone."""

from __future__ import annotations

from geomosaic.sensor.plugin import SensorExample

EXAMPLE = SensorExample(
    (1000, 500),
    """\
[sensor]
name = "pushbroom"
track = "track.csv"
focal_length_px = 1200.0
columns = "right"
start_time = 100.0
line_period = 0.02

[exterior]
crs = "EPSG:32633"
heights = "egm96"

[dem]
height = 300.0
""",
    {
        "track.csv": """\
time,x,y,z,roll,pitch,heading
98.0,499880.0,5500000.0,1500.0,0.4,0.1,90.0
100.0,500000.0,5500000.5,1500.2,0.5,0.1,90.2
102.0,500120.0,5500001.0,1500.1,0.3,0.2,90.1
104.0,500240.0,5500001.2,1499.8,0.2,0.2,89.9
106.0,500360.0,5500001.1,1499.9,0.4,0.1,89.8
108.0,500480.0,5500000.8,1500.0,0.5,0.0,90.0
110.0,500600.0,5500000.4,1500.3,0.6,0.0,90.1
112.0,500720.0,5500000.2,1500.1,0.5,0.1,90.0
"""
    },
)
