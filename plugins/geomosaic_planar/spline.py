"""The thin plate spline ground → image: the least bent surface through all points (Duchon 1977; Bookstein 1989).

col = a0 + a1·u + a2·v + Σ wᵢ·φ(rᵢ), likewise row; φ(r) = r²·log r, rᵢ = distance of (u, v) from node i. The weights
satisfy Σ wᵢ = Σ wᵢ·uᵢ = Σ wᵢ·vᵢ = 0, so far away the spline grows no faster than its affine part. The parameters are
the image coordinates at the nodes, on which the weights depend linearly; sigmas of points have no meaning, because
the spline passes through all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from typing import NamedTuple

import numpy as np

from geomosaic.errors import SolveError
from geomosaic.types import FloatArray, IntArray

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
# Nodes from which a treecode pays.
MANY = 400
# Nodes of a cell that are asked one by one; where more are near, its quarters have fewer.
FEW = 80
# Half sides of a cell from its middle beyond which nodes are far: over it, polynomials of so many terms along u and
# along v err by 1e-7 of what those bend. Nearer nodes would need more terms, farther ones smaller cells.
FAR, TERMS = 5.0, 12
# |u| and |v| within which there are cells, and half the side of the smallest.
REACH, SMALLEST = 2.0, 2.0**-12
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


def _bordered(nodes: FloatArray) -> FloatArray:
    """Bordered matrix [[φ(rᵢⱼ), 1, u, v], [1ᵀ, 0, 0, 0], [uᵀ, 0, 0, 0], [vᵀ, 0, 0, 0]] of normalised nodes (N, 2)."""
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
    matrix = _bordered(nodes)
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
    affine = coefficients[len(nodes) :]
    image: FloatArray = _bends(nodes, coefficients, uv) + affine[0] + uv[:, :1] * affine[1] + uv[:, 1:] * affine[2]
    image[~np.isfinite(uv).all(axis=1)] = np.nan
    return image


def _bends(nodes: FloatArray, weights: FloatArray, uv: FloatArray) -> FloatArray:
    """Σ wᵢ·φ(rᵢ) at places (M, 2): (M, 2)."""
    bends, by_axis = np.empty((len(uv), 2)), np.ascontiguousarray(weights[: len(nodes)].T)
    for part in _blocks(len(uv), len(nodes)):
        radial = _radial(uv[part], nodes)
        for axis in (0, 1):
            # A sum per point, not a matrix product: the same bytes whatever other points come with it.
            bends[part, axis] = np.einsum("mn,n->m", radial, by_axis[axis])
    return bends


@dataclass(frozen=True, eq=False)
class _Cell:
    """Square of the plane with its near nodes, and all others as a polynomial [of u, of v, col or row] over it."""

    middle: FloatArray
    half: float
    near: IntArray
    far: FloatArray
    quarters: list[_Cell | None] = field(default_factory=lambda: [None] * 4)


@dataclass(frozen=True, eq=False)
class Treecode:
    """The spline of `evaluate` at many places, within 1e-7 of what it bends.

    Far from its node φ is smooth: over a cell, the sum over far nodes is interpolated at Chebyshev points (Fong & Darve
    2009). Cells are quarters of quarters, made when a place in them is asked; each takes over the polynomial of the one
    above, and adds the nodes that are far from it but not from that. A place asks few nodes, however many there are.

    Attributes
    ----------
    nodes, coefficients : array (N, 2), (N + 3, 2)
        As for `evaluate`.
    """

    nodes: FloatArray
    coefficients: FloatArray
    _top: list[_Cell] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        constant, along_u, along_v = self.coefficients[len(self.nodes) :]
        affine = np.zeros((TERMS, TERMS, 2))
        affine[0, 0], affine[1, 0], affine[0, 1] = constant, along_u * REACH, along_v * REACH
        self._top.append(_Cell(np.zeros(2), REACH, np.arange(len(self.nodes)), affine))

    def __call__(self, uv: FloatArray) -> FloatArray:
        """Image (M, 2) of normalised ground (M, 2), pixels; NaN for points that are not finite."""
        inside = (np.abs(uv) < REACH).all(axis=1)
        image = np.empty((len(uv), 2))
        image[~inside] = evaluate(self.nodes, self.coefficients, uv[~inside])
        self._fill(self._top[0], uv, np.flatnonzero(inside), image)
        return image

    def _fill(self, cell: _Cell, uv: FloatArray, which: IntArray, image: FloatArray) -> None:
        """Fill the image at places in a cell, given by their numbers."""
        if len(cell.near) <= FEW or cell.half < SMALLEST:
            for part in _blocks(len(which), 2 * TERMS):
                here = uv[which[part]]
                image[which[part]] = _polynomial(cell, here) + self._bends(cell.near, here)
            return
        right, above = (uv[which] >= cell.middle).T
        for number in range(4):
            some = which[right + 2 * above == number]
            if len(some):
                # Threads may make the same quarter at a time: it is the same.
                quarter = cell.quarters[number] = cell.quarters[number] or self._quarter(cell, number)
                self._fill(quarter, uv, some, image)

    def _bends(self, which: IntArray, uv: FloatArray) -> FloatArray:
        return _bends(self.nodes[which], self.coefficients[which], uv)

    def _quarter(self, cell: _Cell, number: int) -> _Cell:
        right, above = number % 2, number // 2
        half = cell.half / 2
        middle = cell.middle + half * np.array([2 * right - 1, 2 * above - 1])
        places, to_terms, halves = _chebyshev_points()
        uv = np.stack(np.meshgrid(*(middle[:, None] + half * places), indexing="ij"), axis=-1)
        far = np.abs(self.nodes[cell.near] - middle).max(axis=1) >= FAR * half
        image = np.einsum("ai,ijk->ajk", halves[right], np.einsum("bj,ijk->ibk", halves[above], cell.far))
        image += self._bends(cell.near[far], uv.reshape(-1, 2)).reshape(image.shape)
        terms = np.einsum("ia,ajk->ijk", to_terms, np.einsum("jb,abk->ajk", to_terms, image))
        return _Cell(middle, half, cell.near[~far], terms)


def _polynomial(cell: _Cell, uv: FloatArray) -> FloatArray:
    """Polynomial of a cell at places (M, 2): (M, 2)."""
    u, v = _chebyshev(((uv - cell.middle) / cell.half).T).transpose(1, 0, 2)
    # Terms of a higher degree in both together are as small as those that are left out along one axis. Sums are written
    # out, not matrix products: the same bytes whatever other points come with it.
    by_v = cell.far[0][:, :, None] * u[0]
    for k in range(1, TERMS):
        by_v[: TERMS - k] += cell.far[k, : TERMS - k, :, None] * u[k]
    image: FloatArray = by_v[0] * v[0]
    for k in range(1, TERMS):
        image += by_v[k] * v[k]
    return image.T


def _chebyshev(t: FloatArray) -> FloatArray:
    """Chebyshev polynomials (TERMS, ...) of numbers from −1 to 1."""
    found = np.ones((TERMS, *t.shape))
    found[1] = t
    for k in range(2, TERMS):
        found[k] = 2 * t * found[k - 1] - found[k - 2]
    return found


@cache
def _chebyshev_points() -> tuple[FloatArray, FloatArray, tuple[FloatArray, FloatArray]]:
    """Chebyshev points; the matrix from values there to terms; those from terms to values at the points of halves."""
    angles = (2 * np.arange(TERMS) + 1) * np.pi / (2 * TERMS)
    places = np.cos(angles)
    to_terms = np.cos(np.arange(TERMS)[:, None] * angles) * 2 / TERMS
    to_terms[0] /= 2
    return places, to_terms, (_chebyshev((places - 1) / 2).T, _chebyshev((places + 1) / 2).T)


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
    shares = np.linalg.solve(_bordered(nodes), row.T)[: len(nodes)].T
    return np.asarray(shares, dtype=np.float64)


def _radial(uv: FloatArray, nodes: FloatArray) -> FloatArray:
    """r²·log r (M, N) between points and nodes; 0 at a node."""
    # r²·log r = r²/2·log r², which needs no square root; in place, as each fresh array costs as much as a logarithm.
    x, y = np.ascontiguousarray(nodes.T)
    squared, other = uv[:, :1] - x, uv[:, 1:] - y
    squared *= squared
    other *= other
    squared += other
    radial: FloatArray = np.log(np.add(squared, TINY, out=other), out=other)
    radial *= np.multiply(squared, 0.5, out=squared)
    return radial


def _blocks(points: int, nodes: int) -> list[slice]:
    step = max(1, BLOCK // max(nodes, 1))
    return [slice(start, start + step) for start in range(0, points, step)]
