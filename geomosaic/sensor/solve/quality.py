"""How good a resection is: correlations, and the cylinder on which it fails."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.types import FloatArray


def correlations(covariance: FloatArray) -> FloatArray:
    """Correlation matrix of a covariance matrix (P, P); 0 for parameters that were held fixed."""
    sigma = np.sqrt(np.diag(covariance))
    products = np.outer(sigma, sigma)
    out: FloatArray = np.divide(covariance, products, out=np.zeros_like(covariance), where=products > 0.0)
    return out


@dataclass(frozen=True)
class Cylinder:
    """How near a projection centre is to the dangerous cylinder of its control points.

    From a centre on the right circular cylinder through three points the pose is not determined: the solution is
    double there (Finsterwalder 1903). The same holds for more points where they lie on one circle.

    Attributes
    ----------
    gap : float
        Distance of the centre from the cylinder over its radius.
    off_circle : float
        Largest distance of the points from that circle over its radius; 0 with three points.
    """

    gap: float
    off_circle: float

    @property
    def near(self) -> bool:
        """Whether the cylinder spoils the resection: the points are on it, and the centre almost."""
        return self.off_circle < 0.1 and self.gap < 0.1


def dangerous_cylinder(centre: FloatArray, points: FloatArray) -> Cylinder:
    """Compare a projection centre (3,) with the circle through points (N, 3) in their plane; N is three at least."""
    known = np.asarray(points, dtype=np.float64)
    middle = known.mean(axis=0)
    axes = np.linalg.svd(known - middle, full_matrices=True)[2]
    local = (known - middle) @ axes.T
    # Circle x² + y² = 2·p·x + 2·q·y + s of the points in their plane.
    design = np.column_stack([2.0 * local[:, :2], np.ones(len(local))])
    p, q, s = np.linalg.lstsq(design, (local[:, :2] ** 2).sum(axis=1), rcond=None)[0]
    radius = float(np.sqrt(max(s + p * p + q * q, 0.0)))
    if not radius > 0.0:
        return Cylinder(np.inf, np.inf)
    away = np.hypot(local[:, 0] - p, local[:, 1] - q) - radius
    off = float(np.max(np.hypot(away, local[:, 2])))
    here = (np.asarray(centre, dtype=np.float64) - middle) @ axes.T
    return Cylinder(abs(float(np.hypot(here[0] - p, here[1] - q)) - radius) / radius, off / radius)
