"""Frame of a block that nothing ties to the Earth: level by its own form, and of a size that can be read."""

from __future__ import annotations

import numpy as np

from geomosaic.estimation.statistics import MAD_TO_SIGMA
from geomosaic.orientation.block.absolute_orientation import Similarity
from geomosaic.types import FloatArray

# Height of the cameras above the points in a frame without a unit: numbers and pixel sizes read like those of a drone.
UNITS = 100.0
# Spread of camera positions across their longest direction, as a share of that along it, from which on their plane is
# determined: a single strip has none.
SPREAD = 0.2


def level_frame(points: FloatArray, centres: FloatArray, scale: float | None = None) -> tuple[Similarity, bool]:
    """Similarity to a frame with the cameras above level ground, and whether the plane of the cameras is level.

    Aircraft keep their height better than the ground does, so their plane comes first; that of the points takes its
    place where the cameras lie along a line.

    Parameters
    ----------
    points : array (S, 3)
        NaN where unknown.
    centres : array (M, 3)
        Projection centres.
    scale : float, optional
        Where the size is known; else the cameras are `UNITS` above the points.

    Returns
    -------
    frame : Similarity
        To the median point as origin, x along the longest direction of the flight, z up.
    of_cameras : bool
    """
    ground = points[np.isfinite(points).all(axis=1)]
    origin = np.median(ground, axis=0)
    along, spread, up = _axes(centres)
    of_cameras = len(centres) > 2 and spread > SPREAD
    if not of_cameras:
        up = _axes(ground)[2]
    above = np.median((centres - origin) @ up)
    up = up if above >= 0.0 else -up
    # The last image lies to the east of the first.
    along = along if (centres[-1] - centres[0]) @ along >= 0.0 else -along
    east = along - (along @ up) * up
    if np.linalg.norm(east) < 1e-6:
        east = np.eye(3)[np.argmin(np.abs(up))]
        east = east - (east @ up) * up
    east = east / np.linalg.norm(east)
    rotation = np.stack([east, np.cross(up, east), up])
    if scale is None:
        # Photos of a wall have no height above it, but a distance.
        away = float(np.median(np.linalg.norm(centres - origin, axis=1)))
        scale = UNITS / max(abs(float(above)), 0.1 * away, 1e-12)
    return Similarity(scale, rotation, -scale * rotation @ origin), of_cameras


def _axes(places: FloatArray) -> tuple[FloatArray, float, FloatArray]:
    """Longest direction (3,) of places (N, 3), their spread across it as a share of that along it, and their normal."""
    weight = np.ones(len(places))
    # Places of false matches lie far off, and would tilt the plane.
    for _ in range(10):
        middle = weight @ places / weight.sum()
        away = places - middle
        # Of all places a singular value decomposition would hold a square of their number.
        square, axes = np.linalg.eigh((away * weight[:, None]).T @ away)
        size, axes = np.sqrt(np.maximum(square[::-1], 0.0)), axes.T[::-1]
        off = np.abs(away @ axes[2]) / max(MAD_TO_SIGMA * float(np.median(np.abs(away @ axes[2]))), 1e-300)
        far = np.linalg.norm(away, axis=1)
        far = far / max(float(np.median(far)), 1e-300)
        weight = 1.0 / (1.0 + (off / 3.0) ** 2 + (far / 4.0) ** 4)
    return axes[0], float(size[1] / size[0]) if size[0] > 0.0 else 0.0, axes[2]
