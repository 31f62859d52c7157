"""Corrections at points spread over the image, fading smoothly with the distance from them."""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np

from geomosaic.adjust.edges.layers import finest, laid_down
from geomosaic.errors import GeomosaicWarning, SolveError
from geomosaic.sensor.correction_grid import CorrectionGrid
from geomosaic.types import FloatArray

NODES = (60_000, 240_000)
"""Nodes of a grid at most: the second where points are too close for the first."""
TOGETHER = (0.25, 0.5, 1.0, 2.0)
"""Where points contradict each other, those closer than so many node spacings are met in their mean."""
EXACT = 0.02
"""Pixels within which a point counts as met."""


def spread(points: FloatArray, corrections: FloatArray, reach: float, names: tuple[str, ...]) -> CorrectionGrid:
    """Make a correction grid that meets given corrections at points.

    Parameters
    ----------
    points : array (K, 2)
        Ideal image positions, pixels.
    corrections : array (K, 2)
        d_col, d_row there, pixels.
    reach : float
        Distance in pixels from a point at which its correction has faded away; a few times the distance between
        neighbouring points, so that it does not sag between them.
    names : tuple of str (K,)
        Of the points, for messages.

    Returns
    -------
    CorrectionGrid
        Bicubic, zero beyond, within 0.001 pixel of the corrections at the points.

    Warns
    -----
    GeomosaicWarning
        Points stand so close together, and their corrections differ so much, that a smooth grid can only meet their
        mean; it says how many and names the worst pair.

    Raises
    ------
    SolveError
        That does not help either.
    """
    each = _Wanted(points, corrections, names)
    spacing = finest(points, reach, NODES[-1])
    for most_nodes, within in (
        (NODES[0], 1e-3),
        (NODES[1], 1e-3),
        *((NODES[1], share * spacing) for share in TOGETHER),
    ):
        wanted = each.together(within)
        grid = laid_down(wanted.places, wanted.values, reach, most_nodes)
        if grid is not None:
            missed = np.abs(grid.at(points) - corrections).max(axis=1) > EXACT
            if missed.any():
                first, second = each.steepest_pair()
                warnings.warn(
                    f"{int(missed.sum())} of {len(points)} points lie so close to others, and contradict them so much, "
                    f"that the join meets only their mean: first of all '{first}' and '{second}'. Look for wrong "
                    "measurements; a place measured under two ids should have one",
                    GeomosaicWarning,
                    stacklevel=2,
                )
            return grid
    first, second = each.steepest_pair()
    raise SolveError(
        f"the misfits at points '{first}' and '{second}' differ so much for their distance that no smooth correction "
        "meets both",
        mend="look for a wrong measurement; a place that is measured under two ids gets one; else leave one out",
    )


@dataclass(frozen=True)
class _Wanted:
    """Points with their corrections."""

    places: FloatArray
    values: FloatArray
    names: tuple[str, ...]

    def together(self, within: float) -> _Wanted:
        """Put the means in place of points that stand closer than some pixels."""
        from scipy.spatial import cKDTree

        group = np.arange(len(self.places))
        for first, second in sorted(cKDTree(self.places).query_pairs(within)):
            if group[first] == first and group[second] == second:  # a group is what is near its first point
                group[second] = first
            elif group[second] == second:
                group[second] = group[first]
        _, which, count = np.unique(group, return_inverse=True, return_counts=True)
        if len(count) == len(group):
            return self
        mean = np.zeros((len(count), 4))
        np.add.at(mean, which, np.hstack([self.places, self.values]))
        mean /= count[:, None]
        return _Wanted(mean[:, :2], mean[:, 2:], ())

    def steepest_pair(self) -> tuple[str, str]:
        """Names of the neighbours whose corrections differ most for their distance."""
        from scipy.spatial import cKDTree

        if len(self.places) < 2:
            return self.names[0], self.names[0]
        distance, other = cKDTree(self.places).query(self.places, k=min(6, len(self.places)))
        differ = np.linalg.norm(self.values[other] - self.values[:, None], axis=2)
        slope = np.where(other == np.arange(len(other))[:, None], 0.0, differ / np.maximum(distance, 1e-6))
        first, k = np.unravel_index(int(np.argmax(slope)), slope.shape)
        return self.names[first], self.names[other[first, k]]
