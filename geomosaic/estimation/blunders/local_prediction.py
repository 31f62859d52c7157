"""Local prediction of points from their neighbours: polyharmonic splines, and the perspective most points agree with.

The spline of order m has the kernel (−1)^m r^(2m−2) log r, bordered by all powers of x and y below m; m = 2 is the thin
plate spline. Its error of prediction is that of kriging with a generalised covariance (Matheron 1981), and the
variance of it grows with the distance to the others: quickly for the higher orders, which follow a bend outwards.
"""

from __future__ import annotations

import numpy as np

from geomosaic.types import BoolArray, FloatArray


def predictions(
    places: FloatArray, image: FloatArray, kept: BoolArray, smooth: float = 1e-10, order: int = 2
) -> tuple[FloatArray, FloatArray]:
    """Errors (N, 2) of all points under the spline through those kept, the point itself left out.

    Parameters
    ----------
    places : array (N, 2)
        On the map, |x|, |y| ≤ 1 or so.
    image : array (N, 2)
        Pixels.
    kept : bool array (N,)
    smooth : float
        Added to the diagonal of the kernel: the spline then passes near its points instead of through them.
    order : int
        2 or more.

    Returns
    -------
    errors : array (N, 2)
        Measured minus predicted.
    variance : array (N,)
        Of prediction, up to a factor.
    """
    nodes, values = places[kept], image[kept]
    count, border = len(nodes), powers(nodes, order)
    matrix = np.zeros((count + border.shape[1],) * 2)
    matrix[:count, :count] = _kernel(nodes, nodes, order) + smooth * np.eye(count)
    matrix[:count, count:], matrix[count:, :count] = border, border.T
    inverse = np.linalg.inv(matrix)
    coefficients = inverse[:, :count] @ values
    errors, variance = np.zeros_like(image), np.zeros(len(image))
    own = np.diagonal(inverse)[:count]
    held = np.where(np.abs(own) > 1e-14, own, np.inf)
    # Leave-one-out errors in closed form, without a fit for each point: coefficient over the inverse's diagonal.
    errors[kept] = coefficients[:count] / held[:, None]
    variance[kept] = 1.0 / np.abs(held)
    out = ~kept
    if out.any():
        row = np.column_stack([_kernel(places[out], nodes, order), powers(places[out], order)])
        errors[out] = image[out] - row @ coefficients
        variance[out] = np.abs(np.einsum("ni,ij,nj->n", row, inverse, row))
    return errors, variance


def powers(places: FloatArray, order: int) -> FloatArray:
    """All powers (N, order · (order + 1) / 2) of x and y below an order.

    Parameters
    ----------
    places : array (N, 2)
    order : int
    """
    x, y = places.T
    return np.column_stack([x ** (i - j) * y**j for i in range(order) for j in range(i + 1)])


def _kernel(first: FloatArray, second: FloatArray, order: int) -> FloatArray:
    squared = ((first[:, None, :] - second) ** 2).sum(axis=2)
    sign = 1.0 if order % 2 == 0 else -1.0
    kernel: FloatArray = sign * 0.5 * squared ** (order - 1) * np.log(np.where(squared > 0.0, squared, 1.0))
    return kernel


SAMPLES = 200
"""Of five points each: with 40 % blunders some fifteen are free of them."""
SIZE = 5
"""Points of a sample; four determine it."""
SHARE = 0.6
"""Points that should agree: 40 % may be blunders."""
STEPS = 10
"""Concentration steps; three quarters of the samples drop out at each."""


def without_perspective(places: FloatArray, image: FloatArray) -> FloatArray:
    """Image less the projective transformation that most points agree with (least trimmed squares from small samples).

    Parameters
    ----------
    places : array (N, 2)
        On the map, |x|, |y| ≤ 1 or so.
    image : array (N, 2)
        Pixels.

    Returns
    -------
    array (N, 2)
        What is left, pixels; the image itself where no sample determines the transformation.
    """
    count = len(places)
    middle = image.mean(axis=0)
    extent = max(float(np.abs(image - middle).max()), 1e-300)
    target = (image - middle) / extent
    held = max(SIZE, round(SHARE * count))
    random = np.random.default_rng(0)
    chosen = np.argsort(random.random((SAMPLES, count)), axis=1)[:, : min(SIZE, count)]
    left = np.empty((0, count, 2))
    for _ in range(STEPS):
        left = target - _apply(_solve(places[chosen], target[chosen]), places)
        length = np.where(np.isfinite(left).all(axis=2), np.hypot(left[..., 0], left[..., 1]), np.inf)
        order = np.argsort(length, axis=1)
        total = np.take_along_axis(length, order, axis=1)[:, :held].sum(axis=1)
        best = np.argsort(total, kind="stable")[: max(1, len(total) // 4)]
        chosen, left = order[best][:, :held], left[best]
    found: FloatArray = left[0] * extent
    return found if np.isfinite(found).all() else image - middle


def _solve(places: FloatArray, image: FloatArray) -> FloatArray:
    """Coefficients (S, 8) of col = (a + b·x + c·y) / (1 + g·x + h·y), row alike, of S samples (S, K, 2)."""
    one = np.ones((*places.shape[:2], 1))
    zero = np.zeros((*places.shape[:2], 3))
    plane = np.concatenate([one, places], axis=2)
    rows = [
        np.concatenate([plane, zero, -places * image[:, :, :1]], axis=2),
        np.concatenate([zero, plane, -places * image[:, :, 1:]], axis=2),
    ]
    design = np.concatenate(rows, axis=1)
    right = np.concatenate([image[:, :, 0], image[:, :, 1]], axis=1)
    # A trace of damping keeps samples in line solvable; they drop out by their errors.
    normal = np.einsum("ski,skj->sij", design, design) + 1e-12 * np.eye(8)
    solved: FloatArray = np.linalg.solve(normal, np.einsum("ski,sk->si", design, right)[:, :, None])[:, :, 0]
    return solved


def _apply(coefficients: FloatArray, places: FloatArray) -> FloatArray:
    plane = np.column_stack([np.ones(len(places)), places])
    below = 1.0 + coefficients[:, 6:] @ places.T
    with np.errstate(divide="ignore", invalid="ignore"):
        image = np.stack([coefficients[:, :3] @ plane.T, coefficients[:, 3:6] @ plane.T], axis=2) / below[:, :, None]
    # Near the vanishing line, where the denominator is 0, places run off to infinity.
    found: FloatArray = np.where(below[:, :, None] > 0.05, image, np.nan)
    return found
