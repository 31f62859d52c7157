"""Delaunay triangles of points in the plane, and the triangle in which a place lies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay, cKDTree

from geomosaic.types import AnyArray, FloatArray

# Rounding of a product of coordinate differences, relative.
ROUNDING = 1e-15


@dataclass(frozen=True, eq=False)
class Triangulation:
    """Delaunay triangles.

    Attributes
    ----------
    points : array (N, 2)
    corners : int32 array (T, 3)
        Points at the corners of each triangle, counterclockwise.
    across : int32 array (T, 3)
        Triangles beyond the edges that face these corners; -1 beyond the hull.
    at_cell : int32 array (C, R)
        A triangle in or near each cell of a lattice of about as many cells as points, by columns of x.
    low : array (2,)
        Lower left corner of the lattice.
    side : float
        Of its cells.
    """

    points: FloatArray
    corners: AnyArray
    across: AnyArray
    at_cell: AnyArray
    low: FloatArray
    side: float

    @classmethod
    def of(cls, points: FloatArray) -> Triangulation:
        """Triangles of points (N, 2).

        Parameters
        ----------
        points : array (N, 2)

        Raises
        ------
        scipy.spatial.QhullError
            They lie on one line.
        """
        made = Delaunay(points)
        at_point = np.zeros(len(points), dtype=np.int32)
        at_point[made.coplanar[:, 0]] = made.coplanar[:, 1]  # of points in one place one alone is a corner
        at_point[made.simplices.ravel()] = np.repeat(np.arange(len(made.simplices), dtype=np.int32), 3)
        low, size = points.min(axis=0), np.ptp(points, axis=0)
        side = float(max(np.sqrt(size.prod() / len(points)), size.max() / len(points)))  # of a strip no more cells
        shape = np.floor(size / side).astype(np.int64) + 1
        column, row = np.floor((points - low) / side).astype(np.int64).T
        at_cell = np.full(shape, -1, dtype=np.int32)
        at_cell[column, row] = at_point
        empty = np.argwhere(at_cell < 0)
        at_cell[tuple(empty.T)] = at_point[cKDTree(points).query(low + side * (empty + 0.5))[1]]
        return cls(points, made.simplices, made.neighbors, at_cell, low, side)

    def locate(self, xy: FloatArray) -> tuple[AnyArray, FloatArray]:
        """Triangles (N,) in which places (N, 2) lie, -1 beyond the hull, and weights (N, 3) of their corners.

        A walk from somewhere near, always across an edge that has the place beyond it, cannot come back to a
        triangle of Delaunay's (H. Edelsbrunner: An acyclicity theorem for cell complexes in d dimensions, 1990).

        Parameters
        ----------
        xy : array (N, 2)
        """
        # `take` is several times faster than brackets, and this is what locating places costs.
        column, row = (
            np.clip((xy[:, k] - self.low[k]) / self.side, 0, self.at_cell.shape[k] - 1).astype(np.int64) for k in (0, 1)
        )
        found = self.at_cell.take(column * self.at_cell.shape[1] + row)
        weight, going = np.zeros((len(xy), 3)), np.arange(len(xy))
        while len(going):
            triangle = found.take(going)
            place, corners = xy.take(going, axis=0), self.corners.take(triangle, axis=0)
            off = [self.points.take(corners[:, k], axis=0) - place for k in range(3)]
            # Twice the areas of the edges that face the corners and the place, and what rounding may have done to them.
            area, error = np.empty((3, len(going))), np.empty((3, len(going)))
            for k in range(3):
                one, other = off[k - 2], off[k - 1]
                plus, minus = one[:, 0] * other[:, 1], one[:, 1] * other[:, 0]
                np.subtract(plus, minus, out=area[k])
                np.add(np.abs(plus), np.abs(minus), out=error[k])
            least = (area + ROUNDING * error).argmin(axis=0)
            outside = (area < -ROUNDING * error).any(axis=0)
            there = going[~outside]
            weight[there] = (area[:, ~outside] / area[:, ~outside].sum(axis=0)).T
            going = going[outside]
            following = self.across[triangle[outside], least[outside]]
            found[going] = following
            going = going[following >= 0]
        return found, weight
