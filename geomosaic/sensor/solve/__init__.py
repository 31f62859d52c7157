"""What follows from a sensor model's one map: its inverse, its derivatives, and its parameters from control points.

All of it works for every `SensorModel`, from `ground_to_image` alone; closed forms are used where a model has them.
"""

from __future__ import annotations

from geomosaic.sensor.solve.adjust import Resection, fit, resect
from geomosaic.sensor.solve.inverse import image_to_ground, image_to_height
from geomosaic.sensor.solve.jacobian import jacobian
from geomosaic.sensor.solve.pose import poses
from geomosaic.sensor.solve.quality import correlations, dangerous_cylinder
from geomosaic.sensor.solve.three_points import Pose, three_point_poses

__all__ = [
    "Pose",
    "Resection",
    "correlations",
    "dangerous_cylinder",
    "fit",
    "image_to_ground",
    "image_to_height",
    "jacobian",
    "poses",
    "resect",
    "three_point_poses",
]
