"""Linearised network of a block: groups of observations of parameters that images share, and of object points.

    v = w − A·dp − G·dX

w measured minus computed, p the parameters (of an image, a camera, a strip), X the coordinates of a point. Each
observation is of one kind, touches one point or none, and is whitened: its rows are over the root of its covariance.
Image positions, given coordinates and a-priori values of parameters are all of this form.

A change of the unknowns is one vector: the U parameters, then the coordinates that move, point by point.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from geomosaic.estimation.equations import NormalEquations
from geomosaic.types import BoolArray, FloatArray, IntArray

# Least eigenvalue of a point's normal matrix of unit diagonal: lines of sight within about 1e-6 radians are parallel.
UNDETERMINED = 1e-12
# Right-hand sides solved at a time: bounds the memory.
CHUNK = 512


@dataclass(frozen=True, eq=False)
class Observations:
    """N whitened observations of K components each, of one kind.

    Attributes
    ----------
    point : int array (N,)
        Object point; -1 where none takes part.
    columns : int array (N, P)
        Number of each parameter among all of the network; -1 where it is held, or absent.
    by_parameters : array (N, K, P)
        Derivatives of the computed observations.
    by_point : array (N, K, D)
        Derivatives by the coordinates of the point.
    misclosure : array (N, K)
        Measured minus computed.
    """

    point: IntArray
    columns: IntArray
    by_parameters: FloatArray
    by_point: FloatArray
    misclosure: FloatArray

    @classmethod
    def of_parameters(cls, away: FloatArray, sigmas: FloatArray, dimensions: int = 3) -> Observations:
        """A-priori values of parameters.

        Parameters
        ----------
        away : array (U,)
            A-priori less present values.
        sigmas : array (U,)
            Standard deviations; inf where a parameter has no a-priori value.
        dimensions : int
            Coordinates of the network's points.
        """
        known = np.flatnonzero(np.isfinite(sigmas))
        weight = 1.0 / sigmas[known]
        return cls(
            np.full(len(known), -1),
            known[:, None],
            weight[:, None, None],
            np.zeros((len(known), 1, dimensions)),
            (away[known] * weight)[:, None],
        )

    @classmethod
    def of_coordinates(cls, away: FloatArray, sigmas: FloatArray) -> Observations:
        """Given coordinates of points, each coordinate by itself.

        Parameters
        ----------
        away : array (S, D)
            Given less present coordinates.
        sigmas : array (S, D)
            Standard deviations; inf where a coordinate is not given, 0 where it is held.
        """
        point, axis = np.nonzero(np.isfinite(sigmas) & (sigmas > 0.0))
        weight = 1.0 / sigmas[point, axis]
        by_point = np.zeros((len(point), 1, sigmas.shape[1]))
        by_point[np.arange(len(point)), 0, axis] = weight
        return cls(
            point,
            np.zeros((len(point), 0), dtype=np.int64),
            np.zeros((len(point), 1, 0)),
            by_point,
            (away[point, axis] * weight)[:, None],
        )


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
    """

    groups: tuple[Observations, ...]
    blocks: IntArray
    moving: BoolArray

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
        """Observed components less unknowns."""
        return sum(group.misclosure.size for group in self.groups) - self.unknowns

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
    def _normals(self) -> NormalEquations:
        return NormalEquations.of(self.design)

    def step(self, damping: float = 0.0) -> FloatArray:
        """Changes of the unknowns that minimise |w − A·dx|² + damping · |L·dx|², L the lengths of the columns."""
        return self._normals.damped(damping).solve(self.design.T @ self.misclosure)

    def residuals(self, step: FloatArray) -> FloatArray:
        """Whitened residuals (R,) after a step."""
        left: FloatArray = self.misclosure - self.design @ step
        return left

    def condition(self) -> tuple[float, FloatArray]:
        """Condition number of the design with columns of unit length, and the direction determined worst."""
        return self._normals.condition() if self.unknowns else (1.0, np.zeros(0))

    def solve(self, right: FloatArray) -> FloatArray:
        """Cofactors of the unknowns times right-hand sides (unknowns,) or (unknowns, M)."""
        return self._normals.solve(right)

    @cached_property
    def undetermined_points(self) -> IntArray:
        """Points whose moving coordinates their observations do not determine: one ray, parallel rays, none."""
        normal = np.zeros((len(self.moving), self.moving.shape[1], self.moving.shape[1]))
        for group in self.groups:
            seen = group.point >= 0
            by = group.by_point[seen] * self.moving[group.point[seen], None, :]
            np.add.at(normal, group.point[seen], np.swapaxes(by, 1, 2) @ by)
        axis = np.arange(self.moving.shape[1])
        normal[:, axis, axis] = np.where(self.moving, normal[:, axis, axis], 1.0)
        length = np.sqrt(np.where(normal[:, axis, axis] > 0.0, normal[:, axis, axis], 1.0))
        least = np.linalg.eigvalsh(normal / (length[:, :, None] * length[:, None, :]))[:, 0]
        return np.flatnonzero(~(least > UNDETERMINED))

    def parameter_cofactors(self) -> FloatArray:
        """Cofactors (U, U) of all parameters."""
        found = self._columns_of_cofactors(np.arange(self.parameters))[: self.parameters]
        return (found + found.T) / 2.0

    def cofactors_of(self, pairs: Iterable[tuple[int, int]]) -> dict[tuple[int, int], FloatArray]:
        """Cofactors of the parameters of two blocks each, by the pair of their numbers."""
        every, at = self.parameter_cofactors(), self.blocks
        return {(a, b): every[at[a] : at[a + 1], at[b] : at[b + 1]] for a, b in pairs}

    def point_cofactors(self) -> FloatArray:
        """Cofactors (S, D, D) of each point's coordinates; 0 for those that are held."""
        found = np.zeros((*self.place.shape, self.place.shape[1]))
        point, axis = np.nonzero(self.moving)
        for first in range(0, len(point), CHUNK):
            p, k = point[first : first + CHUNK], axis[first : first + CHUNK]
            solved, at = self._columns_of_cofactors(self.place[p, k]), self.place[p]
            found[p, :, k] = np.where(at >= 0, solved[at, np.arange(len(p))[:, None]], 0.0)
        return found

    def redundancy_numbers(self) -> tuple[FloatArray, ...]:
        """Redundancy numbers I − A·Q·Aᵀ (N, K, K) of each group's observations; their traces sum to the redundancy."""
        found, first = [], 0
        for group in self.groups:
            count, size = group.misclosure.shape
            share = np.zeros((count, size, size))
            for start in range(0, count, CHUNK):
                part = np.arange(start, min(start + CHUNK, count))
                rows = self.design[first + size * start : first + size * (part[-1] + 1)].toarray()
                known = (rows @ self.solve(rows.T)).reshape(len(part), size, len(part), size)
                each = np.arange(len(part))
                share[part] = np.eye(size) - known[each, :, each, :]
            found.append(share)
            first += count * size
        return tuple(found)

    def _columns_of_cofactors(self, columns: IntArray) -> FloatArray:
        unit = np.zeros((self.unknowns, len(columns)))
        unit[columns, np.arange(len(columns))] = 1.0
        return self.solve(unit)
