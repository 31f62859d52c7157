"""Rotation matrices, in the notation of photogrammetry textbooks.

`r1`, `r2`, `r3` turn the *axes* (ground to image) right-handed about x, y, z, as in R = R3(κ)·R2(φ)·R1(ω).
"""

from __future__ import annotations

import numpy as np

from geomosaic.types import FloatArray


def r1(angle: float) -> FloatArray:
    """Rotation of the axes about x.

    Parameters
    ----------
    angle : float
        Radians, right-handed.

    Returns
    -------
    array (3, 3)
    """
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])


def r2(angle: float) -> FloatArray:
    """Rotation of the axes about y.

    Parameters
    ----------
    angle : float
        Radians, right-handed.

    Returns
    -------
    array (3, 3)
    """
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, 0.0, -s], [0.0, 1.0, 0.0], [s, 0.0, c]])


def r3(angle: float) -> FloatArray:
    """Rotation of the axes about z.

    Parameters
    ----------
    angle : float
        Radians, right-handed.

    Returns
    -------
    array (3, 3)
    """
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def omega_phi_kappa(omega: float, phi: float, kappa: float) -> FloatArray:
    """Ground→image rotation R3(κ)·R2(φ)·R1(ω).

    Parameters
    ----------
    omega, phi, kappa : float
        Radians.

    Returns
    -------
    array (3, 3)
        Its rows are the image axes in the ground frame.
    """
    rotation: FloatArray = r3(kappa) @ r2(phi) @ r1(omega)
    return rotation


def angles_of(rotation: FloatArray) -> tuple[float, float, float]:
    """Omega, phi, kappa of a ground→image rotation, the inverse of `omega_phi_kappa`.

    Parameters
    ----------
    rotation : array (3, 3)

    Returns
    -------
    omega, phi, kappa : float
        Radians; kappa is 0 where phi is ±90°.
    """
    m = np.asarray(rotation, dtype=np.float64)
    phi = float(np.arctan2(m[2, 0], np.hypot(m[2, 1], m[2, 2])))
    # Gimbal lock: omega and kappa turn about the same axis, so that only their sum or difference is known.
    if np.hypot(m[2, 1], m[2, 2]) < 1e-14:
        return float(np.arctan2(m[0, 1], m[1, 1]) * (1.0 if m[2, 0] > 0 else -1.0)), phi, 0.0
    return float(np.arctan2(-m[2, 1], m[2, 2])), phi, float(np.arctan2(-m[1, 0], m[0, 0]))


def angle_axis(vector: FloatArray) -> FloatArray:
    """Rotation matrix of a rotation vector, by the formula of Rodrigues.

    Parameters
    ----------
    vector : array (3,)
        Along the axis, its length the angle in radians.

    Returns
    -------
    array (3, 3)
    """
    v = np.asarray(vector, dtype=np.float64)
    angle = float(np.linalg.norm(v))
    if angle < 1e-300:
        return np.eye(3)
    x, y, z = v / angle
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    rotation: FloatArray = np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * (k @ k)
    return rotation
