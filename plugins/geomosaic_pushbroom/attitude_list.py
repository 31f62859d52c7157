"""Lists of attitudes over time as SPOT's metadata have them: in order, in radians, over the whole scene."""

from __future__ import annotations

import numpy as np

from geomosaic.errors import InputError
from geomosaic.types import FloatArray

_STEEPEST = 0.2  # radians, and radians per second


def in_order(times: FloatArray, values: FloatArray, what: str, where: str) -> tuple[FloatArray, FloatArray]:
    """Times (K,) and pitch, roll, yaw (K, 3), or their speeds, in the order of time.

    Raises
    ------
    InputError
        There is none, two have one time, or they are no radians; names the list.
    """
    order = np.argsort(times, kind="stable")
    times, values = times[order], values[order]
    if not len(times) or not (np.diff(times) > 0.0).all():
        raise InputError(f"{what} is empty, or has two values of one time", where=where, mend="get the file again")
    if not np.abs(values).max() <= _STEEPEST:
        raise InputError(
            f"{what} reaches {np.abs(values).max():g}: these are no radians", where=where, mend="get the file again"
        )
    return times, values


def need_cover(times: FloatArray, rows: int, middle: float, period: float, where: str) -> None:
    """Refuse a line period that is none, and attitudes that do not reach over the scene, up to a tenth of it.

    Parameters
    ----------
    times : array (K,)
        Of the attitudes, seconds from the row `middle`.
    rows : int
        Of the scene.
    middle : float
    period : float
        Seconds per row.
    """
    if not 0.0 < period < 1.0:
        raise InputError(f"the line period is {period:g} s", where=where, mend="get the file again")
    first, last = -middle * period, (rows - middle) * period
    lost = max(times[0] - first, last - times[-1])
    if lost > 0.1 * (last - first):
        raise InputError(
            f"the attitudes leave {lost:.2f} s of the scene out, which takes {last - first:.2f} s",
            where=where,
            mend="get the whole file: attitudes must cover the scene",
        )
