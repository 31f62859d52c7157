"""Image → normalised ground, to find what an image shows; the general inverse is `geomosaic.sensor.solve`'s."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from geomosaic.types import FloatArray
from geomosaic_planar.terms import evaluate

ROUNDS = 60
HALVINGS = 6
STALLED = 0.999
NEAR = 1e-3
"""Pixels within which a point counts as found."""


def projective_inverse(values: FloatArray, colrow: FloatArray) -> FloatArray:
    """Normalised ground (N, 2) of image points in closed form; NaN beyond the horizon."""
    a, c = values[:6].reshape(2, 3), values[6:]
    uv = _solve2(a[None, :, 1:] - colrow[:, :, None] * c, colrow - a[:, 0])
    uv[~np.isfinite(evaluate("projective", 1, values, uv)).all(axis=1)] = np.nan
    return uv


def newton_inverse(
    image: Callable[[FloatArray], FloatArray],
    slopes: Callable[[FloatArray], FloatArray],
    colrow: FloatArray,
    start: FloatArray,
) -> FloatArray:
    """Normalised ground (N, 2) of image points by Newton's method.

    Parameters
    ----------
    image, slopes : callable
        Normalised ground (N, 2) to image (N, 2) and to its derivatives (N, 2, 2).
    colrow : array (N, 2)
    start : array (N, 2)
        Normalised ground to begin at.

    Returns
    -------
    array (N, 2)
        NaN where the method finds no ground. Steps that lead farther off the goal are halved; a point that comes no
        nearer is given up.
    """
    uv = start.copy()
    left = colrow - image(uv)
    open_ = np.arange(len(uv))
    for _ in range(ROUNDS):
        here, goal = uv[open_], colrow[open_]
        change = _solve2(slopes(here), left[open_])
        off = np.hypot(*left[open_].T)
        small = (np.abs(change) <= 1e-13 * np.maximum(1.0, np.abs(here))).all(axis=1)
        trial, after = here + change, goal - image(here + change)
        for _ in range(HALVINGS):
            worse = ~(np.hypot(*after.T) <= off) & ~small
            if not worse.any():
                break
            change[worse] *= 0.5
            trial[worse] = here[worse] + change[worse]
            after[worse] = goal[worse] - image(trial[worse])
        now = np.hypot(*after.T)
        better = (now <= off) | small
        uv[open_[better]], left[open_[better]] = trial[better], after[better]
        open_ = open_[better & ~small & ~((now > STALLED * off) & (off > NEAR))]
        if not len(open_):
            break
    uv[~(np.abs(left).max(axis=1) < NEAR)] = np.nan
    return uv


def _solve2(matrix: FloatArray, right: FloatArray) -> FloatArray:
    """Solve 2 × 2 systems (N, 2, 2), (N, 2); NaN where singular."""
    (a, b), (c, d) = matrix[:, 0].T, matrix[:, 1].T
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        determinant = a * d - b * c
        x = (d * right[:, 0] - b * right[:, 1]) / determinant
        y = (a * right[:, 1] - c * right[:, 0]) / determinant
    solution = np.column_stack([x, y])
    solution[~np.isfinite(solution).all(axis=1)] = np.nan
    return solution
