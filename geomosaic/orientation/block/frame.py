"""Cartesian frame in which a block is adjusted, and its derivatives to the frames of sensor models."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from pyproj import CRS

from geomosaic.geo.crs import in_space, is_local
from geomosaic.geo.local_frames import LocalFrame
from geomosaic.geo.transform import Transform
from geomosaic.types import FloatArray

# Metres over which transformations are differenced: their curvature there is 1e-12 of the derivative, rounding 1e-10.
STEP = 10.0


@dataclass(frozen=True, eq=False)
class BlockFrame:
    """East, north and up at the middle of a block, or the axes of a CRS that has no place on the Earth.

    Attributes
    ----------
    local : LocalFrame
        Over geocentric axes, or over those of the CRS without a place.
    ground : CRS
        3-D CRS of control and camera positions.
    """

    local: LocalFrame
    ground: CRS

    @classmethod
    def at(cls, ground: CRS, xyz: FloatArray) -> BlockFrame:
        """Frame of a block.

        Parameters
        ----------
        ground : CRS
            3-D CRS of control and camera positions.
        xyz : array (N, 3)
            Some places of the block in it, such as camera positions or control points.
        """
        middle = np.nanmean(np.asarray(xyz, dtype=np.float64), axis=0)
        if is_local(ground):
            return cls(LocalFrame(ground, middle, np.eye(3)), ground)
        return cls(LocalFrame.at(ground, middle), ground)

    @cached_property
    def _of_ground(self) -> Transform:
        return Transform(self.ground, self.local.crs)

    def from_ground(self, xyz: FloatArray) -> FloatArray:
        """Places (N, 3) in the CRS of the ground to this frame."""
        return self.local.to_enu(self._of_ground(np.asarray(xyz, dtype=np.float64)))

    def to_ground(self, xyz: FloatArray) -> FloatArray:
        """Places (N, 3) in this frame to the CRS of the ground."""
        return self._of_ground.inverse()(self.local.to_geocentric(xyz))

    def from_crs(self, crs: CRS, xyz: FloatArray) -> FloatArray:
        """Places (N, 3) in a CRS to this frame."""
        return self.local.to_enu(Transform(in_space(crs), self.local.crs)(np.asarray(xyz, dtype=np.float64)))

    def places(self, crs: CRS, xyz: FloatArray) -> FloatArray:
        """Places (N, 3) in this frame to a CRS."""
        points = self.local.to_geocentric(xyz)
        return points if crs == self.local.crs else Transform(self.local.crs, in_space(crs))(points)

    def axes_of_ground(self, xyz: FloatArray) -> FloatArray:
        """Derivatives (N, 3, 3) of ground coordinates by this frame's, at places (N, 3) of this frame."""
        return self.to_crs(self.ground, xyz)[1]

    def to_crs(self, crs: CRS, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Places in a CRS, and their derivatives.

        Parameters
        ----------
        crs : CRS
            Of a sensor model, for example; a horizontal one gets heights, which its model ignores.
        xyz : array (N, 3)
            In this frame.

        Returns
        -------
        places : array (N, 3)
        derivatives : array (N, 3, 3) or (1, 3, 3)
            Units of `crs` per metre along this frame's axes; one matrix where it is the same everywhere.
        """
        points = self.local.to_geocentric(xyz)
        if crs == self.local.crs:
            return points, self.local.axes.T[None]
        transform = Transform(self.local.crs, in_space(crs))
        derivatives = np.empty((len(points), 3, 3))
        for axis in range(3):
            change = 0.5 * STEP * self.local.axes[axis]
            derivatives[:, :, axis] = (transform(points + change) - transform(points - change)) / STEP
        return transform(points), derivatives
