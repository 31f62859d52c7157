"""What follows from a sensor model's one map: its inverse, its derivatives, and its parameters from control points.

All of it works for every `SensorModel`, from `ground_to_image` alone; closed forms are used where a model has them.
Names load their modules on first use: an ortho needs the inverse and nothing else.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from geomosaic.sensor.solve.adjust import Resection, expected_errors, fit, precision, resect
    from geomosaic.sensor.solve.control_resection import ControlResection, resect_control
    from geomosaic.sensor.solve.inverse import image_to_ground, image_to_height
    from geomosaic.sensor.solve.newton import jacobian
    from geomosaic.sensor.solve.three_point_resection import Pose, dangerous_cylinder, poses, three_point_poses

_MODULES = {
    "adjust": ("Resection", "expected_errors", "fit", "precision", "resect"),
    "control_resection": ("ControlResection", "resect_control"),
    "inverse": ("image_to_ground", "image_to_height"),
    "newton": ("jacobian",),
    "three_point_resection": ("Pose", "dangerous_cylinder", "poses", "three_point_poses"),
}
_HOMES = {name: module for module, names in _MODULES.items() for name in names}

__all__ = [
    "ControlResection",
    "Pose",
    "Resection",
    "dangerous_cylinder",
    "expected_errors",
    "fit",
    "image_to_ground",
    "image_to_height",
    "jacobian",
    "poses",
    "precision",
    "resect",
    "resect_control",
    "three_point_poses",
]


def __getattr__(name: str) -> Any:
    if name in _HOMES:
        return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")
