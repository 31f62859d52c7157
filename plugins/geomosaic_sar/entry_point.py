"""Entry point of the sensor 'sar': its inputs, its capabilities and an example."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geomosaic.sensor.inputs import known_inputs
from geomosaic.sensor.plugin import Capabilities, ControlUse, SensorExample, SensorInput, SensorRequest

if TYPE_CHECKING:
    from pathlib import Path

    from geomosaic_sar.model import SarModel

INPUTS = (
    SensorInput(
        "metadata",
        "file with orbit, times and ranges: annotation XML of Sentinel-1 (stripmap, and GRD of all modes), main XML of "
        "TerraSAR-X and TanDEM-X (SSC stripmap and spotlight, MGD), or a JSON table",
        default="annotation/NAME.xml of Sentinel-1's measurement/NAME.tiff, the XML above TerraSAR-X's IMAGEDATA, or "
        "NAME.radar.json beside the image",
    ),
    SensorInput(
        "calibration",
        "quantity that pixels become, by the product's calibration: beta0, sigma0 or gamma0 (of the ellipsoid), or "
        "gamma0-flattened, by the area of the DEM that is lit; powers, as float32",
        default="none, amplitudes as they are",
    ),
    SensorInput("noise_removal", "take thermal noise off before, by the product's noise tables", default="false"),
    SensorInput("offset", "column and row of a cut image's upper-left corner in the scene", "px", "0, 0"),
    SensorInput(
        "refine",
        "what control points correct: none, shift (of range and azimuth time) or drift (shift, and its change along "
        "the scene)",
        default="shift",
    ),
    SensorInput(
        "points", "control points for it, each with x, y, z, col, row and optionally id and sigma (pixels)", "CRS"
    ),
)

EXAMPLE = SensorExample(
    (800, 1000),
    """\
[sensor]
name = "sar"
metadata = "scene.radar.json"

[dem]
height = 250.0
heights = "ellipsoidal"
""",
    {
        "scene.radar.json": """\
{
  "title": "circular orbit, looking right",
  "size": [800, 1000],
  "looking": "right",
  "first_row_time": -0.75,
  "row_interval": 0.0015,
  "slant_range": {"near": 850000.0, "spacing": 5.0},
  "orbit": {
    "times": [-20.0, -10.0, 0.0, 10.0, 20.0],
    "positions": [
      [4932184.8578, -715627.2837, 5016021.4432],
      [4877579.2999, -726690.2161, 5067561.7907],
      [4822410.4040, -737591.5565, 5118530.8040],
      [4766684.5978, -748329.2648, 5168922.7366],
      [4710408.3744, -758901.3286, 5218731.9072]
    ],
    "velocities": [
      [-5432.176281, -1114.304140, 5182.408299],
      [-5488.829272, -1098.247871, 5125.564350],
      [-5544.842786, -1081.986207, 5068.142528],
      [-5600.210240, -1065.521913, 5010.149307],
      [-5654.925127, -1048.857780, 4951.591224]
    ]
  }
}
"""
    },
)


class SarPlugin:
    """Plugin of the sensor 'sar'; its modules are loaded when a model is asked for."""

    name = "sar"
    summary = "radar scenes by range and Doppler: Sentinel-1, TerraSAR-X, any mission by a table; corrected by control"
    inputs = INPUTS
    capabilities = Capabilities(control=ControlUse.ADJUSTMENT, embedded=True)
    example = EXAMPLE

    @property
    def model(self) -> type[SarModel]:
        """Class of the models."""
        from geomosaic_sar.model import SarModel

        return SarModel

    def files(self, path: Path) -> tuple[Path, ...]:
        """Metadata of a scene, and calibration in files of its own, which metadata that are named have as well."""
        from geomosaic_sar.metadata import find_beside
        from geomosaic_sar.sentinel1_calibration import calibration_files

        found = path if path.suffix == ".xml" else find_beside(str(path))
        return () if found is None else (found, *(file for file in calibration_files(found) if file.is_file()))

    def build(self, request: SensorRequest) -> SarModel:
        """Make the model of one scene; see `geomosaic_sar.build`."""
        from geomosaic_sar.build import build_sar

        known_inputs(request.options, INPUTS, self.name, request.image)
        return build_sar(request)
