"""A sensor in one file: a camera that looks straight down on a projected map, north at the top of the image."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.sensor.model import Parameters
from geomosaic.sensor.plugin import SensorExample, SensorInput, SensorRequest
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
        """The projection centre."""
        step = self.centre[2] / self.focal
        return Parameters(("x", "y", "z"), ("m",) * 3, np.array(self.centre), np.full(3, np.inf), np.full(3, step))

    @property
    def seed(self) -> tuple[float, float, float]:
        """Below the camera, at height 0."""
        return self.centre[0], self.centre[1], 0.0

    def ground_to_image(self, xyz: np.ndarray) -> np.ndarray:
        """Ground (N, 3) to (col, row) (N, 2)."""
        depth = self.centre[2] - xyz[:, 2]
        scale = np.where(depth > 0, self.focal / np.where(depth > 0, depth, 1.0), np.nan)
        return np.column_stack(
            [
                self.size[0] / 2 + scale * (xyz[:, 0] - self.centre[0]),
                self.size[1] / 2 - scale * (xyz[:, 1] - self.centre[1]),
            ]
        )

    def with_values(self, values: np.ndarray) -> VerticalModel:
        """Move the projection centre."""
        return replace(self, centre=tuple(float(v) for v in values))

    def to_dict(self) -> dict[str, Any]:
        """State."""
        return {"crs": self.crs.to_wkt(), "size": list(self.size), "centre": list(self.centre), "focal": self.focal}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> VerticalModel:
        """Model of a state."""
        return cls(CRS.from_wkt(state["crs"]), tuple(state["size"]), tuple(state["centre"]), state["focal"])


class VerticalPlugin:
    """The door."""

    name = "vertical"
    summary = "a camera that looks straight down, north at the top"
    inputs = (
        SensorInput("position", "x, y, z of the projection centre in the project's CRS", "m"),
        SensorInput("focal_length_px", "camera constant", "px"),
        SensorInput("points", "control points {x, y, z, col, row, sigma}; in a project those of [control]"),
        SensorInput("refine", "points: the position is adjusted to them; none: left as it is", default="points"),
    )
    model = VerticalModel
    example = SensorExample((1000, 800), EXAMPLE)

    def build(self, request: SensorRequest) -> VerticalModel:
        """Make the model of one image."""
        names = [entry.name for entry in self.inputs]
        unknown = [key for key in request.options if key not in names]
        if unknown:
            raise InputError(f"no input '{unknown[0]}'", where=request.image, hint=f"the inputs are {', '.join(names)}")
        missing = [key for key in ("position", "focal_length_px") if key not in request.options]
        if missing or request.crs is None:
            raise InputError(f"{', '.join(missing) or 'the CRS of the position'} is missing", where=request.image)
        x, y, z = (float(value) for value in request.options["position"])
        model = VerticalModel(request.crs, request.size, (x, y, z), float(request.options["focal_length_px"]))
        points = request.options.get("points", ()) if request.options.get("refine", "points") == "points" else ()
        if not points:
            return model
        ground = np.array([[p["x"], p["y"], p["z"]] for p in points], dtype=float)
        image = np.array([[p["col"], p["row"]] for p in points], dtype=float)
        return resect(model, ground, image, np.array([p.get("sigma", 1.0) for p in points])).model


plugin = VerticalPlugin()
