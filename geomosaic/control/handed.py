"""Whether the ground looks mirrored in the image, and which exchange of coordinates that looks like."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from geomosaic.control.finding import Advice, plane
from geomosaic.control.points import ImageControl
from geomosaic.types import FloatArray, IntArray

_ALL = 18  # points whose triples are all taken; of more, a fixed random sample
_SAMPLE = 2000
_VOTE = 0.2


def _triples(count: int) -> IntArray:
    if count <= _ALL:
        return np.array(list(combinations(range(count), 3)), dtype=np.int64).reshape(-1, 3)
    random = np.random.default_rng(0)
    return random.integers(count, size=(_SAMPLE, 3), dtype=np.int64)  # one with a point twice has no area


def linear_part(colrow: FloatArray, ground: FloatArray) -> tuple[float, FloatArray]:
    """Return how triples of points vote on being mirrored, and the median of their matrices.

    Parameters
    ----------
    colrow, ground : array (N, 2)

    Returns
    -------
    vote : float
        -1 where all triples run the other way round in the image (rows downwards) than on the ground (y upwards), as
        they should; 1 where all run the same way round: mirrored. Blunders, 30 % of them, leave the sign.
    matrix : array (2, 2)
        Ground over image.
    """
    triples = _triples(len(colrow))
    image = colrow[triples[:, 1:]] - colrow[triples[:, :1]]
    apart = ground[triples[:, 1:]] - ground[triples[:, :1]]
    area = np.linalg.det(image)
    usable = np.abs(area) > 0.1 * np.abs(area).max(initial=1e-9)
    if not usable.any():
        return 0.0, np.zeros((2, 2))
    matrices = np.linalg.solve(image[usable], apart[usable]).transpose(0, 2, 1)
    return float(np.sign(np.linalg.det(matrices)).mean()), np.median(matrices, axis=0)


def is_mirrored(control: ImageControl) -> bool:
    """Say whether ground and image (rows downwards) run the same way round."""
    return len(control) >= 3 and linear_part(control.colrow, plane(control))[0] > _VOTE


def mirrored(control: ImageControl) -> list[Advice]:
    """Find a mirrored image, and say what it most looks like if north is about up, down, left or right.

    Rows or columns that run the wrong way and exchanged axes all mirror an image; they differ by where north is. A
    radar scene or a film scanned from its back is mirrored rightly: where a program wrote the points (control in a
    raster) the finding is a note.
    """
    if len(control) < 3:
        return []
    vote, matrix = linear_part(control.colrow, plane(control))
    if vote <= _VOTE:
        return []
    turn = float(np.degrees(np.arctan2(matrix[1, 0] - matrix[0, 1], matrix[0, 0] + matrix[1, 1])))
    if 45.0 < abs(turn) < 135.0:
        code, mend = swapped(control)
    elif abs(turn) <= 45.0:
        code, mend = "mirrored-rows", "let rows count from the top of the image"
    else:
        code, mend = "mirrored-columns", "let columns count from the left of the image"
    written = all(origin.unit == "GCP" for origin in control.origins)
    what = "the ground is mirrored in the image: it runs the same way round as columns and rows"
    mend = f"{mend}; nothing, where the image is mirrored (radar scene, film scanned from its back)"
    return [Advice(code, "note" if written else "warning", what, (), mend)]


def swapped(control: ImageControl) -> tuple[str, str]:
    """Return code and mend of exchanged ground axes."""
    if control.crs.is_geographic:
        return "latitude-longitude-swapped", "give longitude as x and latitude as y (or exchange col and row)"
    return "swapped-axes", "exchange x and y (or col and row): x is east, y is north"
