"""Conformance tests of a sensor plugin: its members, its capabilities, and its errors about inputs."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from geomosaic.errors import GeomosaicError, SensorInputError
from geomosaic.geo.crs import geographic, has_heights
from geomosaic.geo.transform import Transform
from geomosaic.sensor.plugin import Capabilities, SensorInput, SensorModel, SensorPlugin, SensorRequest
from geomosaic.sensor.registry import MEMBERS
from geomosaic.surface.model import Plane
from geomosaic.types import BoolArray, FloatArray


def require(condition: bool | np.bool, broken: str) -> None:
    """Assertion with the broken part of the contract in words.

    Parameters
    ----------
    condition : bool
    broken : str
        Message.

    Raises
    ------
    AssertionError
        The condition is false; raised under `python -O` too, as the kit also runs outside pytest.
    """
    if not condition:
        raise AssertionError(broken)


def level(model: SensorModel, ground: FloatArray) -> Plane | None:
    """Level plane at the mean height of ground points.

    Parameters
    ----------
    model : SensorModel
    ground : array (N, 3)
        Points in `model.crs`.

    Returns
    -------
    Plane or None
        In `model.crs`, or in its geographic CRS where that is geocentric; None for models without heights.
    """
    if not has_heights(model.crs):
        return None
    crs = geographic(model.crs) if model.crs.is_geocentric else model.crs
    return Plane(crs, float(Transform(model.crs, crs)(ground)[:, 2].mean()))


def near(a: FloatArray, b: FloatArray | float, tolerance: float) -> bool:
    """Whether arrays agree within an absolute tolerance, NaN with NaN.

    Parameters
    ----------
    a : array (...)
    b : array (...) or float
        Of a shape that broadcasts with `a`.
    tolerance : float
        In the unit of the arrays.
    """
    return bool(np.allclose(a, b, rtol=0.0, atol=tolerance, equal_nan=True))


def adjustable(sigmas: FloatArray) -> BoolArray:
    """Parameters for the resection test: the free ones, or else those not fixed, or else all.

    Parameters
    ----------
    sigmas : array (P,)
        Standard deviations: infinite where free, 0 where fixed.
    """
    for chosen in (np.isinf(sigmas), sigmas > 0.0):
        if chosen.any():
            return chosen
    return np.ones(len(sigmas), dtype=np.bool_)


UNKNOWN = "no_such_input"
# Inputs that the program fills in by a capability: under another meaning these names would mislead it.
STANDARD_INPUTS = {"ground_height", "points", "position", "refine", "relative", "transform", "unoriented", "upwards"}
EXTERIOR = ("position", "orientation", "angle_unit", "velocity")


def check_plugin(plugin: SensorPlugin | Any, request: SensorRequest) -> None:
    """Conformance check of a plugin: members, inputs, capabilities, model, and errors about inputs.

    Parameters
    ----------
    plugin : SensorPlugin
    request : SensorRequest
        An example that the plugin can build a model of; without one, what it refuses cannot be tested.

    Raises
    ------
    AssertionError
        In words, what is broken.
    """
    for part in MEMBERS:
        require(hasattr(plugin, part), f"the plugin has no '{part}'")
    require(
        isinstance(plugin.name, str) and plugin.name.replace("_", "").replace("-", "").isalnum(),
        f"the name {plugin.name!r} is not one word",
    )
    require(
        isinstance(plugin.summary, str) and bool(plugin.summary.strip()) and "\n" not in plugin.summary,
        "the summary is not one line of text",
    )
    require(
        isinstance(plugin.inputs, tuple) and all(isinstance(entry, SensorInput) for entry in plugin.inputs),
        "inputs is not a tuple of SensorInput",
    )
    names = [entry.name for entry in plugin.inputs]
    require(len(set(names)) == len(names), "two inputs have the same name")
    require(all(entry.text.strip() for entry in plugin.inputs), "an input has no text that says what it is")
    _check_capabilities(plugin.capabilities, set(names))
    for member in ("ground_to_image", "with_values", "to_dict", "from_dict", "crs", "size", "parameters", "seed"):
        fields = getattr(plugin.model, "__dataclass_fields__", {})
        require(hasattr(plugin.model, member) or member in fields, f"the class `model` has no '{member}'")
    _check_build(plugin, request, names)


def _check_capabilities(power: Capabilities, names: set[str]) -> None:
    """Capabilities and inputs agree: what is declared is listed, and what the program would fill in is declared."""
    require(isinstance(power, Capabilities), "capabilities is not a geomosaic.sensor.plugin.Capabilities")
    odd = sorted(set(power.exterior) - set(EXTERIOR))
    require(not odd, f"capabilities.exterior has {', '.join(odd)}; it may have {', '.join(EXTERIOR)}")
    missing = sorted(power.standard_inputs - names)
    require(not missing, f"capabilities need the inputs {', '.join(missing)}, which the plugin does not list")
    undeclared = sorted((STANDARD_INPUTS & names) - power.standard_inputs)
    require(not undeclared, f"no capability tells the program that there is an input {', '.join(undeclared)}")


def _check_build(plugin: SensorPlugin, request: SensorRequest, names: list[str]) -> None:
    """The example is built; each input it lacks and one it should not have are refused as the contract says."""
    unlisted = sorted(set(request.options) - set(names))
    require(not unlisted, f"the example has {', '.join(unlisted)}, which the plugin does not list among its inputs")
    try:
        model = plugin.build(request)
    except Exception as error:
        raise AssertionError(f"build refuses the example: {error!r}") from error
    require(isinstance(model, plugin.model), f"build gives a {type(model).__name__}, not a {plugin.model.__name__}")
    require(tuple(model.size) == tuple(request.size), f"the model has the size {model.size}, not {request.size}")
    flat = len(model.crs.axis_info) == 2
    require(flat == plugin.capabilities.planar, "capabilities.planar does not say whether models are in a 2-D CRS")
    for name in request.options:
        rest = {key: value for key, value in request.options.items() if key != name}
        _refusal(plugin, replace(request, options=rest), f"a missing '{name}'")
    refused = _refusal(plugin, replace(request, options={**request.options, UNKNOWN: 1}), "an unknown input")
    if refused is None:
        raise AssertionError("build accepts an unknown input without a word")
    require(UNKNOWN in str(refused), "the error about an unknown input does not name the input")
    require(
        isinstance(refused, SensorInputError) and refused.name == UNKNOWN,
        f"the error about an unknown input is no SensorInputError with the name '{UNKNOWN}'",
    )


def _refusal(plugin: SensorPlugin, request: SensorRequest, what: str) -> GeomosaicError | None:
    """Error with which `build` refuses a request; None where it does not."""
    try:
        plugin.build(request)
    except GeomosaicError as error:
        require(request.image in str(error), f"the error about {what} does not name the image")
        return error
    except Exception as error:
        raise AssertionError(f"{what} makes build raise {error!r}, not an InputError") from error
    return None
