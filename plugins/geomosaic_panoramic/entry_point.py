"""Entry point of the sensor 'panoramic': its inputs, its capabilities and an example."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geomosaic.sensor.inputs import known_inputs
from geomosaic.sensor.plugin import (
    CONTROL_POINTS,
    RAY_CORRECTIONS,
    Capabilities,
    ControlUse,
    SensorExample,
    SensorInput,
    SensorRequest,
)

if TYPE_CHECKING:
    from geomosaic_panoramic.model import PanoramicModel, RelativeStrip


INPUTS = (
    SensorInput("kind", "scanner (a line is one moment), sweeps (several lines at once) or panoramic (one sweep)"),
    SensorInput("position", "x, y, z at the middle of the image, in the CRS of the positions"),
    SensorInput("heading", "direction of the nose, clockwise from north", "deg"),
    SensorInput("north", "grid or true: the north that heading and course count from", default="grid"),
    SensorInput("course", "direction of motion, clockwise from north", "deg", "heading"),
    SensorInput("pitch", "nose up; with a track or an orbit of the scanner against the body", "deg", "0"),
    SensorInput("roll", "right wing down; as pitch", "deg", "0"),
    SensorInput("rates", "heading, pitch, roll: change per line, or per sweep", "deg", "0, 0, 0"),
    SensorInput("advance", "way over ground per line (scanner) or per sweep", "m"),
    SensorInput("v_over_h", "angular speed instead of advance: V/H per line or sweep; needs ground_height", "rad"),
    SensorInput("climb", "change of height per line or sweep", "m", "0"),
    SensorInput("track", "CSV file of a curved flight: time (s), x, y, z, heading, pitch, roll"),
    SensorInput("orbit", "table of a satellite's orbit: inclination (deg), pass = ascending or descending"),
    SensorInput("start_time", "time at the upper edge of the image, in the clock of the track", "s"),
    SensorInput("period", "time of one line or sweep, with a track or an orbit", "s"),
    SensorInput("field_of_view", "angle of the whole sweep, all columns", "deg"),
    SensorInput("lines_per_sweep", "sweeps: lines that are swept at once", default="16"),
    SensorInput("directions", "sweeps: one, or both where every other sweep runs backwards", default="one"),
    SensorInput("active", "sweeps: share of the period in which the ground is seen", default="1"),
    SensorInput("line_angle", "sweeps: angle of one line along the flight", "deg", "field_of_view / columns"),
    SensorInput("focal_length", "panoramic: focal length", "mm"),
    SensorInput("pixel_size", "panoramic: pixel of the scanned film", "mm"),
    SensorInput("image_motion", "compensation: shift of rows at 90° of scan (panoramic), per sweep", "px", "0"),
    SensorInput("columns", "right or left: side of the flight that columns run to", default="right"),
    SensorInput("ground_height", "mean height of the ground, in the vertical datum of the positions", "m", "0"),
    SensorInput(
        "treatment",
        "rigorous: geocentric, with geoid, convergence and map scale; planar: in map coordinates, wrong by the "
        "curvature of the Earth",
        default="rigorous",
    ),
    *RAY_CORRECTIONS,
    SensorInput(
        "optical_bar",
        "panoramic camera of the Ames Stereo Pipeline (.tsai, OPTICAL_BAR), in place of all above; each image "
        "has its own, under [[images]]",
    ),
    SensorInput("relative", "true: no place, only nominal numbers; the map is one of its own", default="false"),
    SensorInput("height_above_ground", "with relative: in place of a position", "m"),
    SensorInput("drift", "with relative: angle of the nose to the right of the course", "deg", "0"),
    SensorInput("latitude", "with relative and an orbit: of the middle of the image, geodetic", "deg"),
    CONTROL_POINTS,
    SensorInput(
        "refine", "points: the flight is corrected by control points; none: it stays as it is", default="points"
    ),
    SensorInput(
        "sigmas",
        "a-priori standard deviations of what control points may correct: position, speed (per line or sweep), angles, "
        "rates, or single parameters; 0 is fixed",
        "m, m, deg, deg",
        "5 % of the height above ground, 5 % of the advance, 2.9 deg; with a track 1 m, 0, 0.5 deg; rates 0",
    ),
)

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


class PanoramicPlugin:
    """Plugin of the sensor 'panoramic'; its modules are loaded when a model is asked for."""

    name = "panoramic"
    summary = "airborne across-track scanners and panoramic cameras, with attitude and motion during the scan"
    inputs = INPUTS
    capabilities = Capabilities(
        exterior=("position",),
        placements=("optical_bar",),
        control=ControlUse.ADJUSTMENT,
        ground_height=True,
        relative=True,
    )
    example = EXAMPLE

    @property
    def model(self) -> type[PanoramicModel]:
        """Class of the models."""
        from geomosaic_panoramic.model import PanoramicModel

        return PanoramicModel

    def build(self, request: SensorRequest) -> PanoramicModel | RelativeStrip:
        """Model of one image; see `geomosaic_panoramic.build`."""
        from geomosaic_panoramic.build import build_model

        known_inputs(request.options, INPUTS, self.name, request.image)
        return build_model(request)
