"""Seams that cost least in all: cells joined to regions, regions divided among images by minimal cuts.

Cells are first joined to the catchment basins of the cost, so that borders of regions are the valleys between what must
not be cut (Soille, 2006): round houses, along roads. Then, for two images at a time, the regions that both may show are
divided anew by a minimal cut (Boykov, Veksler and Zabih, 2001, the swap move), until nothing becomes cheaper. The cost
is that of all cells along the borders, and a little for each cell by how well its image sees it. A swap looks only at
the regions of two neighbours, so the work grows with the number of images.

P. Soille, *Morphological image compositing*, IEEE Transactions on Pattern Analysis and Machine Intelligence 28, 2006.
Y. Boykov, O. Veksler, R. Zabih, *Fast approximate energy minimization via graph cuts*, ibid. 23, 2001.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.types import AnyArray, BoolArray, FloatArray, IntArray

SWEEPS = 4
"""Times that all pairs of neighbours are looked at; two mostly do."""
_MOST_FLOW = 1 << 30
_FINEST = 0.01
# Length of a border from the neighbours it parts, the same in all directions (Boykov and Kolmogorov, 2003).
_STEPS = (((0, 1), np.pi / 8), ((1, 0), np.pi / 8), ((1, 1), np.pi / 8 / np.sqrt(2)), ((1, -1), np.pi / 8 / np.sqrt(2)))


@dataclass(frozen=True)
class Graph:
    """Regions, who may show them, and what borders between them cost.

    Attributes
    ----------
    region : int array (rows, cols)
        Number of each cell's region; -1 where no image shows the cell.
    allowed : int array (regions, ranks)
        Images that may show a region, the nearest first, -1 where there are no more.
    own : array (regions, ranks)
        Cost of its being shown by each.
    first, second : int array (edges,)
        Regions with a common border, first < second.
    weight : array (edges,)
        Its cost.
    """

    region: IntArray
    allowed: IntArray
    own: FloatArray
    first: IntArray
    second: IntArray
    weight: FloatArray

    def first_choice(self, nearest: IntArray) -> IntArray:
        """Of each region (regions,) the image that is nearest (rows, cols) in most of its cells."""
        known = self.region >= 0
        count = np.zeros(self.allowed.shape)
        for place in range(self.allowed.shape[1]):
            hit = self.allowed[self.region[known], place] == nearest[known]
            count[:, place] = np.bincount(self.region[known][hit], minlength=len(count))
        if not len(count):
            return np.zeros(0, dtype=np.int64)
        return np.take_along_axis(self.allowed, count.argmax(axis=1)[:, None], axis=1)[:, 0]


def basins(cost: AnyArray, known: BoolArray) -> IntArray:
    """Catchment basins (rows, cols) of the cost turned over: each has a worst place, borders run where it is low."""
    from scipy.ndimage import gaussian_filter, label, maximum_filter, watershed_ift

    smooth = gaussian_filter(cost.astype(np.float32), 1.0)
    top = maximum_filter(smooth, 3) == smooth
    seeds, _ = label(top & known, structure=np.ones((3, 3)))
    # Logarithms: one very bad place must not make all others equal. Of no other cell: far changes are not felt.
    relief = (65535 - 4000 * np.log2(1 + np.maximum(smooth, 0) / _FINEST)).clip(0, 65535).astype(np.uint16)
    flooded = watershed_ift(relief, np.where(known, seeds, -1).astype(np.int32), structure=np.ones((3, 3), dtype=int))
    return np.where(known, flooded, -1).astype(np.int64)


def graph(candidates: IntArray, own: AnyArray, cost: AnyArray) -> Graph:
    """Join cells to regions.

    Parameters
    ----------
    candidates : int array (ranks, rows, cols)
        Images that may show a cell, the nearest first, -1 where there are no more.
    own : array (ranks, rows, cols)
        Cost of its being shown by each.
    cost : array (rows, cols)
        Of a seam there.
    """
    ranks, known = len(candidates), candidates[0] >= 0
    flat = basins(cost, known)
    # The cells of a region have the same candidates, whatever their order.
    sets = np.sort(candidates.reshape(ranks, -1), axis=0)[:, known.ravel()]
    # Where one image is sure, a region is all that is surely its own: nothing is to be found out there.
    lone = (sets[:-1] < 0).all(axis=0)
    keys = np.vstack([np.where(lone, -1, flat.ravel()[known.ravel()]), sets])
    order = np.lexsort(keys[::-1])
    changed = np.any(np.diff(keys[:, order], axis=1) != 0, axis=0)
    inverse = np.empty(keys.shape[1], dtype=np.int64)
    inverse[order] = np.concatenate([[0], np.cumsum(changed)]) if len(order) else 0
    count = int(inverse.max(initial=-1)) + 1
    region = np.full(known.shape, -1)
    region[known] = inverse
    allowed = np.full((count, ranks), -1)
    allowed[inverse] = sets[::-1].T
    totals = np.zeros((count, ranks))
    for rank in range(ranks):
        image, price = candidates[rank][known], own[rank][known]
        for place in range(ranks):
            hit = (allowed[inverse, place] == image) & (image >= 0)
            totals[:, place] += np.bincount(inverse[hit], price[hit], count)
    return Graph(region, allowed, totals, *_borders(region, cost, count))


def _borders(region: IntArray, cost: AnyArray, count: int) -> tuple[IntArray, IntArray, FloatArray]:
    keys, prices = [], []
    for (down, right), length in _STEPS:
        rows, cols = region.shape
        a = slice(0, rows - down), slice(max(0, -right), cols - max(0, right))
        b = slice(down, rows), slice(max(0, right), cols - max(0, -right))
        one, two = region[a], region[b]
        border = (one != two) & (one >= 0) & (two >= 0)
        low, high = np.minimum(one[border], two[border]), np.maximum(one[border], two[border])
        keys.append(low * np.int64(max(count, 1)) + high)
        prices.append(length * (cost[a][border] + cost[b][border]))
    found, inverse = np.unique(np.concatenate(keys), return_inverse=True)
    weight: FloatArray = np.bincount(inverse, np.concatenate(prices), len(found)).astype(np.float64)
    return found // max(count, 1), found % max(count, 1), weight


def divide(parts: Graph, start: IntArray) -> IntArray:
    """Images (regions,) that show the regions at the least cost, from a first choice (regions,)."""
    chosen, net = start.copy(), _Net.of(parts)
    for _ in range(SWEEPS):
        differ = chosen[parts.first] != chosen[parts.second]
        a, b = chosen[parts.first[differ]], chosen[parts.second[differ]]
        pairs = np.unique(np.column_stack([np.minimum(a, b), np.maximum(a, b)]), axis=0)
        changed = [_swap(parts, net, chosen, int(i), int(j)) for i, j in pairs]
        if not any(changed):
            break
    return chosen


def energy(parts: Graph, chosen: IntArray) -> float:
    """Cost of all borders between different images, and of all regions in theirs."""
    differ = chosen[parts.first] != chosen[parts.second]
    own = np.where(parts.allowed == chosen[:, None], parts.own, 0.0).sum()
    return float(parts.weight[differ].sum() + own)


@dataclass(frozen=True)
class _Net:
    """Edges by region and regions by image, so that a swap looks at nothing but its own."""

    start: IntArray
    edges: IntArray
    shown_by: dict[int, IntArray]

    @classmethod
    def of(cls, parts: Graph) -> _Net:
        ends = np.concatenate([parts.first, parts.second])
        edges = np.tile(np.arange(len(parts.first)), 2)[np.argsort(ends, kind="stable")]
        start = np.concatenate([[0], np.cumsum(np.bincount(ends, minlength=len(parts.allowed)))])
        shared = np.flatnonzero((parts.allowed >= 0).sum(axis=1) > 1)
        images = np.unique(parts.allowed[shared])
        by = {int(i): shared[(parts.allowed[shared] == i).any(axis=1)] for i in images[images >= 0]}
        return cls(start, edges, by)

    def around(self, regions: IntArray) -> IntArray:
        """Edges of some regions, each once."""
        counts = self.start[regions + 1] - self.start[regions]
        offsets = np.repeat(self.start[regions] - np.concatenate([[0], np.cumsum(counts)[:-1]]), counts)
        return np.unique(self.edges[offsets + np.arange(int(counts.sum()))])


def _swap(parts: Graph, net: _Net, chosen: IntArray, i: int, j: int) -> bool:
    """Divide the regions of two images anew by a minimal cut; whether anything changed."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import breadth_first_order, maximum_flow

    none = np.zeros(0, dtype=np.int64)
    both = np.intersect1d(net.shown_by.get(i, none), net.shown_by.get(j, none), assume_unique=True)
    free = both[(chosen[both] == i) | (chosen[both] == j)]
    if not len(free):
        return False
    edges, size = net.around(free), len(free)
    one, two, weight = parts.first[edges], parts.second[edges], parts.weight[edges]
    a, b = _numbers(free, one), _numbers(free, two)
    inner = (a >= 0) & (b >= 0)
    price_i = np.where(parts.allowed[free] == i, parts.own[free], 0).sum(axis=1)
    price_j = np.where(parts.allowed[free] == j, parts.own[free], 0).sum(axis=1)
    to_i, to_j = np.maximum(price_j - price_i, 0), np.maximum(price_i - price_j, 0)
    for mine, label in ((np.where(inner, -1, a), chosen[two]), (np.where(inner, -1, b), chosen[one])):
        for image, to in ((i, to_i), (j, to_j)):
            rim = (mine >= 0) & (label == image)
            to += np.bincount(mine[rim], weight[rim], size)
    source, sink = size, size + 1
    rows = np.concatenate([a[inner], b[inner], np.full(size, source), np.arange(size)])
    cols = np.concatenate([b[inner], a[inner], np.arange(size), np.full(size, sink)])
    price = np.concatenate([weight[inner], weight[inner], to_i, to_j])
    whole = np.round(price * min(1e4, _MOST_FLOW / max(float(price.sum()), 1e-9))).astype(np.int32)
    network = coo_matrix((whole, (rows, cols)), shape=(size + 2, size + 2)).tocsr()
    rest = (network - maximum_flow(network, source, sink).flow).tocsr()
    rest.eliminate_zeros()
    reached = np.zeros(size + 2, dtype=bool)
    reached[breadth_first_order(rest, source, return_predecessors=False)] = True

    def cost(with_i: BoolArray) -> float:
        apart = with_i[a[inner]] != with_i[b[inner]]
        return float(weight[inner][apart].sum() + to_j[with_i].sum() + to_i[~with_i].sum())

    if cost(reached[:size]) >= cost(chosen[free] == i) - 1e-9:
        return False
    chosen[free] = np.where(reached[:size], i, j)
    return True


def _numbers(free: IntArray, regions: IntArray) -> IntArray:
    """Place of regions among the sorted free ones, -1 where they are none of them."""
    place = np.minimum(np.searchsorted(free, regions), len(free) - 1)
    return np.where(free[place] == regions, place, -1)
