"""Damped Newton for many independent pairs of equations at once."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from geomosaic.types import BoolArray, FloatArray, IntArray

# Newton steps at most: a few suffice as a rule; lines of sight near the horizon need more.
ROUNDS = 60
# Halvings of a step at most: the last one tries a 2000th of it.
HALVINGS = 12
# Residual in pixels at which a row stops: rounding of coordinates of some 10 000 pixels leaves about 1e-12.
GOAL = 1e-10
# Residual in pixels of a solution: what the contract of sensor models promises of the inverse.
ACCEPTED = 1e-6
# Residual in pixels that is good enough on the way to a solution.
ROUGHLY = 1e-2


def solve_pairs(
    evaluate: Callable[[FloatArray, IntArray], FloatArray],
    target: FloatArray,
    start: FloatArray,
    step: float,
    accepted: float,
) -> FloatArray:
    """Solutions xy of evaluate(xy) = target, for each row by itself.

    Parameters
    ----------
    evaluate : callable
        xy (M, 2) and the row numbers (M,) they belong to, to values (M, 2); NaN where undefined.
    target : array (N, 2)
        Wanted values (pixels).
    start : array (N, 2)
        First guesses.
    step : float
        Change of xy that moves the values by about one pixel, for the forward differences.
    accepted : float
        Largest residual in pixels of a solution.

    Returns
    -------
    array (N, 2)
        NaN where no solution was found: the start is undefined, or there is none.

    Notes
    -----
    A step is halved while it makes the residual longer or leaves the domain, so a line of sight near the horizon or
    a point that would jump behind the camera still converges. Rows stop when their residual reaches rounding.
    """
    xy = np.array(start, dtype=np.float64)
    error = np.full(len(xy), np.inf)
    residual = np.full_like(xy, np.nan)
    rows = np.flatnonzero(np.isfinite(xy).all(axis=1) & np.isfinite(target).all(axis=1))
    if len(rows):
        residual[rows] = target[rows] - evaluate(xy[rows], rows)
        error[rows] = _length(residual[rows])
    # Rows whose start is undefined drop out at once: no direction can be had from NaN.
    rows = rows[np.isfinite(error[rows])]
    for _ in range(ROUNDS):
        rows = rows[error[rows] > GOAL]
        if not len(rows):
            break
        change = _newton_step(evaluate, xy[rows], rows, target[rows] - residual[rows], residual[rows], step)
        last = error[rows] <= ACCEPTED  # a step from here ends in rounding: no use in another
        improved = _damped(evaluate, target, xy, residual, error, rows, change)
        rows = rows[improved & ~last]
    xy[~(error <= accepted)] = np.nan
    return xy


def _newton_step(
    evaluate: Callable[[FloatArray, IntArray], FloatArray],
    xy: FloatArray,
    rows: IntArray,
    value: FloatArray,
    residual: FloatArray,
    step: float,
) -> FloatArray:
    """Newton steps (M, 2) by forward differences; NaN where singular."""
    columns = []
    for axis in range(2):
        moved = xy.copy()
        moved[:, axis] += step
        ahead = evaluate(moved, rows)
        lost = ~np.isfinite(ahead).all(axis=1)
        width = moved[:, axis] - xy[:, axis]
        if lost.any():  # at the edge of what can be seen: look the other way
            moved[lost, axis] = xy[lost, axis] - step
            ahead[lost] = evaluate(moved[lost], rows[lost])
            width = moved[:, axis] - xy[:, axis]
        columns.append((ahead - value) / width[:, None])
    (a, c), (b, d) = columns[0].T, columns[1].T
    with np.errstate(divide="ignore", invalid="ignore"):
        # Cramer's rule: for so many 2 x 2 systems a call of a solver for each costs far more than these products.
        determinant = a * d - b * c
        x = (d * residual[:, 0] - b * residual[:, 1]) / determinant
        y = (a * residual[:, 1] - c * residual[:, 0]) / determinant
    return np.column_stack([x, y])


def _damped(
    evaluate: Callable[[FloatArray, IntArray], FloatArray],
    target: FloatArray,
    xy: FloatArray,
    residual: FloatArray,
    error: FloatArray,
    rows: IntArray,
    change: FloatArray,
) -> BoolArray:
    """Rows that got better by the steps, which are taken in place, halved where needed."""
    improved = np.zeros(len(rows), dtype=bool)
    waiting = np.flatnonzero(np.isfinite(change).all(axis=1))
    factor = 1.0
    for _ in range(HALVINGS):
        if not len(waiting):
            break
        which = rows[waiting]
        trial = xy[which] + factor * change[waiting]
        left = target[which] - evaluate(trial, which)
        # NaN compares false, so a trial that leaves the domain counts as worse and is halved.
        length = _length(left)
        good = length < error[which]
        taken = which[good]
        xy[taken], residual[taken], error[taken] = trial[good], left[good], length[good]
        improved[waiting[good]] = True
        # Below a millionth of a pixel a failing step is rounding, not a wrong direction: no use in halving.
        waiting = waiting[~good & (error[which] > ACCEPTED)]
        factor *= 0.5
    return improved


def _length(residual: FloatArray) -> FloatArray:
    length: FloatArray = np.hypot(residual[:, 0], residual[:, 1])
    return length
