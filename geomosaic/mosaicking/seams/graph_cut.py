"""Seams of least cost by graph cuts: cells joined to watershed regions, regions assigned to images by swap moves.

Cells are first joined to the catchment basins of the cost, so that borders of regions are the valleys between what must
not be cut (Soille, 2006): round houses, along roads. Then, for two images at a time, the regions that both may show are
assigned anew by a minimal cut (Boykov, Veksler and Zabih, 2001, the swap move), until nothing becomes cheaper. The cost
is that of all cells along the borders (pairwise), and a little for each cell by how well its image sees it (unary). A
swap looks only at the regions of two neighbours, so the work grows with the number of images.

P. Soille, *Morphological image compositing*, IEEE Transactions on Pattern Analysis and Machine Intelligence 28, 2006.
Y. Boykov, O. Veksler, R. Zabih, *Fast approximate energy minimization via graph cuts*, ibid. 23, 2001.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.types import AnyArray, BoolArray, FloatArray, IntArray

# Rounds over all pairs of neighbouring images; two are mostly enough.
MAX_SWEEPS = 4
# Capacities of scipy's maximum flow are int32; their sum must not overflow.
_MAX_FLOW = 1 << 30
# Costs below this are as good as none; the logarithmic relief of the watershed starts here.
_COST_UNIT = 0.01
# Cells of the largest basin that goes on as its decided cells are: a large house.
_MAX_CONTINUED = 64 * 64
# Length of a border from the neighbours it parts, the same in all directions (Boykov and Kolmogorov, 2003).
_NEIGHBOURS = (
    ((0, 1), np.pi / 8),
    ((1, 0), np.pi / 8),
    ((1, 1), np.pi / 8 / np.sqrt(2)),
    ((1, -1), np.pi / 8 / np.sqrt(2)),
)


@dataclass(frozen=True)
class RegionGraph:
    """Regions of cells, the images that may show them, and the cost of borders between them.

    Attributes
    ----------
    region : int array (rows, cols)
        Number of each cell's region; -1 where no image shows the cell.
    allowed : int array (regions, ranks)
        Images that may show a region, by number, the highest first; -1 where there are no more.
    unary : array (regions, ranks)
        Cost of each of them showing it.
    first, second : int array (edges,)
        Regions with a common border, first < second.
    weight : array (edges,)
        Cost of a seam along that border.
    """

    region: IntArray
    allowed: IntArray
    unary: FloatArray
    first: IntArray
    second: IntArray
    weight: FloatArray

    def initial_labels(self, nearest: IntArray) -> IntArray:
        """Image of each region (regions,) that is the nearest one (rows, cols) of most of its cells."""
        known = self.region >= 0
        count = np.zeros(self.allowed.shape)
        for place in range(self.allowed.shape[1]):
            hit = self.allowed[self.region[known], place] == nearest[known]
            count[:, place] = np.bincount(self.region[known][hit], minlength=len(count))
        if not len(count):
            return np.zeros(0, dtype=np.int64)
        return np.take_along_axis(self.allowed, count.argmax(axis=1)[:, None], axis=1)[:, 0]


def _catchment_basins(cost: AnyArray, known: BoolArray) -> IntArray:
    """Catchment basins of the inverted cost, by number, −1 where no image shows the cell (rows, cols).

    Each holds a local maximum, borders run where the cost is low.
    """
    from scipy.ndimage import gaussian_filter, label, maximum_filter, watershed_ift

    # Smoothed first: noise would make a basin of nearly every cell, and the graph no smaller than the raster.
    smooth = gaussian_filter(cost.astype(np.float32), 1.0)
    top = maximum_filter(smooth, 3) == smooth
    seeds, _ = label(top & known, structure=np.ones((3, 3)))
    # Logarithms: one very bad place must not make all others equal in 16 bits. The scale depends on no other cell, so
    # a change far away leaves basins, and with them seams that were computed before, as they are.
    relief = (65535 - 4000 * np.log2(1 + np.maximum(smooth, 0) / _COST_UNIT)).clip(0, 65535).astype(np.uint16)
    flooded = watershed_ift(relief, np.where(known, seeds, -1).astype(np.int32), structure=np.ones((3, 3), dtype=int))
    return np.where(known, flooded, -1).astype(np.int64)


def region_graph(candidates: IntArray, unary: AnyArray, cost: AnyArray, decided: IntArray | None = None) -> RegionGraph:
    """Graph of regions: cells of one basin with the same candidates.

    Parameters
    ----------
    candidates : int array (ranks, rows, cols)
        Images that may show a cell, the nearest first, -1 where there are no more.
    unary : array (ranks, rows, cols)
        Cost of each of them showing it.
    cost : array (rows, cols)
        Cost of a seam through the cell.
    decided : int array (rows, cols), optional
        Image of cells that have only this candidate, and to whose basins it belongs; below 0 elsewhere.

    Returns
    -------
    RegionGraph
    """
    ranks, known = len(candidates), candidates[0] >= 0
    basin = _catchment_basins(cost, known)
    if decided is not None:
        candidates = _continued(candidates, basin, decided)
    # The cells of a region have the same candidates, whatever their order.
    sets = np.sort(candidates[:, known], axis=0)
    # All cells with the same sole candidate are one region, whatever their basin: there is nothing to decide.
    sole = (sets[:-1] < 0).all(axis=0)
    inverse = np.empty(sets.shape[1], dtype=np.int64)
    alone, inverse[sole] = np.unique(sets[-1, sole], return_inverse=True)
    mixed, inverse[~sole] = np.unique(_keys(basin[known], sets)[~sole], return_inverse=True)
    inverse[~sole] += len(alone)
    count = len(alone) + len(mixed)
    region = np.full(known.shape, -1)
    region[known] = inverse
    allowed = np.full((count, ranks), -1)
    allowed[inverse] = sets[::-1].T
    totals = np.zeros((count, ranks))
    for rank in range(ranks):
        image, price = candidates[rank][known], unary[rank][known]
        for place in range(ranks):
            hit = (allowed[inverse, place] == image) & (image >= 0)
            totals[:, place] += np.bincount(inverse[hit], price[hit], count)
    return RegionGraph(region, allowed, totals, *_borders(region, cost, count))


def _continued(candidates: IntArray, basin: IntArray, decided: IntArray) -> IntArray:
    """Candidates (ranks, rows, cols) where basins whose decided cells are all of one image are that image's.

    A seam along decided cells would cut what stands there. Large basins are left: they are even ground.
    """
    count, known = int(basin.max(initial=-1)) + 1, (decided >= 0) & (basin >= 0)
    low, high = np.full(count, np.iinfo(np.int64).max), np.full(count, -1)
    np.minimum.at(low, basin[known], decided[known])
    np.maximum.at(high, basin[known], decided[known])
    small = np.bincount(basin[basin >= 0], minlength=count) <= _MAX_CONTINUED
    image = np.append(np.where((low == high) & small, high, -1), -1)[basin]
    follows = ~known & (image >= 0) & (candidates == image).any(axis=0)
    found = candidates.copy()
    found[:, follows] = -1
    found[0, follows] = image[follows]
    return found


def _keys(basin: IntArray, sets: IntArray) -> IntArray:
    """Numbers (N,) that are equal where the basins (N,) and the sets of candidates (ranks, N) of cells are."""
    present = np.zeros(int(sets.max(initial=-1)) + 2, dtype=bool)
    for images in sets:
        present[images + 1] = True
    place = np.cumsum(present) - 1
    key, base = basin, int(present.sum())
    for images in sets:
        key = key * base + place[images + 1]
    return key


def _borders(region: IntArray, cost: AnyArray, count: int) -> tuple[IntArray, IntArray, FloatArray]:
    """Pairs of touching regions and the cost of the seam between them, summed over the cells on both sides."""
    keys, prices = [], []
    for (down, right), length in _NEIGHBOURS:
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


def minimise(graph: RegionGraph, labels: IntArray) -> IntArray:
    """Labelling of least cost, to a local minimum of the swap moves.

    Parameters
    ----------
    graph : RegionGraph
    labels : int array (regions,)
        Initial image of each region.

    Returns
    -------
    int array (regions,)
        Image that shows each region.
    """
    best, adjacency = labels.copy(), _Adjacency.of(graph)
    # A swap changes the borders of its two images with others, so pairs that had nothing to gain may have now.
    for _ in range(MAX_SWEEPS):
        differ = best[graph.first] != best[graph.second]
        a, b = best[graph.first[differ]], best[graph.second[differ]]
        pairs = np.unique(np.column_stack([np.minimum(a, b), np.maximum(a, b)]), axis=0)
        changed = [_swap_move(graph, adjacency, best, int(i), int(j)) for i, j in pairs]
        if not any(changed):
            break
    return best


@dataclass(frozen=True)
class _Adjacency:
    """Edges by region and regions by image, so that a swap touches nothing but its own."""

    start: IntArray
    edges: IntArray
    shown_by: dict[int, IntArray]

    @classmethod
    def of(cls, parts: RegionGraph) -> _Adjacency:
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


def _swap_move(graph: RegionGraph, adjacency: _Adjacency, labels: IntArray, i: int, j: int) -> bool:
    """Swap move: regions of two images assigned anew by a minimal cut, in place; whether anything changed."""
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import breadth_first_order, maximum_flow

    none = np.zeros(0, dtype=np.int64)
    both = np.intersect1d(adjacency.shown_by.get(i, none), adjacency.shown_by.get(j, none), assume_unique=True)
    free = both[(labels[both] == i) | (labels[both] == j)]
    if not len(free):
        return False
    edges, size = adjacency.around(free), len(free)
    one, two, weight = graph.first[edges], graph.second[edges], graph.weight[edges]
    a, b = _positions(free, one), _positions(free, two)
    inner = (a >= 0) & (b >= 0)
    price_i = np.where(graph.allowed[free] == i, graph.unary[free], 0).sum(axis=1)
    price_j = np.where(graph.allowed[free] == j, graph.unary[free], 0).sum(axis=1)
    to_i, to_j = np.maximum(price_j - price_i, 0), np.maximum(price_i - price_j, 0)
    # Borders to regions outside of the swap: a region pays for them unless it goes to the image on the other side.
    for mine, neighbour in ((np.where(inner, -1, a), labels[two]), (np.where(inner, -1, b), labels[one])):
        for image, to in ((i, to_i), (j, to_j)):
            rim = (mine >= 0) & (neighbour == image)
            to += np.bincount(mine[rim], weight[rim], size)
    source, sink = size, size + 1
    rows = np.concatenate([a[inner], b[inner], np.full(size, source), np.arange(size)])
    cols = np.concatenate([b[inner], a[inner], np.arange(size), np.full(size, sink)])
    price = np.concatenate([weight[inner], weight[inner], to_i, to_j])
    # The solver takes whole numbers only: as fine as the sum allows, and no finer than a ten-thousandth.
    whole = np.round(price * min(1e4, _MAX_FLOW / max(float(price.sum()), 1e-9))).astype(np.int32)
    network = coo_matrix((whole, (rows, cols)), shape=(size + 2, size + 2)).tocsr()
    rest = (network - maximum_flow(network, source, sink).flow).tocsr()
    rest.eliminate_zeros()
    reached = np.zeros(size + 2, dtype=bool)
    reached[breadth_first_order(rest, source, return_predecessors=False)] = True

    def cost(with_i: BoolArray) -> float:
        apart = with_i[a[inner]] != with_i[b[inner]]
        return float(weight[inner][apart].sum() + to_j[with_i].sum() + to_i[~with_i].sum())

    # In exact costs, as rounding may prefer an equal or worse cut: the loop over all pairs would not end.
    if cost(reached[:size]) >= cost(labels[free] == i) - 1e-9:
        return False
    labels[free] = np.where(reached[:size], i, j)
    return True


def _positions(free: IntArray, regions: IntArray) -> IntArray:
    """Positions of regions in the sorted list of free ones; -1 where absent."""
    place = np.minimum(np.searchsorted(free, regions), len(free) - 1)
    return np.where(free[place] == regions, place, -1)
