"""Whitened observations of a block, linearised: of parameters that images share, and of object points."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.types import FloatArray, IntArray


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

    def contiguous(self) -> Observations:
        """The same in arrays without gaps, of the types that kernels take."""
        return Observations(
            np.ascontiguousarray(self.point, dtype=np.int64),
            np.ascontiguousarray(self.columns, dtype=np.int64),
            np.ascontiguousarray(self.by_parameters, dtype=np.float64),
            np.ascontiguousarray(self.by_point, dtype=np.float64),
            np.ascontiguousarray(self.misclosure, dtype=np.float64),
        )
