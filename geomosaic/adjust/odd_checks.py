"""Check points that are wrong themselves: those far from where most of the others have the map."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.adjust.fit import total_rms
from geomosaic.types import BoolArray, FloatArray

TIMES = 6.0
"""Median distances from the median error, from which on a point is wrong; of few points more, by 1 + 12 / N²."""
SEEN, FEW_SEEN = 1.5, 5.0
"""Pixels below which nothing is named, and those of fewer than four points, which tell little."""
MOST = 0.4
"""Share of the points, beyond which it is the map that is wrong, not they."""


@dataclass(frozen=True, eq=False)
class OddChecks:
    """Which check points contradict the others.

    Attributes
    ----------
    odd : bool array (N,)
    centre : array (2,)
        Median error of all, pixels: of what is systematic in the map.
    rms : float
        RMS length of the errors of the others, pixels.
    """

    odd: BoolArray
    centre: FloatArray
    rms: float


def odd_checks(errors: FloatArray, expected: float = 0.0) -> OddChecks:
    """Find check points whose errors are far from the median error.

    A shift of the whole map moves the median and makes none of them odd. With normal errors in both axes a good point
    is named in less than one of 200 sets of four points or more.

    Parameters
    ----------
    errors : array (N, 2)
        Pixels.
    expected : float
        RMS length of the errors to be expected of the map, pixels, where the fit tells (leave-one-out); with it fewer
        than three points can be judged, too.
    """
    count = len(errors)
    centre: FloatArray = np.median(errors, axis=0) if count >= 3 else np.zeros(2)
    apart = np.hypot(*(errors - centre).T)
    if count >= 3:
        limit = TIMES * (1.0 + 12.0 / count**2) * max(float(np.median(apart)), expected)
        odd = apart > max(limit, SEEN if count > 3 else FEW_SEEN)
    else:
        odd = (apart > max(TIMES * expected, FEW_SEEN)) & (expected > 0.0)
    if count >= 3 and odd.mean() > MOST:
        odd = np.zeros(count, dtype=np.bool_)
    return OddChecks(odd, centre, total_rms(errors[~odd]))
