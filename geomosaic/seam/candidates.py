"""Images that may show a cell: the nearest few by their centres, as long as they see it nearly as well as the first."""

from __future__ import annotations

import numpy as np

from geomosaic.types import AnyArray, FloatArray, IntArray

MOST = 3
"""Images that may share a cell: three meet where seams do."""


def nearest(centres: FloatArray, places: FloatArray, covers: AnyArray, reach: float, most: int = MOST) -> IntArray:
    """Candidates of cells, the nearest first.

    Parameters
    ----------
    centres : array (K, 2)
        Of the images at hand, in map units.
    places : array (N, 2)
        Of the cells.
    covers : bool array (K, N)
        Whether an image shows a cell.
    reach : float
        Part of the way between two centres, to both sides of the middle together, in which a seam may run.
    most : int
        Candidates of a cell.

    Returns
    -------
    int array (most, N)
        Numbers among the images, -1 where there are no more. A cell with one candidate is surely that one's.
    """
    found = np.full((most, len(places)), -1)
    distance = np.hypot(*(places[None] - centres[:, None]).transpose(2, 0, 1))
    distance = np.where(covers, distance, np.inf)
    order, each = np.argsort(distance, axis=0, kind="stable"), np.arange(len(places))
    for rank in range(min(most, len(centres))):
        apart = np.hypot(*(centres[order[0]] - centres[order[rank]]).T)
        with np.errstate(invalid="ignore"):  # where no image is left, all distances are infinite
            far = distance[order[rank], each] - distance[order[0], each]
            allowed = np.isfinite(distance[order[rank], each]) & (far <= reach * apart)
        found[rank] = np.where(allowed, order[rank], -1)
    # The second may be beyond reach where the third is not: no holes in between.
    holes = np.argsort(found < 0, axis=0, kind="stable")
    return np.take_along_axis(found, holes, axis=0)
