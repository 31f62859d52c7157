"""Sequential A-optimal design: the measurement that lowers the mean variance of predicted positions most.

With Q the covariance of the parameters, B the derivatives of a measurement by them and N its covariance, the adjustment
with that measurement has

    Q' = Q − Q·Bᵀ·(N + B·Q·Bᵀ)⁻¹·B·Q

(matrix inversion lemma; Fedorov, Theory of Optimal Experiments, 1972). Positions with derivatives T have the mean
variance tr(W·Q), W = Σ Tᵀ·T / M, so a measurement lowers it by tr((N + B·Q·Bᵀ)⁻¹·B·Q·W·Q·Bᵀ). Neither needs the
measured value: how much it would help is known before it is made.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from geomosaic.types import BoolArray, FloatArray, IntArray

# Rounds of exchanges; the third hardly ever changes anything.
EXCHANGES = 10


def mean_weight(targets: FloatArray) -> FloatArray:
    """Matrix W (P, P) whose trace with a covariance of the parameters is the mean variance of positions.

    Parameters
    ----------
    targets : array (M, 2, P)
        Derivatives of the positions by the parameters; those that are not finite do not count.
    """
    known = targets[np.isfinite(targets).all(axis=(1, 2))]
    rows = known.reshape(-1, targets.shape[2])
    return rows.T @ rows / max(len(known), 1)


def variance_decreases(covariance: FloatArray, weight: FloatArray, design: FloatArray, noise: FloatArray) -> FloatArray:
    """Decrease of the mean variance tr(W·Q) by each of N further measurements alone.

    Parameters
    ----------
    covariance : array (P, P)
        Q of the parameters.
    weight : array (P, P)
        W of `mean_weight`.
    design : array (N, K, P)
        Derivatives of the K values of each measurement by the parameters.
    noise : array (N, K, K)
        Covariances of the measurements.

    Returns
    -------
    array (N,)
        In the squared unit of the positions; NaN where a derivative is not finite.
    """
    found = np.full(len(design), np.nan)
    seen = np.isfinite(design).all(axis=(1, 2)) & np.isfinite(noise).all(axis=(1, 2))
    by = design[seen] @ covariance  # (N, K, P)
    spread = noise[seen] + by @ design[seen].transpose(0, 2, 1)
    gain = by @ weight @ by.transpose(0, 2, 1)
    found[seen] = np.trace(np.linalg.solve(spread, gain), axis1=1, axis2=2)
    return found


def updated_covariance(covariance: FloatArray, design: FloatArray, noise: FloatArray) -> FloatArray:
    """Covariance Q' (P, P) of the parameters with one more measurement.

    Parameters
    ----------
    covariance : array (P, P)
    design : array (K, P)
        Derivatives of the measurement's values by the parameters.
    noise : array (K, K)
        Covariance of the measurement.
    """
    by = design @ covariance
    lower: FloatArray = covariance - by.T @ np.linalg.solve(noise + by @ design.T, by)
    return 0.5 * (lower + lower.T)


@dataclass(frozen=True, eq=False)
class Order:
    """Order of measurements, the most useful one first.

    Attributes
    ----------
    chosen : int array (C,)
        Numbers of the measurements.
    variances : array (C + 1,)
        Mean variance of the positions before the first, and after each.
    """

    chosen: IntArray
    variances: FloatArray


def greedy_order(
    covariance: FloatArray, weight: FloatArray, design: FloatArray, noise: FloatArray, count: int, together: int = 1
) -> Order:
    """Order in which measurements lower the mean variance most, each after those before it.

    Parameters
    ----------
    covariance, weight, design, noise
        As for `variance_decreases`.
    count : int
        Measurements to choose, each once; fewer where fewer are finite.
    together : int
        Number of the first ones that are judged as a set, as only all of them determine the parameters: each is
        exchanged for another one as long as that lowers the variance (Fedorov 1972).
    """
    open_: BoolArray = np.asarray(np.isfinite(design).all(axis=(1, 2)))
    count = min(count, int(open_.sum()))

    def best(before: FloatArray, free: BoolArray) -> int:
        gains = np.nan_to_num(variance_decreases(before, weight, design, noise), nan=-np.inf)
        return int(np.argmax(np.where(free, gains, -np.inf)))

    def after(chosen: list[int]) -> FloatArray:
        lower = covariance
        for one in chosen:
            lower = updated_covariance(lower, design[one], noise[one])
        return lower

    chosen: list[int] = []
    lower = covariance
    while len(chosen) < count:
        chosen.append(best(lower, open_))
        open_[chosen[-1]] = False
        if len(chosen) == together > 1:
            chosen = _exchanged(chosen, open_, best, after)
            lower = after(chosen)
        else:
            lower = updated_covariance(lower, design[chosen[-1]], noise[chosen[-1]])
    variances = [float(np.trace(weight @ after(chosen[:size]))) for size in range(len(chosen) + 1)]
    return Order(np.array(chosen, dtype=np.int64), np.array(variances))


def _exchanged(
    chosen: list[int],
    open_: BoolArray,
    best: Callable[[FloatArray, BoolArray], int],
    after: Callable[[list[int]], FloatArray],
) -> list[int]:
    """Measurements of which none can be exchanged for a better one; `open_` follows."""
    for _ in range(EXCHANGES):
        before = list(chosen)
        for place in range(len(chosen)):
            open_[chosen[place]] = True
            chosen[place] = best(after(chosen[:place] + chosen[place + 1 :]), open_)
            open_[chosen[place]] = False
        if chosen == before:
            break
    return chosen
