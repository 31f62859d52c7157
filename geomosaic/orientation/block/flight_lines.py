"""Flight lines of a block: photos that were taken one after the other in one direction."""

from __future__ import annotations

import numpy as np

from geomosaic.types import FloatArray, IntArray

# Largest turn from one base to the next, degrees, and largest base beside the median of all.
_TURN, _LONGEST = 40.0, 2.5


def flight_lines(places: FloatArray) -> IntArray:
    """Number of the flight line of each photo.

    A line ends where the next base (the vector between two exposures) turns by more than 40 degrees, or is longer than
    2.5 times the median base.

    Parameters
    ----------
    places : array (M, 2)
        Where the photos were taken, in their order, in metres; NaN where it is not known.

    Returns
    -------
    int array (M,)
        From 0; -1 of photos without a place.
    """
    line = np.full(len(places), -1, dtype=np.int64)
    known = np.flatnonzero(np.isfinite(places).all(axis=1))
    if not len(known):
        return line
    bases = np.diff(places[known], axis=0)
    lengths = np.hypot(*bases.T)
    longest = _LONGEST * float(np.median(lengths)) if len(lengths) else 0.0
    line[known[0]], number, before = 0, 0, None
    for index, base, length in zip(known[1:].tolist(), bases, lengths.tolist(), strict=True):
        if length > longest or (before is not None and _turn(before, base) > _TURN):
            # The base that leads from line to line is no part of either.
            number, before = number + 1, None
        else:
            before = base
        line[index] = number
    return line


def _turn(one: FloatArray, other: FloatArray) -> float:
    """Angle between two vectors, degrees."""
    cross = one[0] * other[1] - one[1] * other[0]
    return float(np.degrees(np.abs(np.arctan2(cross, one @ other))))
