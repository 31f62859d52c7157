"""Ends of lines at the edges of neighbouring sheets: which belong together, where they meet, how sheets are bent there.

The vector counterpart of edge matching of photos (Bellman, Deakin, Rollings; Shmutter and Doytsher 1991 for digitised
cadastral maps): an end has one adjusted place for all sheets that show it, the mean weighted by their sigmas, and each
sheet is corrected by what it is off there, less and less with the distance.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from geomosaic.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class LineEnds:
    """Ends of the lines of all sheets.

    Attributes
    ----------
    xy : array (N, 2)
        Map units.
    sheet : int array (N,)
    kind : int array (N,)
        Only ends of one kind can meet.
    outward : array (N, 2)
        Unit vectors of the direction in which the lines end.
    """

    xy: FloatArray
    sheet: IntArray
    kind: IntArray
    outward: FloatArray


def meeting_ends(ends: LineEnds, tolerance: float) -> list[IntArray]:
    """Groups of ends that are one place, at most one of each sheet, the nearest joined first.

    Parameters
    ----------
    ends : LineEnds
    tolerance : float
        Distance between two ends of a group at most, map units.

    Returns
    -------
    list of int array
        Indices of two or more ends; of different sheets, of one kind, of lines that go on and do not turn back.
    """
    from scipy.spatial import cKDTree

    first, second = _candidate_pairs(ends, tolerance)
    order = np.lexsort((second, first, np.hypot(*(ends.xy[first] - ends.xy[second]).T)))
    group = {number: [number] for number in range(len(ends.xy))}
    for a, b in zip(first[order].tolist(), second[order].tolist(), strict=True):
        one, other = group[a], group[b]
        if one is other or {int(ends.sheet[k]) for k in one} & {int(ends.sheet[k]) for k in other}:
            continue
        joined = [*one, *other]
        if (
            len(joined) > 2
            and cKDTree(ends.xy[joined]).sparse_distance_matrix(cKDTree(ends.xy[joined]), 1e300).toarray().max()
            > tolerance
        ):
            continue
        for k in joined:
            group[k] = joined
    found = {id(each): each for each in group.values() if len(each) > 1}
    return [np.array(sorted(each)) for each in found.values()]


def _candidate_pairs(ends: LineEnds, tolerance: float) -> tuple[IntArray, IntArray]:
    """Pairs of ends within the tolerance (map units) that may be one place."""
    from scipy.spatial import cKDTree

    pairs = cKDTree(ends.xy).query_pairs(tolerance, output_type="ndarray") if len(ends.xy) else np.empty((0, 2), int)
    first, second = pairs.T
    fits: BoolArray = (ends.sheet[first] != ends.sheet[second]) & (ends.kind[first] == ends.kind[second])
    fits &= ~turns_back(ends, first, second)
    return first[fits], second[fits]


def turns_back(ends: LineEnds, first: IntArray, second: IntArray) -> BoolArray:
    """Whether the second of two ends would go on by less than 60 degrees from where the first came.

    Parameters
    ----------
    ends : LineEnds
    first, second : int array (P,)
    """
    return np.asarray((ends.outward[first] * ends.outward[second]).sum(axis=-1) >= 0.5)


def adjusted_places(ends: LineEnds, groups: list[IntArray], sigma: FloatArray) -> FloatArray:
    """Adjusted place (G, 2) of each group: the mean weighted by 1 / sigma², that of sheets held at sigma 0 alone.

    Parameters
    ----------
    ends : LineEnds
    groups : list of int array
    sigma : array (S,)
        Standard deviation of each sheet, map units; only their ratios count.
    """
    out = np.empty((len(groups), 2))
    for number, members in enumerate(groups):
        own = sigma[ends.sheet[members]]
        weight = (own == 0.0).astype(np.float64) if (own == 0.0).any() else own**-2.0
        out[number] = (ends.xy[members] * weight[:, None]).sum(axis=0) / weight.sum()
    return out


@dataclass(frozen=True, eq=False)
class Bend:
    """Smooth displacement that is given at some places and zero beyond a distance from all of them.

    A sum of Wendland's functions (1 - r)⁴ (4 r + 1), r the distance in units of the reach: twice differentiable, and
    positive definite, so that the values at the places are met exactly.

    Attributes
    ----------
    places : array (P, 2)
    weights : array (P, 2)
    reach : float
        Map units.
    """

    places: FloatArray
    weights: FloatArray
    reach: float

    @classmethod
    def through(cls, places: FloatArray, displacements: FloatArray, reach: float) -> Bend:
        """Displacement (P, 2) met at places (P, 2)."""
        from scipy.sparse.linalg import splu

        if not len(places):
            return cls(places, displacements, reach)
        return cls(places, splu(_wendland(places, places, reach).tocsc()).solve(displacements), reach)

    def at(self, xy: FloatArray) -> FloatArray:
        """Displacement (N, 2) of places (N, 2)."""
        if not len(self.places):
            return np.zeros((len(xy), 2))
        return np.asarray(_wendland(np.asarray(xy), self.places, self.reach) @ self.weights)


def _wendland(one: FloatArray, other: FloatArray, reach: float) -> Any:
    """Sparse matrix (N, M) of Wendland's function between places."""
    from scipy.sparse import csr_array
    from scipy.spatial import cKDTree

    near = cKDTree(one).sparse_distance_matrix(cKDTree(other), reach, output_type="ndarray")
    r = near["v"] / reach
    values = (1.0 - r) ** 4 * (4.0 * r + 1.0)
    return csr_array((values, (near["i"], near["j"])), shape=(len(one), len(other)))
