"""Hillshade of a height grid, and its multiplication with an image."""

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
        Direction of the sun, degrees: clockwise from north, and above the horizon.

    Returns
    -------
    array (rows, cols)
        0 to 1.
    """
    z = np.pad(np.asarray(heights, dtype=np.float64), 1, mode="edge")
    # Linear extrapolation by one node: with repeated edge nodes slopes would halve along the border.
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
    """Image multiplied by the hillshade, with level ground unchanged.

    Parameters
    ----------
    rgb : uint8 array (rows, cols, 3)
    shade : array (rows, cols)
        Hillshade 0 to 1; NaN leaves the image as it is.
    level : float
        Hillshade of level ground, sin(altitude).
    strength : float
        0 (no effect) to 1 (full).
    """
    factor = np.where(np.isnan(shade), 1.0, 1.0 + strength * (shade / level - 1.0))
    made: ByteArray = np.clip(np.floor(rgb[..., :3] * factor[..., None] + 0.5), 0, 255).astype(np.uint8)
    return made
