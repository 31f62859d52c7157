"""Normal equations of a block, points eliminated: order of the parameters, reduced matrix, solution, cofactors.

    S = U − Wᵀ·V⁻¹·W      V of a point's coordinates, W of them and parameters, U of parameters

V has no numbers between two points, so that each is inverted by itself (Schur complement). S couples images that share
a point: in reverse Cuthill-McKee order it has a narrow envelope, and what all images share (a camera) comes last. Where
its factor would still take too long or too much memory, S is never formed: conjugate gradients solve it, preconditioned
by blocks on its diagonal, each as large as the limits allow. Cofactors are then those of these blocks, as if nothing
coupled them: good for the share of a measurement that others check, and no accuracies.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from geomosaic.errors import warn
from geomosaic.estimation.envelope import TILE, Envelope
from geomosaic.estimation.observations import Observations
from geomosaic.kernels.library import native
from geomosaic.kernels.threads import bounds, sharing
from geomosaic.types import BoolArray, FloatArray, IntArray

# Times the median number of neighbours from which on a block comes last; what is tried, the best is taken.
SHARED = (np.inf, 8.0, 3.0)
# Tiles of the largest matrix that is factorised: U, the factor and the inverse together 3.7 GB; and products of tiles,
# which take two and a half minutes of processor. Conjugate gradients are as quick as a factor from 5,000 images of
# crossing strips on (80 and 60 % overlap, 1.6 million products: four rounds took 34 s either way; 2,200 images 10 and
# 13 s), but know no covariances: memory and patience decide. Strips one way need a tenth of the products.
LARGEST, LONGEST = 150_000, 20_000_000
# Of conjugate gradients: share of the right-hand side that may be left, and rounds at most.
LEFT, ROUNDS = 1e-8, 2000
# Observations below which threads cost more than they save.
WORTH_THREADS = 5000

_find_touched = native("find_touched", "llllilll")
_gather_points = native("gather_points", "lllddlullddii")
_gather_parameters = native("gather_parameters", "lddllld")
_invert_points = native("invert_points", "ddulfddii")
_subtract_points = native("subtract_points", "llddlldiii")
_subtract_sides = native("subtract_sides", "llddd")
_solve_points = native("solve_points", "llddddii")
_multiply = native("multiply", "llddddd")
_multiply_turned = native("multiply_turned", "llddddd")
_point_cofactors = native("point_cofactors", "lldllddd" + "ii")
_observation_cofactors = native("observation_cofactors", "llddlllddlldd" + "ii")


@dataclass(frozen=True, eq=False)
class Pattern:
    """Order of the parameters, and which of them the observations of each point touch.

    Attributes
    ----------
    place : int array (U,)
        Place of each parameter in the reduced equations; -1 for those that are held.
    envelope : Envelope
        Of the reduced equations.
    start : int array (S + 1,)
        First of each point's parameters in `touched`.
    touched : int array (T,)
        Their places, ascending.
    by_point : tuple
        Of each group: first observation (S + 1,) of each point in the order (N,), which goes by points.
    iterative : bool
        Whether the envelope holds no more than blocks on the diagonal.
    made_of : tuple of array
        Blocks, parameters that are left out, points and columns of each group.
    """

    place: IntArray
    envelope: Envelope
    start: IntArray
    touched: IntArray
    by_point: tuple[tuple[IntArray, IntArray], ...]
    iterative: bool
    made_of: tuple[IntArray, ...]

    @classmethod
    def of(cls, groups: Sequence[Observations], blocks: IntArray, points: int, held: IntArray) -> Pattern:
        """Pattern of groups of observations.

        Parameters
        ----------
        groups : sequence of Observations
        blocks : int array (B + 1,)
            Where each block of parameters begins; the last is U.
        points : int
            S.
        held : int array (H,)
            Parameters that are left out.
        """
        by_point = tuple(_by_point(group.point, points) for group in groups)
        incidences = _joined(groups, by_point, points)
        block = np.repeat(np.arange(len(blocks) - 1), np.diff(blocks))
        start, touched, _ = _touched(incidences, block, len(blocks) - 1)
        single = [(group.columns[group.point < 0]) for group in groups]
        # One more, for the columns -1 of what is held, or of everything.
        block = np.append(block, -1)
        order = _block_order(start, touched, [block[c] for c in single], np.diff(blocks))
        columns = np.concatenate([np.zeros(0, np.int64), *(np.arange(blocks[b], blocks[b + 1]) for b in order)])
        columns = columns[~np.isin(columns, held)]
        place = np.full(int(blocks[-1]), -1)
        place[columns] = np.arange(len(columns))
        start, touched, lowest = _touched(incidences, place, len(columns))
        for own in single:
            at = np.append(place, -1)[own]
            least = np.where(at >= 0, at, len(columns)).min(axis=1, initial=len(columns))
            np.minimum.at(lowest, at[at >= 0], np.broadcast_to(least[:, None], at.shape)[at >= 0])
        envelope, parted = _affordable(lowest)
        return cls(place, envelope, start, touched, by_point, parted, _made_of(groups, blocks, held))

    def fits(self, groups: Sequence[Observations], blocks: IntArray, points: int, held: IntArray) -> bool:
        """Whether other observations are of the same points and parameters; arguments as for `of`.

        Parameters
        ----------
        groups : sequence of Observations
        blocks : int array (B + 1,)
        points : int
        held : int array (H,)
        """
        other = _made_of(groups, blocks, held)
        same = len(self.start) == points + 1 and len(other) == len(self.made_of)
        return same and all(a is b or np.array_equal(a, b) for a, b in zip(self.made_of, other, strict=True))


def _affordable(lowest: IntArray) -> tuple[Envelope, bool]:
    """Envelope of rows that begin at `lowest`, and whether it had to be parted into blocks on the diagonal."""
    row, width = np.arange(len(lowest)), len(lowest)
    envelope = Envelope.of(lowest)
    while width > TILE and (int(envelope.offset[-1]) > LARGEST or envelope.products > LONGEST):
        # Whole tiles, and half as many as before.
        width = -(-width // (2 * TILE)) * TILE
        envelope = Envelope.of(np.maximum(lowest, row // width * width))
    return envelope, width < len(lowest)


def _made_of(groups: Sequence[Observations], blocks: IntArray, held: IntArray) -> tuple[IntArray, ...]:
    return (blocks, held, *(each for group in groups for each in (group.point, group.columns)))


def _by_point(point: IntArray, points: int) -> tuple[IntArray, IntArray]:
    """First observation (points + 1,) of each point in an order (N,) by points; those without a point come first."""
    order = np.argsort(point, kind="stable")
    return np.searchsorted(point[order], np.arange(points + 1)), order


def _joined(
    groups: Sequence[Observations], by_point: Sequence[tuple[IntArray, IntArray]], points: int
) -> tuple[IntArray, IntArray, IntArray]:
    """Columns of all observations that have both points and parameters, with their order by points."""
    own = [k for k, group in enumerate(groups) if group.columns.shape[1] and (group.point >= 0).any()]
    both = [groups[k] for k in own]
    if len(both) == 1:
        return *by_point[own[0]], both[0].columns
    most = max((group.columns.shape[1] for group in both), default=0)
    columns = np.full((sum(len(group.point) for group in both), most), -1)
    first = 0
    for group in both:
        columns[first : first + len(group.point), : group.columns.shape[1]] = group.columns
        first += len(group.point)
    point = np.concatenate([np.zeros(0, np.int64), *(group.point for group in both)])
    return *_by_point(point, points), columns


def _touched(
    incidences: tuple[IntArray, IntArray, IntArray], place: IntArray, places: int
) -> tuple[IntArray, IntArray, IntArray]:
    """Places that each point touches: first (S + 1,) of each point, places (T,), and lowest neighbour (places,)."""
    lowest, start, none = np.arange(places), np.zeros(len(incidences[0]), np.int64), np.zeros(0, np.int64)
    _find_touched(*incidences, place, places, start, none, lowest)
    start = np.cumsum(start)
    touched = np.zeros(int(start[-1]), np.int64)
    if len(touched):
        _find_touched(*incidences, place, places, start, touched, lowest)
    return start, touched, lowest


def _block_order(start: IntArray, touched: IntArray, single: Sequence[IntArray], sizes: IntArray) -> IntArray:
    """Order of the blocks whose envelope takes the least work."""
    from scipy.sparse import csr_array, vstack
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    count = len(sizes)
    if count < 2:
        return np.arange(count)
    rows = [csr_array((np.ones(len(touched), np.int32), touched, start), shape=(len(start) - 1, count))]
    for blocks in single:
        own = np.flatnonzero((blocks >= 0).sum(axis=1) > 1)
        row, at = np.nonzero(blocks[own] >= 0)
        entries = (np.ones(len(row), np.int32), (row, blocks[own][row, at]))
        rows.append(csr_array(entries, shape=(len(own), count)))
    incidence = vstack(rows, format="csr")
    graph = (incidence.T @ incidence).tocsr()
    neighbours = np.diff(graph.indptr)
    best, least = np.arange(count), np.inf
    tried: list[BoolArray] = []
    for limit in SHARED:
        last = neighbours > limit * max(float(np.median(neighbours)), 1.0)
        if any(np.array_equal(last, before) for before in tried):
            continue
        tried.append(last)
        inner = np.flatnonzero(~last)
        order = np.concatenate([inner[reverse_cuthill_mckee(graph[inner][:, inner], True)], np.flatnonzero(last)])
        work = _work(graph, order, sizes)
        if work < least:
            best, least = order, work
    return best


def _work(graph: Any, order: IntArray, sizes: IntArray) -> float:
    """Multiplications of a Cholesky factorisation within the envelope, about."""
    rank = np.empty(len(order), np.int64)
    rank[order] = np.arange(len(order))
    begin = np.concatenate([[0], np.cumsum(sizes[order])])
    lowest = np.arange(len(order))
    row = np.repeat(np.arange(len(order)), np.diff(graph.indptr))
    np.minimum.at(lowest, rank[row], rank[graph.indices])
    width = (begin[:-1] - begin[lowest]).astype(np.float64)
    return float((sizes[order] * width**2).sum())


@dataclass(frozen=True, eq=False)
class NormalEquations:
    """Normal equations of groups of observations.

    Attributes
    ----------
    groups : tuple of Observations
        Contiguous arrays of int64 and float64.
    moving : bool array (S, D)
        Coordinates that are unknown.
    pattern : Pattern
    """

    groups: tuple[Observations, ...]
    moving: BoolArray
    pattern: Pattern

    @property
    def laborious(self) -> bool:
        """Whether there is enough work for threads."""
        return sum(len(group.point) for group in self.groups) > WORTH_THREADS

    @cached_property
    def of_points(self) -> tuple[FloatArray, FloatArray]:
        """V (S, D, D), and W of all points one after the other, each (D, T)."""
        size, at = self.moving.shape, self.pattern
        normal, mixed = np.zeros((*size, size[1])), np.zeros(len(at.touched) * size[1])
        moving = self.moving.view(np.uint8)
        with sharing(self.laborious) as shared:
            for group, (start, order) in zip(self.groups, at.by_point, strict=True):
                if start[-1] > start[0]:
                    part = partial(
                        _gather_points, start, order, group.columns, group.by_parameters, group.by_point,
                        at.place, moving, at.start, at.touched, normal, mixed,
                    )  # fmt: skip
                    shared(part, bounds(0, size[0]))
        return normal, mixed

    @cached_property
    def of_parameters(self) -> FloatArray:
        """Tiles of U."""
        at, tiles = self.pattern, self.pattern.envelope.zeros()
        for group in self.groups:
            if group.columns.shape[1]:
                _gather_parameters(
                    group.columns, group.by_parameters, group.by_point, at.place,
                    at.envelope.first, at.envelope.offset, tiles,
                )  # fmt: skip
        return tiles

    @cached_property
    def squares(self) -> tuple[FloatArray, FloatArray]:
        """Squared lengths of the columns of parameters (U,) and coordinates (S, D); 1 where a column is zero."""
        place, axis = self.pattern.place, np.arange(self.moving.shape[1])
        parameters, points = np.ones(len(place)), self.of_points[0][:, axis, axis].copy()
        parameters[place >= 0] = self.of_parameters.ravel()[self.pattern.envelope.diagonal][place[place >= 0]]
        return np.where(parameters > 0.0, parameters, 1.0), np.where(points > 0.0, points, 1.0)

    def product(self, parameters: FloatArray, coordinates: FloatArray) -> list[FloatArray]:
        """A·dx, of each group (N, K), of changes of parameters (U,) and coordinates (S, D)."""
        found = [np.empty_like(group.misclosure) for group in self.groups]
        for group, own in zip(self.groups, found, strict=True):
            by = (group.point, group.columns, group.by_parameters, group.by_point)
            _multiply(*by, parameters, coordinates, own)
        return found

    def turned_product(self, values: Sequence[FloatArray]) -> tuple[FloatArray, FloatArray]:
        """Aᵀ·v of parameters (U,) and coordinates (S, D), of values (N, K) of each group."""
        parameters, coordinates = np.zeros(len(self.pattern.place)), np.zeros(self.moving.shape)
        for group, own in zip(self.groups, values, strict=True):
            by = (group.point, group.columns, group.by_parameters, group.by_point)
            _multiply_turned(*by, np.ascontiguousarray(own), parameters, coordinates)
        parameters[self.pattern.place < 0] = 0.0
        return parameters, np.where(self.moving, coordinates, 0.0)

    def factored(self, damping: float = 0.0) -> FactoredNormals:
        """Factors, with a damping times the squared length of each column added to the diagonal."""
        (normal, mixed), at = self.of_points, self.pattern
        inverses, solved = np.empty_like(normal), np.empty_like(mixed)
        tiles, envelope = self.of_parameters.copy(), at.envelope
        damped = damping * self.squares[0][at.place >= 0]
        tiles.ravel()[envelope.diagonal[at.place[at.place >= 0]]] += damped
        moving = self.moving.view(np.uint8)
        with sharing(self.laborious) as shared:
            part = partial(_invert_points, normal, mixed, moving, at.start, damping, inverses, solved)
            shared(part, bounds(0, len(normal)))
            part = partial(
                _subtract_points, at.start, at.touched, mixed, solved, envelope.first, envelope.offset, tiles,
                self.moving.shape[1],
            )  # fmt: skip
            shared(part, bounds(0, envelope.size))
        return FactoredNormals(self, damping, inverses, solved, tiles, envelope.factor(tiles) < 0)


@dataclass(frozen=True, eq=False)
class FactoredNormals:
    """Factors of normal equations.

    Attributes
    ----------
    normals : NormalEquations
    damping : float
    inverses : array (S, D, D)
        V⁻¹.
    solved : array
        V⁻¹·W, laid out as W.
    factor : array
        Tiles of the Cholesky factor of S, or of those on its diagonal.
    regular : bool
        Whether all of its pivots are positive; else nothing can be solved.
    """

    normals: NormalEquations
    damping: float
    inverses: FloatArray
    solved: FloatArray
    factor: FloatArray
    regular: bool

    def solve(
        self, parameters: FloatArray, coordinates: FloatArray, left: float = LEFT
    ) -> tuple[FloatArray, FloatArray]:
        """Parameters (M, U) and coordinates (M, S, D) from right-hand sides of these shapes.

        Conjugate gradients leave a share `left` of the right-hand sides.
        """
        at, count = self.normals.pattern, len(parameters)
        found, points = np.zeros_like(parameters), coordinates.copy()
        if not self.regular:
            return np.full_like(parameters, np.nan), np.full_like(coordinates, np.nan)
        right, free = np.zeros((count, at.envelope.size)), at.place >= 0
        right[:, at.place[free]] = parameters[:, free]
        _subtract_sides(at.start, at.touched, self.solved, points, right)
        reduced = self._reduced(right, left)
        found[:, free] = reduced[:, at.place[free]]
        with sharing(self.normals.laborious) as shared:
            part = partial(_solve_points, at.start, at.touched, self.solved, self.inverses, reduced, points)
            shared(part, bounds(0, points.shape[1]))
        return found, points

    def _reduced(self, right: FloatArray, left: float = LEFT) -> FloatArray:
        """Solutions (M, places) of the reduced equations."""
        if not self.normals.pattern.iterative:
            return self._near(right)
        return np.array([self._by_conjugate_gradients(each, left) for each in right]).reshape(right.shape)

    def _near(self, right: FloatArray) -> FloatArray:
        """Solutions (M, places) of the equations that are factorised: the reduced ones, or their diagonal blocks."""
        return self.normals.pattern.envelope.solve(self.factor, right)

    def _by_conjugate_gradients(self, right: FloatArray, share: float) -> FloatArray:
        """Solution (places,) of the reduced equations (Hestenes and Stiefel 1952)."""
        found, left = np.zeros_like(right), right.copy()
        turned = way = self._near(left[None])[0]
        # Sums of NumPy's own: those of its linear algebra depend on the number of threads.
        size = first = float((left * turned).sum())
        for _ in range(ROUNDS):
            if not size > share**2 * first:
                return found
            product = self._reduced_product(way)
            length = size / float((way * product).sum())
            found, left = found + length * way, left - length * product
            turned = self._near(left[None])[0]
            before, size = size, float((left * turned).sum())
            way = turned + size / before * way
        warn(
            f"conjugate gradients ended after {ROUNDS} rounds with {(size / first) ** 0.5:.1g} of the equations left: "
            "the block is determined badly"
        )
        return found

    def _reduced_product(self, vector: FloatArray) -> FloatArray:
        """S times a vector (places,): S itself is not there."""
        normals, at = self.normals, self.normals.pattern
        parameters, points = np.zeros(len(at.place)), np.zeros((1, *normals.moving.shape))
        free = at.place >= 0
        parameters[free] = vector[at.place[free]]
        whole = normals.turned_product(normals.product(parameters, points[0]))[0]
        whole = whole + self.damping * normals.squares[0] * parameters
        found = np.zeros((1, len(vector)))
        found[0, at.place[free]] = whole[free]
        with sharing(normals.laborious) as shared:
            part = partial(_solve_points, at.start, at.touched, self.solved, self.inverses, vector[None], points)
            shared(part, bounds(0, points.shape[1]))
        _subtract_sides(at.start, at.touched, normals.of_points[1], -points, found)
        product: FloatArray = found[0]
        return product

    def columns(self, numbers: IntArray) -> FloatArray:
        """Cofactors (U, M) of all parameters against those of some numbers; 0 for those that are held."""
        at = self.normals.pattern
        free, right = at.place >= 0, np.zeros((len(numbers), at.envelope.size))
        own = np.flatnonzero(at.place[numbers] >= 0)
        right[own, at.place[numbers[own]]] = 1.0
        found = np.zeros((len(at.place), len(numbers)))
        if not self.regular:
            return np.full_like(found, np.nan)
        found[free] = self._reduced(right).T[at.place[free]]
        return found

    def block(self, rows: IntArray, cols: IntArray) -> FloatArray | None:
        """Cofactors of parameters (P,) and (Q,); None where they are not all in the envelope."""
        if self.normals.pattern.iterative:
            return None
        place, found = self.normals.pattern.place, np.zeros((len(rows), len(cols)))
        held = np.ix_(place[rows] >= 0, place[cols] >= 0)
        row, col = (at[at >= 0] for at in (place[rows], place[cols]))
        known = self.normals.pattern.envelope.block(self.inverse, row, col)
        if known is None:
            return None
        found[held] = known
        return found

    @cached_property
    def inverse(self) -> FloatArray:
        """Tiles of the inverse of S within its envelope, or of each diagonal block; NaN where it has none."""
        if not self.regular:
            return np.full_like(self.factor, np.nan)
        return self.normals.pattern.envelope.inverse(self.factor)

    @cached_property
    def of_points(self) -> tuple[FloatArray, FloatArray]:
        """Cofactors (S, D, D) of points, and those of their coordinates and parameters, laid out as W."""
        at, found, mutual = self.normals.pattern, self.inverses.copy(), np.zeros_like(self.solved)
        with sharing(self.normals.laborious) as shared:
            part = partial(
                _point_cofactors, at.start, at.touched, self.solved, at.envelope.first, at.envelope.offset,
                self.inverse, found, mutual,
            )  # fmt: skip
            shared(part, bounds(0, len(found)))
        return found, mutual

    def between(self, group: Observations, chosen: IntArray) -> FloatArray:
        """Cofactors A·Q·Aᵀ (N·K, M·K) of all adjusted observations of a group and some of them (M,)."""
        # Rows (A, G) are those of A − G·Z of the reduced equations, and G·V⁻¹·Gᵀ between two of one point. An
        # observation touches few parameters: the rows of a thousand camera positions would be gigabytes of zeros.
        (count, size), reduced = group.misclosure.shape, self._reduced_rows(group)
        rows = (chosen[:, None] * size + np.arange(size)).ravel()
        found = reduced @ self._near(reduced[rows].toarray()).T
        blocks = np.ascontiguousarray(found).reshape(count, size, len(chosen), size)
        for place, own in enumerate(chosen.tolist()):
            if (p := group.point[own]) >= 0:
                same = np.flatnonzero(group.point == p)
                blocks[same, :, place] += group.by_point[same] @ self.inverses[p] @ group.by_point[own].T
        return blocks.reshape(count * size, len(chosen) * size)

    def _reduced_rows(self, group: Observations) -> Any:
        """Sparse array (N·K, places) of the derivatives of a group's observations, their points eliminated."""
        from scipy.sparse import coo_array

        at, size, dimensions = self.normals.pattern, group.misclosure.shape[1], self.normals.moving.shape[1]
        entries, rows, cols = [np.zeros((0, size))], [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
        place = np.append(at.place, -1)[group.columns]
        observation, parameter = np.nonzero(place >= 0)
        entries.append(group.by_parameters[observation, :, parameter])
        rows.append(observation)
        cols.append(place[observation, parameter])
        for own in np.flatnonzero(group.point >= 0).tolist():
            part = slice(*at.start[group.point[own] : group.point[own] + 2])
            solved = self.solved[dimensions * part.start : dimensions * part.stop].reshape(dimensions, -1)
            entries.append(-(group.by_point[own] @ solved).T)
            rows.append(np.full(part.stop - part.start, own))
            cols.append(at.touched[part])
        row = np.concatenate(rows)[:, None] * size + np.arange(size)
        col = np.broadcast_to(np.concatenate(cols)[:, None], row.shape)
        where = (row.ravel(), col.ravel())
        return coo_array(
            (np.concatenate(entries).ravel(), where), shape=(len(group.point) * size, at.envelope.size)
        ).tocsr()

    def of_observations(self, group: Observations) -> FloatArray:
        """Cofactors A·Q·Aᵀ (N, K, K) of the adjusted observations of a group."""
        at, (points, mutual) = self.normals.pattern, self.of_points
        found = np.empty((*group.misclosure.shape, group.misclosure.shape[1]))
        with sharing(self.normals.laborious) as shared:
            part = partial(
                _observation_cofactors, group.point, group.columns, group.by_parameters, group.by_point, at.place,
                at.start, at.touched, points, mutual, at.envelope.first, at.envelope.offset, self.inverse, found,
            )  # fmt: skip
            shared(part, bounds(0, len(group.point)))
        return found

    def of_points_with(self, group: Observations) -> FloatArray:
        """Cofactors Q·Aᵀ (N, D, K) of each observation's point and the observation; NaN of those of no point."""
        at, (points, mutual) = self.normals.pattern, self.of_points
        count, dimensions = at.envelope.size, points.shape[1]
        found = np.full((len(group.point), dimensions, group.misclosure.shape[1]), np.nan)
        rows = np.flatnonzero(group.point >= 0)
        own = group.point[rows]
        found[rows] = points[own] @ np.swapaxes(group.by_point[rows], 1, 2)
        # Places of a point ascend, so that all pairs of point and place can be searched as one sorted list.
        pairs = np.repeat(np.arange(len(points)), np.diff(at.start)) * count + at.touched
        for column, by in zip(group.columns[rows].T, np.moveaxis(group.by_parameters[rows], 2, 0), strict=True):
            there = np.flatnonzero(np.append(at.place, -1)[column] >= 0)
            point = own[there]
            first = np.searchsorted(pairs, point * count + at.place[column[there]]) - at.start[point]
            entries = dimensions * at.start[point] + first
            width = np.diff(at.start)[point]
            for d in range(dimensions):
                found[rows[there], d] += mutual.reshape(-1)[entries + d * width][:, None] * by[there]
        return found
