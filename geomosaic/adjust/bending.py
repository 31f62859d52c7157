"""Points that a fit misses because the image is bent, and not because they are wrong: the points around them agree.

A polynomial of a bent image misses the corners most, and a thin plate spline, straight outside its points, misses
them more. Splines of higher orders follow the bend outwards, and know how little they know there.
"""

from __future__ import annotations

import numpy as np

from geomosaic.adjust.polyharmonic import predictions
from geomosaic.types import AnyArray, BoolArray, FloatArray

ORDERS = (3, 4)
AROUND = 60
"""Points that predict one."""
FEWEST = 12
WITHIN = 3.0
"""Median errors to be expected of it, within which a point agrees with those around it."""
TELLING = 7.0
"""Pixels, the median error to be expected beyond which an order, extrapolating, tells nothing: any blunder agrees."""
COMPARABLE = 2.0
"""Times the least median error, up to which an order is a witness."""
ROUNDS = 10


def explained_by_bend(ground: AnyArray, colrow: AnyArray, accused: BoolArray) -> BoolArray:
    """Which of the accused a smooth bend explains, as the points around them have it.

    Those that are explained help to explain the next ones, from the inside outwards.

    Parameters
    ----------
    ground : array (N, 2) or (N, 3)
        Places on the map; x and y count.
    colrow : array (N, 2)
        Measured pixels.
    accused : bool array (N,)

    Returns
    -------
    bool array (N,)
        None where fewer than 12 others are left.
    """
    places, image = np.array(ground, dtype=np.float64)[:, :2], np.array(colrow, dtype=np.float64)
    kept = ~accused
    for _ in range(ROUNDS):
        if kept.sum() < FEWEST:
            break
        agree = [i for i in np.flatnonzero(~kept) if _agrees(places, image, kept, int(i))]
        if not agree:
            break
        kept = kept.copy()
        kept[agree] = True
    found: BoolArray = kept & accused
    return found


def _agrees(places: FloatArray, image: FloatArray, kept: BoolArray, index: int) -> bool:
    apart = np.where(kept, np.hypot(*(places - places[index]).T), np.inf)
    near = np.append(np.argsort(apart, kind="stable")[: min(AROUND, int(kept.sum()))], index)
    local = places[near] - places[near].mean(axis=0)
    local /= max(float(np.abs(local).max()), 1e-300)
    others = np.arange(len(near)) < len(near) - 1
    medians, agree = list[float](), list[bool]()
    for order in ORDERS:
        if len(near) < order * (order + 1):  # twice the powers it needs
            continue
        try:
            errors, variance = predictions(local, image[near], others, order=order)
        except np.linalg.LinAlgError:
            continue
        lengths = np.hypot(*errors.T)
        spread = np.sqrt(np.maximum(variance, 1e-300))
        expected = float(spread[-1] * np.median(lengths[others] / spread[others]))
        medians.append(float(np.median(lengths[others])))
        agree.append(expected <= TELLING and bool(lengths[-1] <= WITHIN * expected))
    least = min(medians, default=0.0)
    return any(told and m <= COMPARABLE * least for told, m in zip(agree, medians, strict=True))
