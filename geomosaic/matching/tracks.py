"""Tracks: matches of pairs of images joined to points that many images show, each image once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from geomosaic.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class PairMatches:
    """Matches of two images.

    Attributes
    ----------
    first, second : int
        Numbers of the images.
    places : int array (M, 2)
        Numbers of places in the first and in the second.
    cost : array (M,)
        The less, the surer.
    """

    first: int
    second: int
    places: IntArray
    cost: FloatArray


@dataclass(frozen=True, eq=False)
class Tracks:
    """Points and the places that show them, N in all, point by point.

    Attributes
    ----------
    point, image, place : int array (N,)
        Number of the point, of the image, and of the place in it.
    """

    point: IntArray
    image: IntArray
    place: IntArray

    def __len__(self) -> int:
        return len(self.point)

    @property
    def rays(self) -> IntArray:
        """Number of images that show each point."""
        return np.bincount(self.point)

    def pairs(self, images: int) -> IntArray:
        """Pairs of images (P, 3) with points in common: two numbers of images, ascending, and the number of points.

        Parameters
        ----------
        images : int
        """
        shown = sparse.csr_array(
            (np.ones(len(self), dtype=np.int64), (self.image, self.point)),
            shape=(images, int(self.point.max(initial=-1)) + 1),
        )
        common = sparse.triu(shown @ shown.T, 1).tocoo()
        order = np.lexsort((common.col, common.row))
        return np.stack([common.row, common.col, common.data], axis=1)[order].astype(np.int64)

    def select(self, rows: BoolArray | IntArray) -> Tracks:
        """Some of them, points numbered anew; those of fewer than two rays are dropped."""
        point, image, place = self.point[rows], self.image[rows], self.place[rows]
        enough = np.bincount(point, minlength=1)[point] > 1 if len(point) else np.zeros(0, dtype=bool)
        _, number = np.unique(point[enough], return_inverse=True)
        return Tracks(number.ravel().astype(np.int64), image[enough], place[enough])


def join(pairs: Sequence[PairMatches], places: Sequence[int]) -> Tracks:
    """Tracks of matches.

    Where matches would join two places of one image, one of them is wrong: they are taken in order of their costs then,
    each unless it would bring two places of one image together.

    Parameters
    ----------
    pairs : sequence of PairMatches
    places : sequence of int
        Number of places of each image.
    """
    offset = np.concatenate([[0], np.cumsum(places)]).astype(np.int64)
    total = int(offset[-1])
    image_of = np.repeat(np.arange(len(places)), places)
    if not pairs:
        return Tracks(*(np.zeros(0, dtype=np.int64) for _ in range(3)))
    ends = np.concatenate([pair.places + np.array([offset[pair.first], offset[pair.second]]) for pair in pairs]).astype(
        np.int64
    )
    costs = np.concatenate([pair.cost for pair in pairs])
    graph = sparse.coo_array((np.ones(len(ends)), (ends[:, 0], ends[:, 1])), shape=(total, total))
    _, label = connected_components(graph, directed=False)
    # Places of one component and one image, more than one: a contradiction.
    key = label.astype(np.int64) * len(places) + image_of
    order = np.argsort(key, kind="stable")
    twice = np.flatnonzero(np.diff(key[order]) == 0)
    torn = np.zeros(int(label.max()) + 1, dtype=bool)
    torn[label[order[twice]]] = True
    among = np.flatnonzero(torn[label[ends[:, 0]]])
    if len(among):
        label = label.astype(np.int64)
        label[torn[label]] = -1
        _split(ends[among][np.argsort(costs[among], kind="stable")], image_of, label)
    members = np.flatnonzero(label >= 0)
    count = np.bincount(label[members])
    members = members[count[label[members]] > 1]
    members = members[np.lexsort((image_of[members], label[members]))]
    _, point = np.unique(label[members], return_inverse=True)
    image = image_of[members]
    return Tracks(point.ravel().astype(np.int64), image.astype(np.int64), members - offset[image])


def _split(ends: IntArray, image_of: IntArray, label: IntArray) -> None:
    """Labels of places whose matches contradict each other, surest matches first."""
    group: dict[int, list[int]] = {}
    for one, other in ends.tolist():
        mine, theirs = group.setdefault(one, [one]), group.setdefault(other, [other])
        if mine is theirs:
            continue
        if {int(image_of[k]) for k in mine} & {int(image_of[k]) for k in theirs}:
            continue
        mine.extend(theirs)
        for k in theirs:
            group[k] = mine
    number = int(label.max()) + 1
    for place in sorted(group):
        if label[place] < 0:
            label[group[place]] = number
            number += 1


def even_selection(tracks: Tracks, place: FloatArray, most: int) -> BoolArray:
    """Points that tie images evenly: in each cell of each image the first with the most rays.

    Parameters
    ----------
    tracks : Tracks
    place : array (N, 2)
        Places in the images, in sides of a cell.
    most : int
        Points that a cell asks for.

    Returns
    -------
    bool array (S,)
        Points that some cell asks for.
    """
    rays = tracks.rays
    chosen = np.zeros(len(rays), dtype=bool)
    if not len(tracks):
        return chosen
    cells = np.floor(place).astype(np.int64)
    wide = int(cells.max()) + 1
    key = (tracks.image * wide + cells[:, 1]) * wide + cells[:, 0]
    # Points with the most rays first, everywhere alike, so that neighbouring cells choose the same ones.
    order = np.lexsort((tracks.point, -rays[tracks.point], key))
    starts = np.flatnonzero(np.diff(key[order], prepend=-1))
    rank = np.arange(len(order)) - np.repeat(starts, np.diff(np.append(starts, len(order))))
    chosen[tracks.point[order[rank < most]]] = True
    return chosen
