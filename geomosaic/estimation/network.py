"""Linearised network of a block: groups of observations of parameters that images share, and of object points.

    v = w − A·dp − G·dX

w measured minus computed, p the parameters (of an image, a camera, a strip), X the coordinates of a point. Image
positions, given coordinates and a-priori values of parameters are all of this form.

A change of the unknowns is one vector: the U parameters, then the coordinates that move, point by point.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from geomosaic.estimation.elimination import FactoredNormals, NormalEquations, Pattern
from geomosaic.estimation.observations import Observations
from geomosaic.types import BoolArray, FloatArray, IntArray

__all__ = ["FreeDatum", "Network", "Observations"]

# Of Lanczos' iteration; it ends sooner where the eigenvalue has six digits.
ITERATIONS = 60
# Added to the diagonal of a singular normal matrix, so that inverse iteration finds the direction it loses.
BESIDE = 1e-12
# Share of the equations that a step by conjugate gradients leaves to the next one.
STEP_LEFT = 1e-4
# Least eigenvalue of a point's normal matrix of unit diagonal: lines of sight within about 1e-6 radians are parallel.
UNDETERMINED = 1e-12
# Share of a column that other unknowns leave, below which it may be rounding.
LEAST_PIVOT = 1e-10


@dataclass(frozen=True, eq=False)
class FreeDatum:
    """Datum by inner constraints: of all solutions that fit as well, the one that moves chosen unknowns least.

    Attributes
    ----------
    directions : array (unknowns, F)
        Changes of all unknowns that no observation sees, as shifts, turns and the scale of the whole block.
    chosen : bool array (unknowns,)
        Unknowns whose change is to be least: usually the coordinates of all points, or of some.
    """

    directions: FloatArray
    chosen: BoolArray

    @cached_property
    def constraint(self) -> FloatArray:
        """Amounts (F, unknowns) of the directions in a change, taken off it by `applied`."""
        own = self.directions * self.chosen[:, None]
        amounts = np.linalg.solve(own.T @ self.directions, own.T)
        return np.asarray(amounts, dtype=np.float64)

    def applied(self, change: FloatArray) -> FloatArray:
        """Change (unknowns,) freed of the directions."""
        # Sums of NumPy's own: those of its linear algebra depend on the number of threads.
        amounts = (self.constraint * change).sum(axis=1)
        moved: FloatArray = change - (self.directions * amounts).sum(axis=1)
        return moved

    def turned(self, sides: FloatArray) -> FloatArray:
        """Right-hand sides (unknowns, ...) of which `applied` solutions are cofactors times these sides."""
        return sides - self.constraint.T @ (self.directions.T @ sides)

    def held(self, parameters: int, lengths: FloatArray) -> IntArray:
        """Parameters that hold the datum when they are held, as many as there are directions: the most effective."""
        from scipy.linalg import qr

        scaled = self.directions[:parameters] * lengths[:parameters, None]
        pivots: IntArray = qr(scaled.T, mode="r", pivoting=True)[1][: self.directions.shape[1]]
        return np.sort(pivots)


@dataclass(frozen=True, eq=False)
class Network:
    """Linearised network of S points with D coordinates and U parameters.

    Attributes
    ----------
    groups : tuple of Observations
    blocks : int array (B + 1,)
        Where each block of parameters (an image, a camera) begins; the last is U.
    moving : bool array (S, D)
        Coordinates that are unknown; the others are held.
    datum : FreeDatum, optional
        Where no observation gives one.
    known : Pattern, optional
        That of another network, taken over where its observations are of the same points and parameters.
    """

    groups: tuple[Observations, ...]
    blocks: IntArray
    moving: BoolArray
    datum: FreeDatum | None = None
    known: Pattern | None = None

    @property
    def parameters(self) -> int:
        """Number U of parameters."""
        return int(self.blocks[-1])

    @cached_property
    def place(self) -> IntArray:
        """Number (S, D) of each coordinate among the unknowns; -1 for those that are held."""
        number = self.parameters - 1 + np.cumsum(self.moving).reshape(self.moving.shape)
        return np.where(self.moving, number, -1)

    @property
    def unknowns(self) -> int:
        """Parameters and moving coordinates."""
        return self.parameters + int(self.moving.sum())

    @property
    def redundancy(self) -> int:
        """Observed components less unknowns, and more the directions of a free datum."""
        free = 0 if self.datum is None else self.datum.directions.shape[1]
        return sum(group.misclosure.size for group in self.groups) - self.unknowns + free

    @cached_property
    def misclosure(self) -> FloatArray:
        """Whitened misclosures (R,) of all groups, one after the other."""
        return np.concatenate([np.zeros(0), *(group.misclosure.ravel() for group in self.groups)])

    @cached_property
    def design(self) -> Any:
        """Sparse array (R, unknowns) of all derivatives."""
        from scipy.sparse import coo_array

        entries, rows, cols, first = [np.zeros(0)], [np.zeros(0, np.int64)], [np.zeros(0, np.int64)], 0
        for group in self.groups:
            count, size = group.misclosure.shape
            by = np.concatenate([group.by_parameters, group.by_point], axis=2)
            place = np.full((count, self.moving.shape[1]), -1)
            place[group.point >= 0] = self.place[group.point[group.point >= 0]]
            column = np.broadcast_to(np.hstack([group.columns, place])[:, None, :], by.shape)
            row = np.broadcast_to((first + np.arange(count * size)).reshape(count, size, 1), by.shape)
            free = column >= 0
            entries.append(by[free])
            rows.append(row[free])
            cols.append(column[free])
            first += count * size
        where = (np.concatenate(rows), np.concatenate(cols))
        return coo_array((np.concatenate(entries), where), shape=(first, self.unknowns)).tocsr()

    @cached_property
    def normals(self) -> NormalEquations:
        """Normal equations; the parameters that would take the datum away are held, see `FreeDatum.held`."""
        groups = tuple(group.contiguous() for group in self.groups)
        pattern, none = self.known, np.zeros(0, np.int64)
        if pattern is None or not pattern.fits(groups, self.blocks, len(self.moving), none):
            pattern = Pattern.of(groups, self.blocks, len(self.moving), none)
        found = NormalEquations(groups, np.ascontiguousarray(self.moving), pattern)
        if self.datum is None:
            return found
        held = self.datum.held(self.parameters, np.sqrt(self._joined(*found.squares)))
        return replace(found, pattern=Pattern.of(groups, self.blocks, len(self.moving), held))

    @cached_property
    def factored(self) -> FactoredNormals:
        """Factors of the normal equations, without damping."""
        return self.normals.factored()

    @property
    def approximate(self) -> bool:
        """Whether the network is too large for a factor: cofactors leave out how its parts hang together."""
        return self.normals.pattern.iterative

    def step(self, damping: float = 0.0) -> FloatArray:
        """Changes of the unknowns that minimise |w − A·dx|² + damping · |L·dx|², L the lengths of the columns.

        NaN where the observations do not determine them.
        """
        normals, factored = self.normals, self.normals.factored(damping) if damping else self.factored
        weight = tuple(damping * each for each in normals.squares)
        found = (np.zeros(self.parameters), np.zeros(self.moving.shape))
        # Normal equations square the condition number; a second solution, of what is left, gives the lost digits back.
        # Conjugate gradients need not: the next linearisation does.
        for _ in range(1 if self.approximate else 2):
            left = [g.misclosure - own for g, own in zip(normals.groups, normals.product(*found), strict=True)]
            right = [side - w * x for side, w, x in zip(normals.turned_product(left), weight, found, strict=True)]
            more = factored.solve(right[0][None], right[1][None], STEP_LEFT)
            found = (found[0] + more[0][0], found[1] + more[1][0])
        step = self._joined(*found)
        return step if self.datum is None else self.datum.applied(step)

    def residuals(self, step: FloatArray) -> FloatArray:
        """Whitened residuals (R,) after a step."""
        product = self.normals.product(*self._parted(step))
        left: FloatArray = self.misclosure - np.concatenate([np.zeros(0), *(own.ravel() for own in product)])
        return left

    def condition(self) -> tuple[float, FloatArray]:
        """Condition number of the design with columns of unit length, and the direction determined worst."""
        if not self.unknowns:
            return 1.0, np.zeros(0)
        normals, length = self.normals, np.sqrt(self._joined(*self.normals.squares))
        start = np.random.default_rng(0).normal(size=self.unknowns)
        if not self.factored.regular:
            beside = normals.factored(BESIDE)
            if not beside.regular:
                lost = np.zeros(self.moving.shape)
                lost[self.undetermined_points] = 1.0
                return np.inf, self._joined(np.zeros(self.parameters), lost)
            return np.inf, _largest_eigenvalue(lambda v: length * self._solved_once(v * length, beside), start)[1]

        def onward(v: FloatArray) -> FloatArray:
            return self._joined(*normals.turned_product(normals.product(*self._parted(v / length)))) / length

        def cofactors(v: FloatArray) -> FloatArray:
            side = v * length if self.datum is None else self.datum.turned(v * length)
            return length * self._solved_once(side, self.factored)

        most, _ = _largest_eigenvalue(onward, start)
        inverse, direction = _largest_eigenvalue(cofactors, start)
        return float(np.sqrt(most * inverse)), direction

    def weakest(self) -> tuple[float, FloatArray]:
        """Condition number, and the change of all unknowns by one sigma along the direction determined worst."""
        condition, direction = self.condition()
        own = direction / np.sqrt(self._joined(*self.normals.squares))
        # One standard deviation along an axis of the error ellipsoid raises the sum of squares by 1.
        raised = np.linalg.norm(self.misclosure - self.residuals(own))
        return condition, np.asarray(own / max(float(raised), 1e-150), dtype=np.float64)

    @property
    def least_pivot(self) -> float:
        """Smallest share of a parameter's column that no other unknown explains; 0 where the network is singular."""
        factored, at = self.factored, self.normals.pattern
        if not factored.regular:
            return 0.0
        free = at.place >= 0
        pivots = factored.factor.ravel()[at.envelope.diagonal[at.place[free]]]
        squares = self.normals.squares[0][free]
        known = squares > 0.0
        return float((pivots[known] ** 2 / squares[known]).min(initial=1.0))

    def solve(self, right: FloatArray) -> FloatArray:
        """Cofactors of the unknowns times right-hand sides (unknowns,) or (unknowns, M)."""
        found, sides = [], right if self.datum is None else self.datum.turned(right)
        for side in np.atleast_2d(sides.T):
            first = self._solved_once(side, self.factored)
            back = self.normals.turned_product(self.normals.product(*self._parted(first)))
            found.append(first + self._solved_once(side - self._joined(*back), self.factored))
        return np.array(found).T.reshape(right.shape)

    @cached_property
    def undetermined_points(self) -> IntArray:
        """Points whose moving coordinates their observations do not determine: one ray, parallel rays, none."""
        normal, axis = self.normals.of_points[0].copy(), np.arange(self.moving.shape[1])
        normal[:, axis, axis] = np.where(self.moving, normal[:, axis, axis], 1.0)
        length = np.sqrt(np.where(normal[:, axis, axis] > 0.0, normal[:, axis, axis], 1.0))
        least = np.linalg.eigvalsh(normal / (length[:, :, None] * length[:, None, :]))[:, 0]
        return np.flatnonzero(~(least > UNDETERMINED))

    def parameter_cofactors(self) -> FloatArray:
        """Cofactors (U, U) of all parameters."""
        every = np.arange(self.parameters)
        found = self._in_datum(self.factored.columns(every), every, every)
        return (found + found.T) / 2.0

    def parameter_variances(self) -> FloatArray:
        """Cofactors (U,) of each parameter with itself; NaN where the network is `approximate`."""
        factored, at = self.factored, self.normals.pattern
        if at.iterative:
            return np.full(self.parameters, np.nan)
        found, free = np.zeros(self.parameters), at.place >= 0
        found[free] = factored.inverse.ravel()[at.envelope.diagonal[at.place[free]]]
        if self.datum is None:
            return found
        (against, amounts), own = self._by_datum, self.datum.directions[: self.parameters]
        moved: FloatArray = found + ((own @ amounts - 2.0 * against[: self.parameters]) * own).sum(axis=1)
        return moved

    def cofactors_of(self, pairs: Iterable[tuple[int, int]]) -> dict[tuple[int, int], FloatArray]:
        """Cofactors of the parameters of two blocks each, by the pair of their numbers."""
        own = [np.arange(*each) for each in pairwise(self.blocks)]
        return {(a, b): self.cofactors_between(own[a], own[b]) for a, b in pairs}

    def cofactors_between(self, rows: IntArray, cols: IntArray) -> FloatArray:
        """Cofactors (P, Q) of parameters (P,) and (Q,), at once where they share observations."""
        found = self.factored.block(rows, cols)
        return self._in_datum(self.factored.columns(cols)[rows] if found is None else found, rows, cols)

    def point_cofactors(self) -> FloatArray:
        """Cofactors (S, D, D) of each point's coordinates, 0 for those that are held; NaN where `approximate`."""
        if self.approximate:
            return np.full((*self.moving.shape, self.moving.shape[1]), np.nan)
        found = self.factored.of_points[0]
        if self.datum is None:
            return found
        own, by = np.where(self.moving[:, :, None], self.datum.directions[self.place], 0.0), self._by_datum
        against = np.where(self.moving[:, :, None], by[0][self.place], 0.0)
        turned = own @ np.swapaxes(against, 1, 2)
        moved: FloatArray = found - turned - np.swapaxes(turned, 1, 2) + own @ by[1] @ np.swapaxes(own, 1, 2)
        return moved

    def point_influence(self, index: int) -> FloatArray:
        """Derivatives (N, D, K) of the adjusted points of a group's observations by these, whitened.

        NaN of observations of no eliminated point, where the network is `approximate`, and under a free datum, in which
        a shift of one point has no meaning.
        """
        group = self.normals.groups[index]
        if self.datum is not None or self.approximate:
            return np.full((len(group.point), self.moving.shape[1], group.misclosure.shape[1]), np.nan)
        return self.factored.of_points_with(group)

    def redundancy_numbers(self) -> tuple[FloatArray, ...]:
        """Redundancy numbers I − A·Q·Aᵀ (N, K, K) of each group's observations; their traces sum to the redundancy."""
        return tuple(self.redundancy_blocks(index) for index in range(len(self.normals.groups)))

    def _joined(self, parameters: FloatArray, coordinates: FloatArray) -> FloatArray:
        """Unknowns (unknowns,) of parameters (U,) and coordinates (S, D)."""
        return np.concatenate([parameters, coordinates[self.moving]])

    def _parted(self, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Parameters (U,) and coordinates (S, D) of unknowns (unknowns,), 0 for those that are held."""
        coordinates = np.zeros(self.moving.shape)
        coordinates[self.moving] = unknowns[self.parameters :]
        return np.ascontiguousarray(unknowns[: self.parameters]), coordinates

    def redundancy_blocks(self, index: int) -> FloatArray:
        """Redundancy numbers I − A·Q·Aᵀ (N, K, K) of the observations of one group."""
        group = self.normals.groups[index]
        own: FloatArray = np.eye(group.misclosure.shape[1]) - self.factored.of_observations(group)
        return _not_negative(own) if self.approximate else own

    def redundancy_columns(self, index: int, chosen: IntArray) -> FloatArray:
        """Columns (N·K, M·K) of the redundancy matrix I − A·Q·Aᵀ of a group that belong to some observations (M,)."""
        group = self.normals.groups[index]
        size = group.misclosure.shape[1]
        found = -self.factored.between(group, chosen)
        own = (chosen[:, None] * size + np.arange(size)).ravel()
        found[own, np.arange(len(own))] += 1.0
        return found

    def _solved_once(self, right: FloatArray, factored: FactoredNormals) -> FloatArray:
        """Solution of the normal equations for one side (unknowns,) that the datum has no part in, not refined."""
        parameters, coordinates = self._parted(right)
        (found,), (points,) = factored.solve(parameters[None], coordinates[None])
        solved = self._joined(found, points)
        return solved if self.datum is None else self.datum.applied(solved)

    @cached_property
    def _by_datum(self) -> tuple[FloatArray, FloatArray]:
        """Cofactors (unknowns, F) of unknowns and amounts of the free directions, and (F, F) of these amounts."""
        if self.datum is None:
            raise RuntimeError("a network with a datum of its own")
        sides = [self._parted(each) for each in self.datum.constraint]
        found = self.factored.solve(np.array([p for p, _ in sides]), np.array([x for _, x in sides]))
        against = np.array([self._joined(p, x) for p, x in zip(*found, strict=True)]).T
        return against, self.datum.constraint @ against

    def _in_datum(self, found: FloatArray, rows: IntArray, cols: IntArray) -> FloatArray:
        """Cofactors of unknowns `rows` and `cols` brought from the held parameters to the free datum."""
        if self.datum is None:
            return found
        # Q = T Q₀ Tᵀ with T = I − G·M (an S-transformation): only Q₀·Mᵀ is needed beside the cofactors themselves.
        (against, amounts), own = self._by_datum, self.datum.directions
        moved: FloatArray = found - own[rows] @ against[cols].T - against[rows] @ own[cols].T
        return moved + own[rows] @ amounts @ own[cols].T


def _not_negative(share: FloatArray) -> FloatArray:
    """Redundancy numbers (N, K, K) of approximate cofactors, which may be negative, brought to 0."""
    values, vectors = np.linalg.eigh(share)
    found: FloatArray = (vectors * np.maximum(values, 0.0)[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    return found


def _largest_eigenvalue(apply: Callable[[FloatArray], FloatArray], start: FloatArray) -> tuple[float, FloatArray]:
    """Largest eigenvalue of a positive definite operator, and its vector (U,); inf where it gives no finite numbers."""
    from scipy.linalg import eigh_tridiagonal

    # Lanczos (1950), every vector made orthogonal to all before it: a dozen products in place of a power iteration's
    # hundreds, whose vector was still a mixture where two directions are determined equally badly.
    rounds = min(ITERATIONS, len(start))
    basis, diagonal, beside = np.zeros((rounds + 1, len(start))), list[float](), list[float]()
    basis[0] = start / np.linalg.norm(start)
    value, shares = 0.0, np.ones(1)
    for k in range(rounds):
        turned = apply(basis[k])
        if not np.isfinite(turned).all():
            return np.inf, basis[k]
        diagonal.append(float(basis[k] @ turned))
        for _ in range(2):
            turned = turned - basis[: k + 1].T @ (basis[: k + 1] @ turned)
        beside.append(float(np.linalg.norm(turned)))
        values, vectors = eigh_tridiagonal(diagonal, beside[:-1])
        value, shares = float(values[-1]), vectors[:, -1]
        # The error of the value is of the second order in this: it has six digits.
        if beside[-1] * abs(shares[-1]) <= 1e-3 * value:
            break
        basis[k + 1] = turned / beside[-1]
    vector: FloatArray = basis[: len(shares)].T @ shares
    return value, vector
