"""Linearised network of image positions: photos with parameters, points with coordinates, both unknown.

    v = e − A·dp − G·dX        image positions: e measured minus computed, p the photo's parameters, X the point
    v = g − dX                 given coordinates that are uncertain themselves; certain ones have no dX
    v = h − dp                 a-priori values of parameters

The points stay unknowns. A sparse factorisation takes them first, which is their elimination point by point.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomosaic.estimation.equations import Equations
from geomosaic.types import BoolArray, FloatArray, IntArray

CHUNK = 512
"""Right-hand sides solved at a time: bounds the memory."""


@dataclass(frozen=True, eq=False)
class Network:
    """Linearised network of N image positions of S points, with U parameters of photos.

    Attributes
    ----------
    point : int array (N,)
    columns : int array (N, P)
        Unknown of each parameter of the photo; -1 for what is held, and where a photo has fewer.
    by_parameters : array (N, 2, P)
        Derivatives of (col, row) by the photo's parameters.
    by_point : array (N, 2, 2)
        Derivatives of (col, row) by the point's x and y.
    errors : array (N, 2)
        Measured minus computed, pixels.
    sigma : array (N,)
        Standard deviations, pixels.
    given : array (S, 2)
        Given less present coordinates of the points; 0 where none are given.
    given_sigma : array (S,)
        Their standard deviations: 0 held, inf unknown.
    priors, from_priors : array (U,)
        A-priori standard deviations of the parameters (inf for none), and a-priori less present values.
    """

    point: IntArray
    columns: IntArray
    by_parameters: FloatArray
    by_point: FloatArray
    errors: FloatArray
    sigma: FloatArray
    given: FloatArray
    given_sigma: FloatArray
    priors: FloatArray
    from_priors: FloatArray

    @property
    def unknowns(self) -> int:
        """Parameters of all photos."""
        return len(self.priors)

    @cached_property
    def moving(self) -> BoolArray:
        """Which points (S,) have unknown coordinates."""
        free: BoolArray = self.given_sigma > 0.0
        return free

    @cached_property
    def observed(self) -> IntArray:
        """Points whose uncertain coordinates are observations."""
        return np.flatnonzero(self.moving & np.isfinite(self.given_sigma))

    @cached_property
    def place(self) -> IntArray:
        """First unknown (S,) of each point; meaningless for those that are held."""
        first: IntArray = self.unknowns + 2 * (np.cumsum(self.moving) - 1)
        return first

    @cached_property
    def equations(self) -> Equations:
        """Sparse equations of all unknowns; rows are image positions, given coordinates, a-priori values."""
        from scipy.sparse import coo_array

        count, weight = len(self.point), 1.0 / self.sigma[:, None, None]
        own = np.broadcast_to(2 * np.arange(count)[:, None, None] + np.array([[0], [1]]), self.by_parameters.shape)
        there = np.broadcast_to(self.columns[:, None, :], self.by_parameters.shape)
        used = there >= 0
        free = self.moving[self.point]
        at = 2 * np.flatnonzero(free)[:, None, None] + np.array([[0], [1]])
        place = self.place[self.point[free]][:, None, None] + np.array([[0, 1]])
        shape = (len(at), 2, 2)
        known = np.repeat(1.0 / self.given_sigma[self.observed], 2)
        start = 2 * count + np.arange(len(known))
        prior = np.flatnonzero(np.isfinite(self.priors))
        rows = [own[used], np.broadcast_to(at, shape).ravel(), start, 2 * count + len(known) + np.arange(len(prior))]
        to = (self.place[self.observed][:, None] + [0, 1]).ravel()
        cols = [there[used], np.broadcast_to(place, shape).ravel(), to, prior]
        data = [(self.by_parameters * weight)[used], (self.by_point * weight)[free].ravel(), known]
        entries = np.concatenate([*data, 1.0 / self.priors[prior]])
        size = (2 * count + len(known) + len(prior), self.unknowns + 2 * int(self.moving.sum()))
        design = coo_array((entries, (np.concatenate(rows), np.concatenate(cols))), shape=size).tocsr()
        return Equations(design, self._misclosure())

    def _misclosure(self) -> FloatArray:
        prior = np.isfinite(self.priors)
        given = self.given[self.observed] / self.given_sigma[self.observed, None]
        views = self.errors / self.sigma[:, None]
        return np.concatenate([views.ravel(), given.ravel(), self.from_priors[prior] / self.priors[prior]])

    def cofactors(self) -> tuple[FloatArray, FloatArray]:
        """Cofactors of the parameters (U, U), and of x and y of each point (S, 2, 2), 0 for those that are held."""
        size, count = self.equations.design.shape[1], self.unknowns
        parameters, points = np.zeros((count, count)), np.zeros((int(self.moving.sum()), 2, 2))
        for first in range(0, size, CHUNK):
            own = np.arange(first, min(first + CHUNK, size))
            unit = np.zeros((size, len(own)))
            unit[own, np.arange(len(own))] = 1.0
            solved = self.equations.normals.solve(unit)
            inner = own < count
            parameters[:, own[inner]] = solved[:count, inner]
            place, axis = np.divmod(own[~inner] - count, 2)
            for k in (0, 1):
                points[place, k, axis] = solved[count + 2 * place + k, np.flatnonzero(~inner)]
        whole = np.zeros((len(self.moving), 2, 2))
        whole[self.moving] = points
        return (parameters + parameters.T) / 2.0, whole
