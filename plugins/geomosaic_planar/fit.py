"""Plane transformations from control points, by least squares on normalised coordinates."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.types import FloatArray
from geomosaic_planar import spline
from geomosaic_planar.projective import projective
from geomosaic_planar.solve import conformal, linear
from geomosaic_planar.terms import article, evaluate, least_points

NO_NODES = np.empty((0, 2))
NO_NODES.setflags(write=False)


@dataclass(frozen=True)
class PlanarFit:
    """A plane transformation and how well it fits.

    Attributes
    ----------
    kind, order : str, int
    centre : array (2,)
        Mean of the points on the map.
    scale : float
        Map units; the points reach |u|, |v| ≤ 1.
    values : array (P,)
        Coefficients for normalised ground coordinates; of a spline the image coordinates of its nodes.
    residuals : array (N, 2)
        Measured minus computed (col, row) in pixels.
    covariance : array (P, P)
        Of the coefficients, scaled by sigma0²; NaN without redundancy.
    sigma0 : float
        Standard deviation of an observation of weight 1, in pixels; NaN without redundancy.
    condition : float
        Of the design matrix with columns of length one; of a spline, of its matrix.
    axes : str
        'left' or 'right': handedness of the image's axes as a conformal fit found it; 'left' for other kinds, whose
        coefficients carry it.
    nodes : array (N, 2)
        Normalised places of a spline's nodes; (0, 2) for other kinds.
    """

    kind: str
    order: int
    centre: FloatArray
    scale: float
    values: FloatArray
    residuals: FloatArray
    covariance: FloatArray
    sigma0: float
    condition: float
    axes: str = "left"
    nodes: FloatArray = field(default_factory=lambda: NO_NODES)


def fit_planar(
    kind: str,
    xy: FloatArray,
    colrow: FloatArray,
    weights: FloatArray | None = None,
    *,
    order: int = 1,
    axes: str | None = None,
    where: str | None = None,
) -> PlanarFit:
    """Fit a plane transformation ground → image.

    Parameters
    ----------
    kind : str
        'conformal', 'affine', 'projective', 'polynomial' or 'tps'.
    xy : array (N, 2)
        Map positions.
    colrow : array (N, 2)
        Measured image positions in pixels.
    weights : array (N,), optional
        1 / σ² of the measurements; all 1 when left out. A spline passes through all points whatever their weights.
    order : int
        Degree of a polynomial, 1 to 5.
    axes : str, optional
        Handedness of the image's axes for a conformal fit: 'left' (rows downwards), 'right' (rows upwards, or a
        mirrored image); recognised when left out.
    where : str, optional
        Named in errors.

    Raises
    ------
    SolveError
        Too few points, or points that do not determine the transformation: on a line, on one place, ...
    """
    ground, image = np.asarray(xy, dtype=np.float64), np.asarray(colrow, dtype=np.float64)
    if ground.shape != image.shape or ground.ndim != 2 or ground.shape[1] != 2:
        raise ValueError(f"shapes {ground.shape} and {image.shape} are not both (N, 2)")
    if not (np.isfinite(ground).all() and np.isfinite(image).all()):
        raise SolveError("a control point has a coordinate that is not a number", where=where)
    count, needed = len(ground), least_points(kind, order)
    label = f"{kind} of order {order}" if kind == "polynomial" else kind
    if count < needed:
        raise SolveError(
            f"{count} control points do not determine {article(label)} {label} transformation, which needs {needed}",
            where=where,
            mend="add points or choose a simpler kind: conformal needs 2, affine and tps 3, projective 4",
        )
    root = np.ones(count) if weights is None else np.sqrt(np.asarray(weights, dtype=np.float64))
    if not (np.isfinite(root) & (root > 0.0)).all():
        raise SolveError("weights of control points must be positive numbers", where=where)
    # The mean lies inside the points, so a projective denominator that is positive at all of them is so there.
    centre = ground.mean(axis=0)
    scale = float(np.abs(ground - centre).max())
    if scale == 0.0:
        raise SolveError("all control points lie on one place", where=where, mend="spread them over the image")
    uv = (ground - centre) / scale
    if kind == "tps":
        return _spline(uv, image, centre, scale, where)
    handed = "left"
    if kind == "conformal":
        solved, handed = conformal(uv, image, root, axes, where)
    elif kind == "projective":
        solved = projective(uv, image, root, where)
    else:
        solved = linear(order, uv, image, root, label, where)
    values, condition, cofactors = solved
    residuals = image - evaluate(kind, order, values, uv, handed)
    redundancy = 2 * count - len(values)
    weighted = residuals * root[:, None]
    sigma0 = float(np.sqrt((weighted**2).sum() / redundancy)) if redundancy > 0 else float("nan")
    covariance = cofactors * sigma0**2
    return PlanarFit(kind, order, centre, scale, values, residuals, covariance, sigma0, condition, handed)


def _spline(uv: FloatArray, image: FloatArray, centre: FloatArray, scale: float, where: str | None) -> PlanarFit:
    """Fit through all points: nothing is left to estimate an error by."""
    spline.check_nodes(uv, where)
    coefficients, condition = spline.solve(uv, image, where)
    residuals = image - spline.evaluate(uv, coefficients, uv)
    values = image.T.ravel()
    unknown = np.full((len(values), len(values)), np.nan)
    return PlanarFit("tps", 1, centre, scale, values, residuals, unknown, float("nan"), condition, "left", uv)
