"""How good a resection is: correlations, and the cylinder on which it fails."""

from __future__ import annotations

import numpy as np

from geomosaic.types import FloatArray


def correlations(covariance: FloatArray) -> FloatArray:
    """Correlation matrix of a covariance matrix (P, P); 0 for parameters that were held fixed."""
    sigma = np.sqrt(np.diag(covariance))
    products = np.outer(sigma, sigma)
    out: FloatArray = np.divide(covariance, products, out=np.zeros_like(covariance), where=products > 0.0)
    return out


def dangerous_cylinder(centre: FloatArray, points: FloatArray) -> float:
    """Distance of a projection centre from the dangerous cylinder of three points, as a share of its radius.

    The cylinder stands on the circle through the points, across their plane. From a centre on it three points do not
    determine a pose: two of Grunert's solutions are one there, and sigmas are infinite (Finsterwalder 1903). Four
    points in one plane, no three of them in line, have no such place, on one circle or not: they determine the
    projective map between plane and image, and with it the pose.

    Parameters
    ----------
    centre : array (3,)
    points : array (3, 3)
        Three points, one per row.

    Returns
    -------
    float
        0 on the cylinder, 1 on its axis; infinite for points in line.
    """
    known = np.asarray(points, dtype=np.float64)
    first, second = known[1] - known[0], known[2] - known[0]
    normal = np.cross(first, second)
    twice = float(normal @ normal)
    if not twice > 1e-24 * float(first @ first) * float(second @ second):
        return float("inf")
    # Middle of the circle from the corner (first, second): the classical formula of the circumcentre.
    middle = np.cross((first @ first) * second - (second @ second) * first, normal) / (2.0 * twice)
    axis = normal / np.sqrt(twice)
    here = np.asarray(centre, dtype=np.float64) - known[0] - middle
    radius = float(np.linalg.norm(middle))
    return abs(float(np.linalg.norm(here - (here @ axis) * axis)) - radius) / radius
