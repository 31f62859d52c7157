"""Entry point of the sensor 'pushbroom': its inputs, its capabilities and an example."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geomosaic.sensor.inputs import known_inputs
from geomosaic.sensor.plugin import CONTROL_POINTS, Capabilities, ControlUse, SensorExample, SensorInput, SensorRequest

if TYPE_CHECKING:
    from pathlib import Path

    from geomosaic_pushbroom.model import PushbroomModel

INPUTS = (
    SensorInput(
        "metadata",
        "file with orbit, attitude and look angles: METADATA.DIM of SPOT 1 to 5 (level 1A), DIM_....XML of SPOT 6 and "
        "7, Pléiades and Pléiades Neo (level SENSOR), DigitalGlobe XML of QuickBird and WorldView (Basic 1B), or an "
        "OSSIM keyword list of SPOT 5; none: there is none, and what lies beside is not taken",
        default="METADATA.DIM, NAME.DIM, or DIM_x.XML of IMG_x.TIF, beside the image, else the only file there that is "
        "of a scene of its size",
    ),
    SensorInput("band", "band whose look angles are taken, where those of the bands differ (BAND_INDEX, BAND_ID)"),
    SensorInput(
        "offset",
        "column and row of a cut image's upper-left corner in the scene of the metadata",
        "px",
        "0, 0",
    ),
    CONTROL_POINTS,
    SensorInput(
        "refine",
        "points: metadata or track are corrected by the control points, within their sigmas; none: left as they are. "
        "Without metadata and track the points alone make the model",
        default="points",
    ),
    SensorInput(
        "sigmas",
        "a-priori standard deviations of what control points may correct: angles, or roll, pitch, yaw in degrees; "
        "rates, or roll_rate, pitch_rate, yaw_rate in degrees/s; position, or across, along, up in m; time in s; 0 is "
        "fixed",
        "deg, deg/s, m, s",
        "by mission; time 0",
    ),
    SensorInput(
        "attitude_degree",
        "degree over the scene of the corrections of roll, pitch and yaw that control and tie points may make to "
        "metadata or track, 1 to 12; from 2 on sigmas may have curve in degrees",
        default="1",
    ),
    SensorInput(
        "focal_length_px",
        "camera constant in pixels: needed with a track; without metadata this or flying_height",
        "px",
    ),
    SensorInput("flying_height", "above the ground, where nothing is reported and no focal_length_px is given", "m"),
    SensorInput("principal_col", "column of the principal point", "px", "the middle"),
    SensorInput(
        "additional",
        "additional parameters of the model from points alone: all, none, or a list of omega1, phi1, kappa1, omega2, "
        "phi2, kappa2, bend, stretch",
        default="all from 10 points, else none",
    ),
    SensorInput(
        "track",
        "CSV file of an airborne strip: time (s), x, y, z in the declared CRS, and roll, pitch, heading (aircraft, "
        "true north) or omega, phi, kappa (grid north)",
    ),
    SensorInput("columns", "right or left: to which side of the flight columns grow, with a track"),
    SensorInput("angle_unit", "unit of the angles of the track: deg, gon or rad", default="deg"),
    SensorInput("start_time", "time of the first row's middle in the clock of the track", "s"),
    SensorInput("line_period", "time from one row to the next, with a track", "s"),
    SensorInput(
        "ground_height",
        "rough height of the ground in the declared vertical datum, to start inverses; no result depends on it",
        "m",
        "that of the DEM below the scanner; 0 without",
    ),
)

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


class PushbroomPlugin:
    """Plugin of the sensor 'pushbroom'; its modules are loaded when a model is asked for."""

    name = "pushbroom"
    summary = (
        "line scanner: SPOT, Pléiades and WorldView by metadata, strips by a GNSS track, scenes by control points alone"
    )
    inputs = INPUTS
    capabilities = Capabilities(control=ControlUse.ADJUSTMENT, ground_height=True, embedded=True)
    example = EXAMPLE

    @property
    def model(self) -> type[PushbroomModel]:
        """Class of the models."""
        from geomosaic_pushbroom.model import PushbroomModel

        return PushbroomModel

    def files(self, path: Path) -> tuple[Path, ...]:
        """Metadata beside a scene."""
        from geomosaic_pushbroom.metadata import find_beside, metadata_in_folder

        found = find_beside(str(path))
        return tuple(metadata_in_folder(str(path))) if found is None else (found,)

    def build(self, request: SensorRequest) -> PushbroomModel:
        """Make the model of one scene or strip; see `geomosaic_pushbroom.build`."""
        from geomosaic_pushbroom.build import build_pushbroom

        known_inputs(request.options, INPUTS, self.name, request.image)
        return build_pushbroom(request)
