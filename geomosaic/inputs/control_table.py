"""Tables of control points with their accuracies, as the `control` of a block reads them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from pyproj import CRS

from geomosaic.control.points import ControlPoints
from geomosaic.geo.crs import in_degrees
from geomosaic.inputs.tie_points import ACCURACY, accuracy_columns, quoted
from geomosaic.stores.path import given_path
from geomosaic.types import PathLike
from geomosaic.whole_files import write_atomic

COLUMNS = ("id", "x", "y", "z", "image", "col", "row", "sigma_xy", "sigma_z")


def write_control(path: PathLike, control: Mapping[str, ControlPoints], crs: CRS | None = None) -> Path:
    """Table of the control points of images, as the `control` of a block takes it.

    Parameters
    ----------
    path : path-like
    control : mapping of str to ControlPoints
        By name of the image.
    crs : CRS, optional
        3-D, of the coordinates; their own unless given.
    """
    lines = [",".join((*COLUMNS, *ACCURACY))]
    for image, found in control.items():
        points = found if crs is None else found.to_crs(crs)
        digits = 10 if in_degrees(points.crs) else 4
        sigmas = np.zeros((len(points), 3)) if points.sigma_ground is None else points.sigma_ground
        accuracy = np.column_stack([*accuracy_columns(points.sigma, points.covariance).values()]).tolist()
        rows = np.column_stack([points.ground, points.colrow, sigmas[:, [0, 2]]]).tolist()
        for name, (x, y, z, *rest), accuracies in zip(points.names, rows, accuracy, strict=True):
            values = ",".join(f"{value:.4f}" for value in (*rest, *accuracies))
            lines.append(f"{name},{x:.{digits}f},{y:.{digits}f},{z:.4f},{quoted(image)},{values}")
    write_atomic(given_path(path), "\n".join(lines) + "\n")
    return given_path(path)
