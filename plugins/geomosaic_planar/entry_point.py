"""Entry point of the sensor 'planar': its inputs, its capabilities and an example."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geomosaic.sensor.inputs import known_inputs
from geomosaic.sensor.plugin import Capabilities, ControlUse, SensorExample, SensorInput, SensorRequest
from geomosaic_planar.terms import KINDS, MAX_ORDER

if TYPE_CHECKING:
    from geomosaic_planar.model import PlanarModel

INPUTS = (
    SensorInput("transform", "a, b, c, d, e, f: pixel corner to map, x = a col + b row + c, y = d col + e row + f"),
    SensorInput("geotransform", "the same in GDAL's order: c, a, b, f, d, e"),
    SensorInput("points", "control points, each with x, y, col, row and optionally sigma (pixels)"),
    SensorInput("coefficients", "coefficients ground to image, by name or in the order of `parameters`", "px"),
    SensorInput("kind", f"{', '.join(KINDS)}; for points and coefficients", default="affine"),
    SensorInput("order", f"degree of a polynomial, 1 to {MAX_ORDER}", default="1"),
    SensorInput(
        "axes",
        "left (rows downwards) or right (rows upwards, mirrored image) for kind conformal",
        default="recognised from points, left for coefficients",
    ),
    SensorInput("centre", "map x, y that the coefficients count from", "map units", "0, 0"),
    SensorInput("scale", "map units that the coefficients count as 1", "map units", "1"),
)

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


class PlanarPlugin:
    """Plugin of the sensor 'planar'; its modules are loaded when a model is asked for."""

    name = "planar"
    summary = "plane transformations of flat ground: conformal, affine, projective, polynomial of order 1 to 5, spline"
    inputs = INPUTS
    capabilities = Capabilities(
        planar=True,
        placements=("transform", "geotransform", "points", "coefficients"),
        plane_transformations=True,
        control=ControlUse.RESECTION,
    )
    example = EXAMPLE

    @property
    def model(self) -> type[PlanarModel]:
        """Class of the models."""
        from geomosaic_planar.model import PlanarModel

        return PlanarModel

    def build(self, request: SensorRequest) -> PlanarModel:
        """Model of one image; see `geomosaic_planar.build`."""
        from geomosaic_planar.build import build_model

        known_inputs(request.options, INPUTS, self.name, request.image)
        return build_model(request)
