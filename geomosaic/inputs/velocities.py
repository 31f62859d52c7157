"""Velocities of a camera from the times and positions of its photos: where the motion of a rolling shutter starts."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime

import numpy as np

from geomosaic.inputs.tables import Row

# Ratio of the times to both neighbours above which the longer one is a turn between strips, and the longest, seconds.
EVEN, LONGEST = 1.5, 120.0


def time_of(row: Row) -> float | None:
    """Time of a row's photo in seconds, of its column `time`: a number, or a date and time; None without one.

    Parameters
    ----------
    row : Row
    """
    text = row.values.get("time", "").strip()
    try:
        value = float(text)
        return value if math.isfinite(value) else None
    except ValueError:
        pass
    try:
        return datetime.fromisoformat(text).timestamp()
    except ValueError:
        return None


def velocities(photos: Mapping[str, tuple[float | None, Sequence[float]]]) -> dict[str, tuple[float, float, float]]:
    """Velocity of each photo, from those before and after it.

    Parameters
    ----------
    photos : mapping
        Time in seconds and position (x, y, z) by name.

    Returns
    -------
    dict of str to tuple of float
        Units of the positions per second; photos without time or neighbour are not in it.
    """
    known = sorted((time, name) for name, (time, _) in photos.items() if time is not None)
    times = np.array([time for time, _ in known])
    places = np.array([photos[name][1] for _, name in known], dtype=np.float64).reshape(-1, 3)
    gaps = np.diff(times)
    usable = np.where((gaps > 0.0) & (gaps < LONGEST), gaps, np.inf)
    found = {}
    for index, (_, name) in enumerate(known):
        before = usable[index - 1] if index > 0 else np.inf
        after = usable[index] if index < len(usable) else np.inf
        nearer = min(before, after)
        if not np.isfinite(nearer):
            continue
        # The turn between two strips says nothing of how fast either was flown.
        first = index - int(before <= EVEN * nearer)
        last = index + int(after <= EVEN * nearer)
        x, y, z = ((places[last] - places[first]) / (times[last] - times[first])).tolist()
        found[name] = (x, y, z)
    return found
