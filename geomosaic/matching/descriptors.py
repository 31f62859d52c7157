"""Matches of features: the nearest descriptors of two images, each the other's nearest, clearly nearer than the next.

Where the geometry of the two images is known, only features near the expected place and its epipolar line are compared
(guided matching), which is faster and finds more, since far fewer descriptors compete.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.kernels.library import native
from geomosaic.matching.features import Features
from geomosaic.types import FloatArray, IntArray

_nearest_descriptors = native("nearest_descriptors", "uudddliifflwlw")

# Lowe's bound for the distance of the nearest descriptor over that of the second.
RATIO = 0.8
# Squared distance of root descriptors (unit 512) above which nothing is alike: an angle of 41 degrees.
FARTHEST = int(2 * 512**2 * (1 - np.cos(np.radians(41.0))))
_NONE = np.iinfo(np.int32).max


@dataclass(frozen=True, eq=False)
class Expected:
    """Where features of one image are expected in another.

    Attributes
    ----------
    colrow : array (N, 2)
        Places; NaN where none is.
    lines : array (N, 3)
        Epipolar lines a·col + b·row + c = 0 with a² + b² = 1.
    reach, band : float
        Pixels from the place, and from the line, within which a feature may lie.
    """

    colrow: FloatArray
    lines: FloatArray
    reach: float
    band: float


def match_descriptors(first: Features, second: Features, expected: Expected | None = None) -> IntArray:
    """Matches of the features of two images.

    Parameters
    ----------
    first, second : Features
    expected : Expected, optional
        Where those of the first are expected in the second; anywhere without it.

    Returns
    -------
    int array (M, 2)
        Indices into both, one to one.
    """
    if not len(first) or not len(second):
        return np.zeros((0, 2), dtype=np.int64)
    if expected is None:
        span = float(np.ptp(second.colrow, axis=0).max()) + 1.0
        middle = second.colrow.mean(axis=0)
        expected = Expected(np.tile(middle, (len(first), 1)), np.zeros((len(first), 3)), 2.0 * span, np.inf)
    reach = expected.reach
    low = second.colrow.min(axis=0)
    cells = np.floor((second.colrow - low) / reach).astype(np.int64)
    cols, rows = (cells.max(axis=0) + 1).tolist()
    number = cells[:, 1] * cols + cells[:, 0]
    order = np.argsort(number, kind="stable")
    start = np.searchsorted(number[order], np.arange(cols * rows + 1))
    # Lines move with the origin of the cells.
    lines = expected.lines.astype(np.float64)
    lines[:, 2] += lines[:, :2] @ low
    one, other = len(first), len(second)
    to_second, to_first = np.full(one, -1, dtype=np.int64), np.full(other, -1, dtype=np.int64)
    near, back = np.full((2, one), _NONE, dtype=np.int32), np.full((2, other), _NONE, dtype=np.int32)
    _nearest_descriptors(
        np.ascontiguousarray(first.descriptors), np.ascontiguousarray(second.descriptors[order]),
        expected.colrow - low, lines, np.ascontiguousarray(second.colrow[order] - low), start, cols, rows, reach,
        expected.band, to_second, near, to_first, back,
    )  # fmt: skip
    found = np.flatnonzero((near[0] < FARTHEST) & (near[0] < RATIO**2 * near[1].astype(np.float64)))
    partner = to_second[found]
    mutual = (to_first[partner] == found) & (back[0, partner] < RATIO**2 * back[1, partner].astype(np.float64))
    return np.stack([found[mutual], order[partner[mutual]]], axis=1)
