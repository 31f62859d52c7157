"""Pose of a scanner: position and axes at many times, and small rotations of its axes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from geomosaic.types import FloatArray


class Pose(NamedTuple):
    """Position and axes of a scanner at N times.

    Attributes
    ----------
    position : array (N, 3)
        Geocentric metres.
    axes : array (N, 3, 3)
        Rows are the scanner's own axes x, y, z in geocentric components. z points away from the ground.
    """

    position: FloatArray
    axes: FloatArray


def components(axes: FloatArray, vectors: FloatArray) -> FloatArray:
    """Components of vectors along axes.

    Parameters
    ----------
    axes : array (N, 3, 3)
        Rows are unit vectors, geocentric.
    vectors : array (N, 3)
        Geocentric.

    Returns
    -------
    array (N, 3)
    """
    # Written out instead of a matrix product: BLAS may round a point differently from one array length to the next.
    return np.stack([_dot(axes[:, i], vectors) for i in range(3)], axis=1)


def combined(axes: FloatArray, parts: FloatArray) -> FloatArray:
    """Vectors of given components along axes, the inverse of `components`.

    Parameters
    ----------
    axes : array (N, 3, 3)
        Rows are unit vectors, geocentric.
    parts : array (N, 3)
        Components.

    Returns
    -------
    array (N, 3)
        Geocentric.
    """
    vectors: FloatArray = parts[:, :1] * axes[:, 0] + parts[:, 1:2] * axes[:, 1] + parts[:, 2:] * axes[:, 2]
    return vectors


def _dot(a: FloatArray, b: FloatArray) -> FloatArray:
    product: FloatArray = a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1] + a[:, 2] * b[:, 2]
    return product


def turned(axes: FloatArray, pitch: FloatArray, roll: FloatArray, yaw: FloatArray) -> FloatArray:
    """Axes turned by the SPOT attitude angles.

    A look direction u in the turned axes is Mp·Mr·My·u in the axes given, with (SPOT Geometry Handbook, CNES, 2002)

             1    0     0            cr   0  −sr            cy −sy   0
        Mp = 0   cp    sp       Mr =  0   1    0       My = sy  cy   0
             0  −sp    cp            sr   0   cr             0   0   1

    so the rows of the turned axes are those of (Mp·Mr·My)ᵀ times the axes.

    Parameters
    ----------
    axes : array (N, 3, 3)
        Rows are the axes x, y, z.
    pitch, roll, yaw : array (N,)
        Radians.

    Returns
    -------
    array (N, 3, 3)
    """
    x, y, z = axes[:, 0], axes[:, 1], axes[:, 2]
    c, s = np.cos(pitch)[:, None], np.sin(pitch)[:, None]
    y, z = c * y - s * z, s * y + c * z
    c, s = np.cos(roll)[:, None], np.sin(roll)[:, None]
    x, z = c * x + s * z, c * z - s * x
    c, s = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    x, y = c * x + s * y, c * y - s * x
    return np.stack([x, y, z], axis=1)


def unit(vectors: FloatArray) -> FloatArray:
    """Unit vectors.

    Parameters
    ----------
    vectors : array (N, 3)

    Returns
    -------
    array (N, 3)
    """
    scaled: FloatArray = vectors / np.sqrt(_dot(vectors, vectors))[:, None]
    return scaled


def cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross products a × b, by components.

    Parameters
    ----------
    a, b : array (N, 3)

    Returns
    -------
    array (N, 3)
    """
    return np.stack(
        [
            a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1],
            a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2],
            a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0],
        ],
        axis=1,
    )


def matrices_of_quaternions(q: FloatArray) -> FloatArray:
    """Rotation matrices of quaternions.

    Parameters
    ----------
    q : array (N, 4)
        Scalar first, of any length but 0.

    Returns
    -------
    array (N, 3, 3)
    """
    w, x, y, z = (q / np.sqrt((q * q).sum(axis=1))[:, None]).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.stack([np.stack(row, axis=1) for row in rows], axis=1)


def quaternions_of(matrices: FloatArray) -> FloatArray:
    """Quaternions of rotation matrices; neighbours have the same sign.

    Parameters
    ----------
    matrices : array (N, 3, 3)

    Returns
    -------
    array (N, 4)
        Scalar first, of length one.
    """
    # Of the four forms the one with the largest divisor is taken (Shepperd, 1978).
    m = np.asarray(matrices, dtype=np.float64)
    trace = np.trace(m, axis1=1, axis2=2)
    squares = 0.25 * np.column_stack([1 + trace, *(1 + 2 * m[:, i, i] - trace for i in range(3))])
    w2, x2, y2, z2 = squares.T
    wx, wy, wz = (0.25 * v for v in (m[:, 2, 1] - m[:, 1, 2], m[:, 0, 2] - m[:, 2, 0], m[:, 1, 0] - m[:, 0, 1]))
    xy, xz, yz = (0.25 * v for v in (m[:, 0, 1] + m[:, 1, 0], m[:, 0, 2] + m[:, 2, 0], m[:, 1, 2] + m[:, 2, 1]))
    forms = np.stack(
        [np.stack(row, axis=1) for row in ((w2, wx, wy, wz), (wx, x2, xy, xz), (wy, xy, y2, yz), (wz, xz, yz, z2))],
        axis=1,
    )
    best = np.argmax(squares, axis=1)
    q: FloatArray = forms[np.arange(len(m)), best]
    q = q / np.linalg.norm(q, axis=1)[:, None]
    return same_side(q)


def satellite_pose(position: FloatArray, quaternions: FloatArray) -> Pose:
    """Pose of a satellite whose axes point forward, right and to the ground.

    Parameters
    ----------
    position : array (N, 3)
        Geocentric metres.
    quaternions : array (N, 4)
        From the satellite's to geocentric axes, scalar first, of any length.

    Returns
    -------
    Pose
        Axes right, forward, up.
    """
    turns = matrices_of_quaternions(quaternions)
    return Pose(position, np.stack([turns[:, :, 1], turns[:, :, 0], -turns[:, :, 2]], axis=1))


def same_side(quaternions: FloatArray) -> FloatArray:
    """Quaternions with signs such that no neighbours are opposite: q and −q are the same rotation.

    Parameters
    ----------
    quaternions : array (K, 4)

    Returns
    -------
    array (K, 4)
    """
    # Interpolated between opposite signs, components would pass through zero, where there is no rotation.
    away = (quaternions[1:] * quaternions[:-1]).sum(axis=1) < 0.0
    signs = np.concatenate([[1.0], np.cumprod(np.where(away, -1.0, 1.0))])
    turned: FloatArray = quaternions * signs[:, None]
    return turned
