"""Hillshade, and its blend with a picture."""

from __future__ import annotations

import numpy as np

from geomosaic.types import AnyArray, ByteArray, FloatArray


def hillshade(
    heights: AnyArray, step: tuple[float, float], azimuth: float = 315.0, altitude: float = 45.0
) -> FloatArray:
    """Cosine of the angle between the sun and the normal of the ground, not below 0: level ground has sin(altitude).

    Slopes after Horn (Proc. IEEE 69(1), 1981): central differences over 3 x 3 nodes, weighted 1, 2, 1.

    Parameters
    ----------
    heights : array (rows, cols)
        Rows southwards; NaN where unknown, which makes NaN around it too.
    step : tuple of float
        Distance of columns and rows in the unit of the heights.
    azimuth, altitude : float
        Of the sun, degrees: clockwise from north, and above the horizon.

    Returns
    -------
    array (rows, cols)
        0 to 1.
    """
    z = np.pad(np.asarray(heights, dtype=np.float64), 1, mode="edge")
    # At the edge the slope goes on: the node beyond mirrors through the last one.
    z[0], z[-1] = 2 * z[1] - z[2], 2 * z[-2] - z[-3]
    z[:, 0], z[:, -1] = 2 * z[:, 1] - z[:, 2], 2 * z[:, -2] - z[:, -3]
    east = (
        (z[:-2, 2:] + 2 * z[1:-1, 2:] + z[2:, 2:]) - (z[:-2, :-2] + 2 * z[1:-1, :-2] + z[2:, :-2])
    ) / (8 * step[0])  # fmt: skip
    north = (
        (z[:-2, :-2] + 2 * z[:-2, 1:-1] + z[:-2, 2:]) - (z[2:, :-2] + 2 * z[2:, 1:-1] + z[2:, 2:])
    ) / (8 * step[1])  # fmt: skip
    a, h = np.radians(azimuth), np.radians(altitude)
    sun = np.sin(a) * np.cos(h), np.cos(a) * np.cos(h), np.sin(h)
    light = (sun[2] - east * sun[0] - north * sun[1]) / np.sqrt(1 + east**2 + north**2)
    found: FloatArray = np.maximum(light, 0.0) + 0.0 * z[1:-1, 1:-1]
    return found


def shaded(rgb: ByteArray, shade: FloatArray, level: float, strength: float) -> ByteArray:
    """Multiply a picture by the shade, level ground unchanged.

    Parameters
    ----------
    rgb : uint8 array (rows, cols, 3)
    shade : array (rows, cols)
        NaN leaves the picture as it is.
    level : float
        Shade of level ground.
    strength : float
        0 for nothing, 1 for all of it.
    """
    factor = np.where(np.isnan(shade), 1.0, 1.0 + strength * (shade / level - 1.0))
    made: ByteArray = np.clip(np.floor(rgb[..., :3] * factor[..., None] + 0.5), 0, 255).astype(np.uint8)
    return made
