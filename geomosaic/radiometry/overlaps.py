"""Overlaps of a block: samples of the same ground in pairs of images, and the graph of images that they join."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from geomosaic.estimation.statistics import MAD_TO_SIGMA
from geomosaic.geo.grid import Window
from geomosaic.radiometry.registration import (
    UNDECIDED,
    WHOLE_CORRELATION,
    Registration,
    registered_part,
    registration,
)
from geomosaic.types import AnyArray, BoolArray, ByteArray, FloatArray, IntArray

# Cells of the smallest overlap that is used.
MIN_CELLS = 25
# Cells kept of an overlap: the sampling error of a ratio of gains is then (1 − ρ²)^½ · 4.5 %.
MAX_CELLS = 500


@dataclass(frozen=True)
class Overlap:
    """Samples of the same ground in two images.

    Attributes
    ----------
    first, second : int
        Numbers of the images.
    a, b : array (N, bands)
        Values in the first and in the second.
    cells : int array (N, 2), optional
        Column and row of each sample in the coarse grid that all images share.
    registration : Registration
        Of the two views of the whole overlap. Where only a part of them shows the same ground, samples are of that.
    """

    first: int
    second: int
    a: AnyArray
    b: AnyArray
    cells: AnyArray | None = None
    registration: Registration = UNDECIDED


@dataclass(frozen=True)
class Thumbnail:
    """Image on the coarse grid that all share.

    Attributes
    ----------
    window : Window
        Of the coarse grid.
    values : float32 array (rows, cols, bands)
    valid : uint8 array (rows, cols)
    """

    window: Window
    values: AnyArray
    valid: ByteArray


class Overlaps:
    """Overlaps of thumbnails that arrive one by one, in any order.

    Parameters
    ----------
    windows : sequence of Window
        Of all thumbnails to come.
    clipped : (float, float), optional
        Ends of the range of values; cells at them are left out.
    """

    def __init__(self, windows: Sequence[Window], clipped: tuple[float, float] | None = None) -> None:
        self._low = np.array([(w.col, w.row) for w in windows]).reshape(-1, 2)
        self._high = np.array([(w.stop_col, w.stop_row) for w in windows]).reshape(-1, 2)
        self._clipped = clipped
        self._kept: dict[int, Thumbnail] = {}
        self._came = np.zeros(len(windows), dtype=bool)
        self._missing = np.zeros(len(windows), dtype=np.int64)
        self._found: list[Overlap] = []
        # By a spatial index: all pairs of a country's photos are too many.
        self._partners = partners_of(self._low, self._high)

    @property
    def kept(self) -> int:
        """Number of thumbnails that wait for a partner."""
        return len(self._kept)

    @property
    def found(self) -> list[Overlap]:
        """All overlaps so far, by their numbers."""
        return sorted(self._found, key=lambda pair: (pair.first, pair.second))

    def add(self, index: int, piece: Thumbnail) -> None:
        """Overlaps of a thumbnail with those that came before."""
        partners = self._partners[index]
        self._came[index] = True
        self._kept[index] = piece
        # Counted down as partners come; at 0 the thumbnail is dropped, so that memory is that of a few strips.
        self._missing[index] = np.count_nonzero(~self._came[partners])
        for other in partners[self._came[partners]].tolist():
            first, second = min(index, other), max(index, other)
            pair = overlap_of(first, second, self._kept[first], self._kept[second], self._clipped)
            if pair is not None:
                self._found.append(pair)
            self._missing[other] -= 1
            if not self._missing[other]:
                del self._kept[other]
        if not self._missing[index]:
            del self._kept[index]


def partners_of_pieces(pieces: Sequence[Thumbnail]) -> list[IntArray]:
    """Thumbnails that share cells with each of some, by number, rising.

    Parameters
    ----------
    pieces : sequence of Thumbnail
    """
    corners = [(w.col, w.row, w.stop_col, w.stop_row) for w in (piece.window for piece in pieces)]
    ends = np.array(corners, dtype=np.int64).reshape(-1, 4)
    return partners_of(ends[:, :2], ends[:, 2:])


def partners_of(low: IntArray, high: IntArray) -> list[IntArray]:
    """Windows that share cells with each of some windows.

    Parameters
    ----------
    low, high : int array (N, 2)
        First column and row of each window, and those after its last.

    Returns
    -------
    list of int array
        Numbers of the others, rising.
    """
    import shapely

    boxes = shapely.box(*low.T.astype(np.float64), *high.T.astype(np.float64))
    one, other = shapely.STRtree(boxes).query(boxes)
    common = np.minimum(high[one], high[other]) - np.maximum(low[one], low[other])
    shared = (common > 0).all(axis=1) & (one != other)
    one, other = one[shared], other[shared]
    order = np.lexsort((other, one))
    ends = np.cumsum(np.bincount(one, minlength=len(low)))
    return np.split(other[order], ends[:-1]) if len(low) else []


def overlap_of(
    first: int, second: int, one: Thumbnail, other: Thumbnail, clipped: tuple[float, float] | None = None
) -> Overlap | None:
    """Samples of the cells that are valid in both thumbnails, at most `MAX_CELLS`.

    Parameters
    ----------
    first, second : int
        Numbers of the images.
    one, other : Thumbnail
    clipped : (float, float), optional
        Ends of the range of values; cells at them are left out.

    Returns
    -------
    Overlap or None
        None where fewer than `MIN_CELLS` cells are left.
    """
    common = one.window.intersection(other.window)
    if common.empty:
        return None
    views, seen = [], np.ones((common.height, common.width), dtype=bool)
    for piece in (one, other):
        here = common.slices_in(piece.window)
        values = piece.values[here]
        seen &= piece.valid[here] > 0
        if clipped is not None:
            # A clipped value looks like ground of that value and cannot be told from it afterwards.
            seen &= (values > clipped[0] + 0.5).all(axis=2) & (values < clipped[1] - 0.5).all(axis=2)
        views.append(values)
    rows, cols = np.nonzero(seen)
    if len(rows) < MIN_CELLS:
        return None
    registered = registration(views[0], views[1], seen)
    if registered.correlation < WHOLE_CORRELATION:
        part = registered_part(views[0], views[1], seen)
        if part.any():
            registered = replace(registered, share=float(part.sum() / len(rows)))
            rows, cols = np.nonzero(part)
    chosen = golden_ratio_sample(len(rows))
    rows, cols = rows[chosen], cols[chosen]
    a, b = (values[rows, cols] for values in views)
    return Overlap(first, second, a, b, np.stack([cols + common.col, rows + common.row], axis=1), registered)


def golden_ratio_sample(count: int) -> AnyArray:
    """Indices (N,) of at most `MAX_CELLS` of `count` items, rising, evenly spread without a period.

    Parameters
    ----------
    count : int
    """
    if count <= MAX_CELLS:
        return np.arange(count)
    # A plain stride could be in phase with the columns, and sample one side of each image only. Multiples of the golden
    # ratio modulo 1 are as even, and in phase with nothing.
    return np.unique((np.arange(MAX_CELLS) * ((5**0.5 - 1) / 2) % 1.0 * count).astype(np.int64))


# Samples of all overlaps together: shared fields need no more, and time stays bounded.
MAX_SAMPLES = 40_000
# Image and cells (N, 2) of the coarse grid → positions in the image and on the ground, each (N, 2); see `bases`.
SamplePositions = Callable[[int, AnyArray], tuple[FloatArray, FloatArray]]


@dataclass(frozen=True)
class PairedSamples:
    """Samples of the same ground in pairs of images; P pairs of at most K samples, the rest is padding.

    Attributes
    ----------
    first, second : int array (P,)
        Numbers of the images.
    a, b : array (P, K, bands)
        Values, finite.
    known : bool array (P, K)
        False for padding.
    image_a, view_a, image_b, view_b : array (P, K, 2)
        Positions in each image and on the ground, see `bases`.
    """

    first: IntArray
    second: IntArray
    a: FloatArray
    b: FloatArray
    known: BoolArray
    image_a: FloatArray
    view_a: FloatArray
    image_b: FloatArray
    view_b: FloatArray

    def only(self, known: BoolArray) -> PairedSamples:
        """Subset of the samples."""
        return replace(self, known=self.known & known)

    def halves(self) -> tuple[BoolArray, BoolArray]:
        """Two halves of the samples, each in four bands that alternate across every overlap."""
        count = np.maximum(self.known.sum(axis=1), 1)[:, None]
        odd = (np.arange(self.known.shape[1]) * 8 // count) % 2 == 1
        return ~odd & self.known, odd & self.known


def paired_samples(
    overlaps: Sequence[Overlap], places: SamplePositions, most: int = MAX_SAMPLES
) -> PairedSamples | None:
    """Samples of all overlaps with their positions.

    Parameters
    ----------
    overlaps : sequence of Overlap
    places : SamplePositions
    most : int
        Largest number of samples of all overlaps together.

    Returns
    -------
    PairedSamples or None
        None where no overlap has positions.
    """
    used = [pair for pair in overlaps if len(pair.a) and pair.cells is not None]
    if not used:
        return None
    # Of an overlap that has more than its part of `most` samples, every second, third ... is used.
    each = max(MIN_CELLS, most // len(used))
    chosen = [np.arange(0, len(pair.a), -(-len(pair.a) // each)) for pair in used]
    shape, bands = (len(used), max(len(own) for own in chosen)), used[0].a.shape[1]
    # Padding is 1: its logarithms exist, and `known` keeps it from counting.
    a, b, known = np.ones((*shape, bands)), np.ones((*shape, bands)), np.zeros(shape, dtype=bool)
    place = np.zeros((4, *shape, 2))
    of_image: dict[int, list[tuple[int, int]]] = {}
    for p, (pair, own) in enumerate(zip(used, chosen, strict=True)):
        a[p, : len(own)], b[p, : len(own)], known[p, : len(own)] = pair.a[own], pair.b[own], True
        of_image.setdefault(pair.first, []).append((p, 0))
        of_image.setdefault(pair.second, []).append((p, 2))
    # Once per image, not per overlap: what positions cost is opening the image and its model, not the points.
    for image, where in of_image.items():
        cells = np.concatenate([_cells(used[p], chosen[p]) for p, _ in where])
        found = places(image, cells)
        at = 0
        for p, side in where:
            count = len(chosen[p])
            for k in range(2):
                place[side + k, p, :count] = found[k][at : at + count]
            at += count
    known &= np.isfinite(place).all(axis=(0, 3)) & np.isfinite(a).all(axis=2) & np.isfinite(b).all(axis=2)
    place = np.where(known[None, :, :, None], place, 0.0)
    a, b = (np.where(known[..., None], values, 1.0) for values in (a, b))
    first, second = np.array([(pair.first, pair.second) for pair in used], dtype=np.int64).T
    return PairedSamples(first, second, a, b, known, place[0], place[1], place[2], place[3])


def _cells(pair: Overlap, chosen: AnyArray) -> AnyArray:
    assert pair.cells is not None  # those without were left out
    return pair.cells[chosen]


# Drift along strips. Overlaps observe differences. A small bias in each, say of light that falls off to one side, adds
# up along a strip: after fifty photos of half a per cent each the last is a quarter off, and no overlap shows it. What
# is known besides is that exposures vary from photo to photo, and a camera does not drift: the mean correction of
# neighbouring images is zero, first of their gains, then of the level of their values. Neighbours are those within as
# few steps from overlap to overlap as bring `NEIGHBOURS` images together; in a smaller block this adds no information.
#
# The weight depends on how much exposures vary, s, the spread of single corrections about the mean of their neighbours
# (as a logarithm): a mean of eleven that vary by a fifth is known less well than one of a camera of fixed exposure.
#
# The drift is then a quantity x along the strip with x'' = x / L², L = `SIGMA_RATIO`·s / (standard deviation of the
# step from one photo to the next, 0.003 at best). A bias b of each step makes a drift of no more than b·L, however long
# the strip: 8 b for exposures that vary by a tenth, besides what their means vary by themselves; b for constant ones.
# Images whose mean correction is observed as 0.
NEIGHBOURS = 11
# Standard deviation of that mean over the spread of single corrections; the mean of eleven has about this.
SIGMA_RATIO = 0.25
# Limits of the estimated spread of single corrections.
MIN_SPREAD, MAX_SPREAD = 0.01, 0.3
# Neighbours added at one step between overlaps; of more, every second, third ...
MAX_PER_STEP = 40
# Smallest standard deviation of an observation of one overlap, as a logarithm of a gain or in mean grey values: models
# leave out relief and view angle, whose errors more samples do not reduce.
MIN_SIGMA = 0.003


def neighbourhoods(images: int, first: IntArray, second: IntArray) -> list[IntArray]:
    """Neighbourhoods of the images that have more of their group beyond; none in small groups.

    Parameters
    ----------
    images : int
    first, second : int array (overlaps,)
        Numbers of the overlapping images.

    Returns
    -------
    list of int array
        Numbers of the images, sorted.
    """
    partners: list[set[int]] = [set() for _ in range(images)]
    for i, j in zip(first.tolist(), second.tolist(), strict=True):
        partners[i].add(j)
        partners[j].add(i)
    found = []
    for start in range(images):
        near, edge = {start}, {start}
        while edge and len(near) < NEIGHBOURS:
            ring = sorted(set().union(*(partners[i] for i in edge)) - near)
            edge = set(ring[:: -(-len(ring) // MAX_PER_STEP)]) if ring else set()
            near |= edge
        # The mean of a whole group is settled by the prior already: a neighbourhood must have others beyond it.
        if len(near) > 1 and set().union(*(partners[i] for i in near)) - near:
            found.append(np.array(sorted(near)))
    return found


def mean_sigma(near: list[IntArray], level: FloatArray) -> float:
    """Standard deviation with which the mean correction of a neighbourhood is observed.

    Parameters
    ----------
    near : list of int array (N,)
        Neighbourhoods, at least one.
    level : array (images,)
        Corrections solved without these observations, as logarithms of gains.
    """
    departures = np.concatenate([level[group] - level[group].mean() for group in near])
    # Median absolute deviation: single photos of another exposure are no spread.
    spread = MAD_TO_SIGMA * float(np.median(np.abs(departures)))
    return SIGMA_RATIO * min(max(spread, MIN_SPREAD), MAX_SPREAD)


def normal_entries(near: list[IntArray], weight: float) -> tuple[IntArray, IntArray, FloatArray]:
    """Entries that observed means of 0 add to a normal matrix.

    Parameters
    ----------
    near : list of int array (N,)
        Neighbourhoods: numbers of the images.
    weight : float
        Inverse variance of the mean of one neighbourhood.

    Returns
    -------
    rows, cols : int array (entries,)
        Numbers of the images; pairs repeat, and their values are to be added.
    values : array (entries,)
    """
    if not near:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64), np.zeros(0)
    rows = np.concatenate([np.repeat(group, len(group)) for group in near])
    cols = np.concatenate([np.tile(group, len(group)) for group in near])
    values = np.concatenate(
        [np.full(len(group) ** 2, _observation_weight(group, weight) / len(group)) for group in near]
    )
    return rows, cols, values


def right_hand_side(near: list[IntArray], target: FloatArray, weight: float) -> FloatArray:
    """Right-hand side of observed means that are not 0.

    Parameters
    ----------
    near : list of int array (N,)
        Neighbourhoods, as in `normal_entries`.
    target : array (images,)
        The mean of x over each neighbourhood is observed to be that of `target`.
    weight : float
        Inverse variance, as in `normal_entries`.

    Returns
    -------
    array (images,)
    """
    right = np.zeros(len(target))
    for group in near:
        right[group] += _observation_weight(group, weight) * target[group].mean()
    return right


def _observation_weight(group: IntArray, weight: float) -> float:
    """Weight for one image of a neighbourhood."""
    # Large neighbourhoods overlap each other more, so they repeat an observation, and drift less.
    return weight / len(group) * min(1.0, NEIGHBOURS / len(group)) ** 3


def connected_groups(images: int, first: IntArray, second: IntArray) -> IntArray:
    """Connected components of the graph of overlaps.

    Parameters
    ----------
    images : int
    first, second : int array (overlaps,)
        Numbers of the overlapping images.

    Returns
    -------
    int array (images,)
        Number of each image's group, from 0.
    """
    group = np.arange(images)
    while True:
        # Each image takes the smallest number among its partners', then that of the image it now points to: pointer
        # doubling, so that a strip of n images needs about log n rounds instead of n.
        least = group.copy()
        np.minimum.at(least, first, group[second])
        np.minimum.at(least, second, group[first])
        least = least[least]
        if np.array_equal(least, group):
            return np.asarray(np.unique(group, return_inverse=True)[1])
        group = least
