"""Normal equations that are summed entry by entry, where observations are too many to be kept as a design.

Differences of millions of pixel pairs, or of overlaps of images, touch the unknowns of two images each: their sums are
a small matrix, dense or sparse. What has an image's own parameters and object points is a `Network`.
"""

from __future__ import annotations

import numpy as np

from geomosaic.types import FloatArray, IntArray


def solve_normal_equations(
    rows: IntArray, cols: IntArray, values: FloatArray, right: FloatArray, max_dense: int
) -> FloatArray:
    """Solution of normal equations whose matrix is given by entries; those of one place are added in their order.

    Parameters
    ----------
    rows, cols : int array (entries,)
    values : array (entries,)
    right : array (unknowns,)
        Right-hand side.
    max_dense : int
        Unknowns beyond which the matrix is kept sparse.

    Returns
    -------
    array (unknowns,)
    """
    size = len(right)
    if size <= max_dense:
        return np.asarray(
            np.linalg.solve(np.bincount(rows * size + cols, values, size * size).reshape(size, size), right)
        )
    from scipy.sparse import coo_matrix
    from scipy.sparse.linalg import splu

    # Positive definite: no pivots are looked for, and columns are ordered by minimum degree, whose factors of a block's
    # graph are a fraction of those of an unsymmetric ordering.
    normal = coo_matrix((values, (rows, cols)), shape=(size, size)).tocsc()
    factors = splu(normal, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})
    return np.asarray(factors.solve(right))
