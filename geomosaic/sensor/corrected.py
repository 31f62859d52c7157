"""Sensor models with a correction grid, and the state of any model as JSON values.

    corrected = ideal + d(ideal)

The **ideal** position is where the wrapped model puts a ground point; the **corrected** one is where the image really
shows it. So a grid holds *real minus ideal*, looked up at the ideal position: for a camera with systematic image errors
these are the mean residuals (measured minus computed) of its photos, and for two photos that are to meet along an edge
they are the residuals of their common points. The way back, from a measured position to a line of sight, takes the
correction off again, by iteration to 1e-9 pixel.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self, cast

import numpy as np
from pyproj import CRS

from geomosaic.sensor.correction_grid import CorrectionGrid
from geomosaic.sensor.model import HasRays, Parameters, SensorModel
from geomosaic.sensor.registry import plugin
from geomosaic.sensor.solve.derivatives import jacobian
from geomosaic.types import FloatArray


@dataclass(frozen=True, eq=False)
class Corrected:
    """A sensor model with a correction grid behind it; make one with `Corrected.of`.

    The parameters are those of the wrapped model; the grid is held. It can be wrapped again: corrections of a camera
    first, those of an edge on top.

    Attributes
    ----------
    model : SensorModel
        Ground to ideal image position.
    grid : CorrectionGrid
        Real minus ideal position, at the ideal position, in pixels.
    sensor : str
        Name of the sensor plugin that `model` comes from, by which its state finds back.
    """

    model: SensorModel
    grid: CorrectionGrid
    sensor: str

    @staticmethod
    def of(model: SensorModel, grid: CorrectionGrid, sensor: str) -> Corrected:
        """Corrected model; it has rays where the wrapped model has them."""
        return (CorrectedWithRays if isinstance(model, HasRays) else Corrected)(model, grid, sensor)

    @property
    def crs(self) -> CRS:
        """That of the wrapped model."""
        return self.model.crs

    @property
    def size(self) -> tuple[int, int]:
        """That of the wrapped model."""
        return self.model.size

    @property
    def parameters(self) -> Parameters:
        """Those of the wrapped model."""
        return self.model.parameters

    @property
    def seed(self) -> tuple[float, float, float]:
        """That of the wrapped model."""
        return self.model.seed

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        """Ground (N, 3) in `crs` to corrected (col, row) (N, 2)."""
        ideal = self.model.ground_to_image(xyz)
        return ideal + self.grid.at(ideal)

    def jacobian(self, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives by the parameters (N, 2, P) and by ground coordinates (N, 2, 3), by the chain rule."""
        by_parameters, by_ground = jacobian(self.model, xyz)
        turn = np.eye(2) + self.grid.slopes(self.model.ground_to_image(xyz))
        return turn @ by_parameters, turn @ by_ground

    def with_values(self, values: FloatArray) -> Self:
        """Model with other parameter values (P,) behind the same grid."""
        return replace(self, model=self.model.with_values(values))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values, with the sensor's name."""
        kind = "corrected" if isinstance(self.model, Corrected) else "state"
        return {"sensor": self.sensor, kind: self.model.to_dict(), "grid": self.grid.to_dict()}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Model of a state, as `to_dict` gives it; the sensor's plugin must be installed."""
        inner = (
            Corrected.from_dict(state["corrected"])
            if "corrected" in state
            else plugin(state["sensor"]).model.from_dict(state["state"])
        )
        return cast(Self, Corrected.of(inner, CorrectionGrid.from_dict(state["grid"]), state["sensor"]))


@dataclass(frozen=True, eq=False)
class CorrectedWithRays(Corrected):
    """A corrected model whose wrapped model has lines of sight in closed form."""

    def rays(self, colrow: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Image (N, 2) to origins and unit directions (N, 3): those of the ideal positions."""
        return cast(HasRays, self.model).rays(self.grid.ideal(colrow))


def model_to_dict(name: str, model: SensorModel) -> dict[str, Any]:
    """State of a model with the sensor's name, as JSON values; corrections around the model are kept.

    Parameters
    ----------
    name : str
        Sensor.
    model : SensorModel

    Returns
    -------
    dict
        Keys `sensor`, and `corrected` or `state`.
    """
    return {"sensor": name, "corrected" if isinstance(model, Corrected) else "state": model.to_dict()}


def model_from_dict(state: dict[str, Any]) -> SensorModel:
    """Model of a state that `model_to_dict` made.

    Parameters
    ----------
    state : dict

    Returns
    -------
    SensorModel

    Raises
    ------
    SensorError
        The sensor is not installed here.
    """
    if "corrected" in state:
        return Corrected.from_dict(state["corrected"])
    return plugin(state["sensor"]).model.from_dict(state["state"])
