"""State of any model as JSON values, with the name of its sensor, and back."""

from __future__ import annotations

from typing import Any

from geomosaic.sensor.corrected import Corrected
from geomosaic.sensor.model import SensorModel
from geomosaic.sensor.registry import plugin


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
