"""What the points around say of one that is left out: prediction by polyharmonic splines, with its variance.

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
    errors[kept] = coefficients[:count] / held[:, None]
    variance[kept] = 1.0 / np.abs(held)
    out = ~kept
    if out.any():
        row = np.column_stack([_kernel(places[out], nodes, order), powers(places[out], order)])
        errors[out] = image[out] - row @ coefficients
        variance[out] = np.abs(np.einsum("ni,ij,nj->n", row, inverse, row))
    return errors, variance


def powers(places: FloatArray, order: int) -> FloatArray:
    """All powers (N, order · (order + 1) / 2) of x and y below an order."""
    x, y = places.T
    return np.column_stack([x ** (i - j) * y**j for i in range(order) for j in range(i + 1)])


def _kernel(first: FloatArray, second: FloatArray, order: int) -> FloatArray:
    squared = ((first[:, None, :] - second) ** 2).sum(axis=2)
    sign = 1.0 if order % 2 == 0 else -1.0
    kernel: FloatArray = sign * 0.5 * squared ** (order - 1) * np.log(np.where(squared > 0.0, squared, 1.0))
    return kernel
