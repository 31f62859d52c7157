"""Grey values by curves: percentiles, linear, gamma, equalisation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.errors import InputError
from geomosaic.types import AnyArray, FloatArray

LEVELS = 256


@dataclass(frozen=True, eq=False)
class Curve:
    """A rising curve from values to 0 ... 255, straight between its nodes and level beyond them.

    Attributes
    ----------
    values, levels : array (N,)
        Rising nodes.
    """

    values: FloatArray
    levels: FloatArray

    def __call__(self, values: AnyArray) -> FloatArray:
        """Levels of values, not rounded."""
        # Halves stay halves, and are rounded as they should.
        found: FloatArray = np.round(np.interp(values, self.values, self.levels), 9)
        return found


def percentile_limits(values: AnyArray, low: float, high: float) -> tuple[float, float]:
    """Values below and above which `low` and 100 - `high` per cent of the values lie."""
    if not 0 <= low < high <= 100:
        raise InputError(f"percentiles {low:g} and {high:g} enclose nothing", mend="give them from 0 to 100, rising")
    if not values.size:
        return 0.0, 255.0
    first, last = np.percentile(values, (low, high))
    return float(first), float(last)


def linear(low: float, high: float, gamma: float = 1.0) -> Curve:
    """255 · ((v - low) / (high - low))^(1 / gamma): gamma above 1 brightens the middle.

    With gamma 1 the curve is exact; others are drawn through 1025 nodes, closer where the curve is steep at its start.
    """
    if not gamma > 0:
        raise InputError(f"gamma {gamma:g} makes no curve", where="gamma", mend="give a number above 0")
    high = high if high > low else low + 1.0
    share = np.array([0.0, 1.0]) if gamma == 1.0 else np.linspace(0.0, 1.0, 1025) ** max(1.0, gamma)
    return Curve(low + share * (high - low), 255.0 * share ** (1.0 / gamma))


def equalised(values: AnyArray) -> Curve:
    """Histogram equalisation: equal numbers of values on equal steps, 255 · (rank - first) / (last - first).

    A value stands at the middle of the ranks that it has, so that equal histograms stay as they are.
    """
    if not values.size:
        return linear(0.0, 255.0)
    known, counts = np.unique(values, return_counts=True)
    middle = np.cumsum(counts) - counts / 2.0
    if len(known) == 1:
        return Curve(np.array([known[0] - 1.0, known[0]]), np.array([127.5, 127.5]))
    levels = 255.0 * (middle - middle[0]) / (middle[-1] - middle[0])
    return Curve(known.astype(np.float64), levels)
