"""Places of symbols that are repeated along a line."""

from __future__ import annotations

import numpy as np

from geomosaic.types import FloatArray


def pattern_places(path: FloatArray, interval: float, size: float) -> tuple[FloatArray, FloatArray]:
    """Places and directions of symbols along a line, evenly spaced with half a distance at both ends.

    Parameters
    ----------
    path : array (N, 2)
        Vertices in mm on the page.
    interval : float
        Distance of symbols in mm; the one taken divides the line evenly.
    size : float
        Of a symbol in mm: its direction is that of the chord below it.

    Returns
    -------
    xy : array (K, 2)
        Middles; none on a line of less than half the distance.
    angles : array (K,)
        Degrees, anticlockwise from the x axis.
    """
    at = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))])
    count = int(np.floor(at[-1] / interval + 0.5))
    middles = (np.arange(count) + 0.5) * (at[-1] / max(count, 1))

    def places(distances: FloatArray) -> FloatArray:
        inside = np.clip(distances, 0.0, at[-1])
        return np.column_stack([np.interp(inside, at, path[:, k]) for k in (0, 1)])

    chord = places(middles + size / 2) - places(middles - size / 2)
    return places(middles), np.degrees(np.arctan2(chord[:, 1], chord[:, 0]))
