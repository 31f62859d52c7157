"""The thin plate spline ground → image: the least bent surface through all points (Duchon 1977; Bookstein 1989).

col = a0 + a1·u + a2·v + Σ wᵢ·φ(rᵢ), likewise row; φ(r) = r²·log r, rᵢ = distance of (u, v) from node i. The weights
satisfy Σ wᵢ = Σ wᵢ·uᵢ = Σ wᵢ·vᵢ = 0, so far away the spline grows no faster than its affine part. The parameters are
the image coordinates at the nodes, on which the weights depend linearly; sigmas of points have no meaning, because
the spline passes through all of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.types import FloatArray

# Nodes nearer to each other, as a share of the extent, are one place.
CLOSEST = 1e-7
# About 1 / √ε of double precision: beyond it the third direction is rounding.
WORST_LINE = 1e8
# Two digits short of double precision, so that the refinement in `solve` still gains digits.
WORST_CONDITION = 1e14
# Distances that are held at a time: with their logarithms they stay in a processor's second-level cache. Half a million
# took three times as long.
BLOCK = 1 << 15
# Added to squares of distances, of which it changes no digit: at a node r²·log r is 0, and log 0 would make it NaN.
TINY = 1e-300
NO_NODES = np.empty((0, 2))
NO_NODES.setflags(write=False)


class Solved(NamedTuple):
    """Spline through image positions.

    Attributes
    ----------
    coefficients : array (N + 3, 2)
        Weights of the nodes, then a0, a1, a2; columns for col and row.
    condition : float
        Of the matrix, in the norm of columns' sums.
    omissions : array (N, 2)
        Leave-one-out errors: image at each node minus what the spline through all other nodes gives there, pixels; NaN
        for a node without which the others lie on a line.
    """

    coefficients: FloatArray
    condition: float
    omissions: FloatArray


def bordered(nodes: FloatArray) -> FloatArray:
    """Bordered matrix of the spline: conditions at the nodes, and on the weights.

    Parameters
    ----------
    nodes : array (N, 2)
        Normalised ground u, v.

    Returns
    -------
    array (N + 3, N + 3)
        [[φ(rᵢⱼ), 1, u, v], [1ᵀ, 0, 0, 0], [uᵀ, 0, 0, 0], [vᵀ, 0, 0, 0]]; symmetric, indefinite.
    """
    count = len(nodes)
    matrix = np.zeros((count + 3, count + 3))
    matrix[:count, :count] = _radial(nodes, nodes)
    matrix[:count, count] = matrix[count, :count] = 1.0
    matrix[:count, count + 1 :] = nodes
    matrix[count + 1 :, :count] = nodes.T
    return matrix


def check_nodes(nodes: FloatArray, where: str | None = None) -> None:
    """Check that nodes determine a spline: not too many, no two on one place, not all on a line.

    Parameters
    ----------
    nodes : array (N, 2)
        Normalised ground u, v.
    where : str, optional
        Named in errors.

    Raises
    ------
    SolveError
        Too many nodes, two on one place, or all on a line.
    """
    from geomosaic.options.control import MOST_SPLINE_POINTS  # a model that only draws needs no options of control

    if len(nodes) > MOST_SPLINE_POINTS:
        raise SolveError(
            f"{len(nodes)} control points are too many for a thin plate spline, whose matrix has a row and a column "
            f"for each: {MOST_SPLINE_POINTS} at most",
            where=where,
            hint="thin out the points, or choose a kind that averages, such as polynomial",
        )
    if (pair := _coincident(nodes)) is not None:
        one, other = pair
        raise SolveError(
            f"control points {one + 1} and {other + 1} lie on one place of the ground, and a thin plate spline "
            "passes through every point once",
            where=where,
            hint="leave one of them out, or their mean in; or choose a kind that averages, such as polynomial",
        )
    singular = np.linalg.svd(np.column_stack([np.ones(len(nodes)), nodes]), compute_uv=False)
    if singular[-1] * WORST_LINE < singular[0]:
        raise SolveError(
            "the control points lie on a line, and a thin plate spline is not determined beside it",
            where=where,
            hint="measure points on both sides of the line, or choose a conformal fit",
        )


def _coincident(nodes: FloatArray) -> tuple[int, int] | None:
    """Numbers of two nodes (N, 2) on one place, the lesser first; None where all are apart."""
    # Along a direction that no grid has, few others are as near as two on one place. A tree would load SciPy.
    along = nodes @ (np.cos(1.0), np.sin(1.0))
    order = np.argsort(along, kind="stable")
    for step in range(1, len(nodes)):
        first, second = order[:-step], order[step:]
        if (along[second] - along[first]).min() > 2.0 * CLOSEST:
            return None
        apart = np.abs(nodes[second] - nodes[first]).max(axis=1)
        if apart.min() < CLOSEST:
            closest = np.argmin(apart)
            return int(min(first[closest], second[closest])), int(max(first[closest], second[closest]))
    return None


def solve(nodes: FloatArray, image: FloatArray, where: str | None = None) -> Solved:
    """Coefficients of the spline through image positions, and its leave-one-out errors wᵢ / (M⁻¹)ᵢᵢ (Rippa 1999).

    Parameters
    ----------
    nodes : array (N, 2)
        Normalised ground, |u|, |v| ≤ 1 or so, as `check_nodes` accepts it.
    image : array (N, 2)
        col, row at the nodes, pixels.
    where : str, optional
        Named in errors.

    Raises
    ------
    SolveError
        The matrix is singular to rounding.
    """
    matrix = bordered(nodes)
    right = np.vstack([image, np.zeros((3, 2))])
    try:
        inverse: FloatArray = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
    except np.linalg.LinAlgError:
        inverse = np.full_like(matrix, np.inf)
    condition = float(np.abs(matrix).sum(axis=0).max() * np.abs(inverse).sum(axis=0).max())
    if not condition < WORST_CONDITION:
        raise SolveError(
            f"the control points do not determine a thin plate spline (condition {condition:.0e}): some lie almost on "
            "one place",
            where=where,
            hint="leave out points that repeat others, or choose a polynomial",
        )
    coefficients: FloatArray = inverse @ right
    for _ in range(2):  # refinement: the spline meets its nodes to rounding
        coefficients += inverse @ (right - matrix @ coefficients)
    # M is the bordered matrix: its inverse is at hand, and no spline has to be solved again without a node.
    own = np.diagonal(inverse)[: len(nodes)]
    held = np.where(np.abs(own) > 1.0 / WORST_CONDITION, own, np.nan)
    return Solved(coefficients, condition, coefficients[: len(nodes)] / held[:, None])


def evaluate(nodes: FloatArray, coefficients: FloatArray, uv: FloatArray) -> FloatArray:
    """Image of normalised ground under the spline.

    Parameters
    ----------
    nodes : array (N, 2)
        Normalised ground u, v.
    coefficients : array (N + 3, 2)
        As `solve` gives them.
    uv : array (M, 2)
        Normalised ground.

    Returns
    -------
    array (M, 2)
        col, row in pixels; NaN for points that are not finite.
    """
    count = len(nodes)
    image = np.empty((len(uv), 2))
    weights, affine = coefficients[:count], coefficients[count:]
    for part in _blocks(len(uv), count):
        here = uv[part]
        radial = _radial(here, nodes)
        for axis in (0, 1):
            # A sum per point, not a matrix product: the same bytes whatever other points come with it.
            bend = np.einsum("mn,n->m", radial, weights[:, axis])
            image[part, axis] = bend + affine[0, axis] + here[:, 0] * affine[1, axis] + here[:, 1] * affine[2, axis]
    image[~np.isfinite(uv).all(axis=1)] = np.nan
    return image


def slopes(nodes: FloatArray, coefficients: FloatArray, uv: FloatArray) -> FloatArray:
    """Derivatives of the spline by normalised ground.

    Parameters
    ----------
    nodes, coefficients, uv
        As for `evaluate`.

    Returns
    -------
    array (M, 2, 2)
        Of (col, row) by (u, v), pixels; NaN for points that are not finite.
    """
    # Those of r²·log r are (2·log r + 1)·(u − uᵢ, v − vᵢ).
    count = len(nodes)
    found = np.empty((len(uv), 2, 2))
    weights, affine = coefficients[:count], coefficients[count:]
    for part in _blocks(len(uv), count):
        apart = uv[part][:, None, :] - nodes
        squared = (apart**2).sum(axis=2)
        factor = np.log(np.where(squared > 0.0, squared, 1.0)) + 1.0
        for axis in (0, 1):
            found[part, :, axis] = np.einsum("mn,nk->mk", factor * apart[:, :, axis], weights) + affine[1 + axis]
    found[~np.isfinite(uv).all(axis=1)] = np.nan
    return found


def influence(nodes: FloatArray, uv: FloatArray) -> FloatArray:
    """Influence of the nodes: derivatives of the image by the image positions at the nodes.

    Parameters
    ----------
    nodes : array (N, 2)
        Normalised ground u, v.
    uv : array (M, 2)
        Normalised ground.

    Returns
    -------
    array (M, N)
        Without unit, the same for col and row; each line sums to 1.
    """
    row = np.column_stack([_radial(uv, nodes), np.ones(len(uv)), uv])
    shares = np.linalg.solve(bordered(nodes), row.T)[: len(nodes)].T
    return np.asarray(shares, dtype=np.float64)


def _radial(uv: FloatArray, nodes: FloatArray) -> FloatArray:
    """r²·log r (M, N) between points and nodes; 0 at a node."""
    # r²·log r = r²/2·log r², which needs no square root; in place, as each fresh array costs as much as a logarithm.
    squared, other = uv[:, :1] - nodes[:, 0], uv[:, 1:] - nodes[:, 1]
    squared *= squared
    other *= other
    squared += other
    radial: FloatArray = np.log(np.add(squared, TINY, out=other), out=other)
    radial *= np.multiply(squared, 0.5, out=squared)
    return radial


def _blocks(points: int, nodes: int) -> list[slice]:
    step = max(1, BLOCK // max(nodes, 1))
    return [slice(start, start + step) for start in range(0, points, step)]
