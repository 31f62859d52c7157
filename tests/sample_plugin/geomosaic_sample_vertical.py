"""A sensor in one file: a camera that looks straight down on a projected map, north at the top of the image."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.sensor.inputs import known_inputs, need, numbers, point_rows, positive
from geomosaic.sensor.plugin import Capabilities, ControlUse, Parameters, SensorExample, SensorInput, SensorRequest
from geomosaic.sensor.solve import resect

EXAMPLE = """\
[sensor]
name = "vertical"
position = [500000.0, 5500000.0, 1300.0]
focal_length_px = 1000.0

[exterior]
crs = "EPSG:32633"
heights = "egm96"

[dem]
height = 300.0
"""


@dataclass(frozen=True)
class VerticalModel:
    """Central projection, optical axis vertical, the map taken as a plane."""

    crs: CRS
    size: tuple[int, int]
    centre: tuple[float, float, float]
    focal: float

    @property
    def parameters(self) -> Parameters:
        """Projection centre."""
        step = self.centre[2] / self.focal
        return Parameters(("x", "y", "z"), ("m",) * 3, np.array(self.centre), np.full(3, np.inf), np.full(3, step))

    @property
    def seed(self) -> tuple[float, float, float]:
        """Point below the camera, at height 0."""
        return self.centre[0], self.centre[1], 0.0

    def ground_to_image(self, xyz: np.ndarray) -> np.ndarray:
        """Image (col, row) (N, 2) of ground (N, 3)."""
        depth = self.centre[2] - xyz[:, 2]
        scale = np.where(depth > 0, self.focal / np.where(depth > 0, depth, 1.0), np.nan)
        return np.column_stack(
            [
                self.size[0] / 2 + scale * (xyz[:, 0] - self.centre[0]),
                self.size[1] / 2 - scale * (xyz[:, 1] - self.centre[1]),
            ]
        )

    def with_values(self, values: np.ndarray) -> VerticalModel:
        """Model at another projection centre (3,)."""
        return replace(self, centre=tuple(float(v) for v in values))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {"crs": self.crs.to_wkt(), "size": list(self.size), "centre": list(self.centre), "focal": self.focal}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> VerticalModel:
        """Model of a state."""
        return cls(CRS.from_wkt(state["crs"]), tuple(state["size"]), tuple(state["centre"]), state["focal"])


class VerticalPlugin:
    """Plugin of the sensor 'vertical'."""

    name = "vertical"
    summary = "a camera that looks straight down, north at the top"
    inputs = (
        SensorInput("position", "x, y, z of the projection centre in the project's CRS", "m"),
        SensorInput("focal_length_px", "camera constant", "px"),
        SensorInput("points", "control points {x, y, z, col, row, sigma}; in a project those of [control]"),
        SensorInput("refine", "points: the position is adjusted to them; none: left as it is", default="points"),
    )
    capabilities = Capabilities(exterior=("position",), control=ControlUse.ADJUSTMENT)
    model = VerticalModel
    example = SensorExample((1000, 800), EXAMPLE)

    def build(self, request: SensorRequest) -> VerticalModel:
        """Model of one image."""
        where, options = request.image, request.options
        known_inputs(options, self.inputs, self.name, where)
        x, y, z = numbers(need(options, "position", where, "the projection centre"), 3, "position", where)
        focal = positive(need(options, "focal_length_px", where, "in pixels"), "focal_length_px", where)
        if request.crs is None:
            raise InputError("the CRS of the position is missing", where=where, hint="name it, such as EPSG:32633")
        model = VerticalModel(request.crs, request.size, (x, y, z), focal)
        if options.get("refine", "points") == "none" or not options.get("points"):
            return model
        _, rows = point_rows(options["points"], ("x", "y", "z", "col", "row"), where)
        table = np.array(rows)
        return resect(model, table[:, :3], table[:, 3:5], table[:, 5]).model


plugin = VerticalPlugin()
