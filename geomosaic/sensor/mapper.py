"""From the output map and a surface's heights to the image, through every CRS in between."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pyproj import CRS

from geomosaic.geo.crs import has_heights, horizontal
from geomosaic.geo.transform import Transform
from geomosaic.geo.turn import near, whole_turn
from geomosaic.sensor.model import SensorModel
from geomosaic.types import FloatArray


@dataclass(frozen=True, eq=False)
class MapToImage:
    """Map (x, y) of the output and height z of the surface to image (col, row).

    The map point is first brought to the surface's own map, where z has its meaning; only then do both go together to
    the model's frame. So heights never change their datum by accident.

    Attributes
    ----------
    model : SensorModel
    to_surface : Transform
        Output map → horizontal CRS of the surface (or of the model, where heights play no part).
    to_model : Transform
        Surface CRS → CRS of the model.
    turn : float, optional
        A whole turn of longitude, where the image lies in longitude and latitude: of places that are the same, the one
        nearest to its middle is meant.
    """

    model: SensorModel
    to_surface: Transform
    to_model: Transform
    turn: float | None = None

    @classmethod
    def between(cls, output: CRS, surface: CRS | None, model: SensorModel) -> MapToImage:
        """Chain output map, surface (None: heights play no part) and model."""
        if surface is None or not has_heights(model.crs):
            flat = horizontal(model.crs)
            return cls(model, Transform(horizontal(output), flat), Transform(flat, flat), whole_turn(flat))
        return cls(model, Transform(horizontal(output), horizontal(surface)), Transform(surface, model.crs))

    @property
    def uses_heights(self) -> bool:
        """Whether the image position depends on height."""
        return self.to_model.spatial

    def surface_xy(self, xy: FloatArray) -> FloatArray:
        """Output map (N, 2) to the surface's map (N, 2)."""
        found = self.to_surface(xy)
        return found if self.turn is None else near(found, self.model.seed[0], self.turn)

    def image(self, surface_xy: FloatArray, z: FloatArray) -> FloatArray:
        """Surface map (N, 2) and heights (N,) to image (N, 2)."""
        return self.model.ground_to_image(self.to_model(np.column_stack([surface_xy, z])))

    def __call__(self, xy: FloatArray, z: FloatArray) -> FloatArray:
        """Output map (N, 2) and surface heights (N,) to image (N, 2)."""
        return self.image(self.surface_xy(xy), z)
