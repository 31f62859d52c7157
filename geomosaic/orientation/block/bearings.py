"""Directions in which images of a block see its points, and their poses, before there is any datum.

The start of a block knows no sensor: an image position is a unit vector in camera axes, and the angle of a pixel there.
Misclosures are the two components across the measured direction, in pixels, so that any field of view is good.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from geomosaic.orientation.block.triangulation import Rays, finite
from geomosaic.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Bearings:
    """Directions to points.

    Attributes
    ----------
    image, point : int array (N,)
    direction : array (N, 3)
        Unit vectors in camera axes.
    angle : array (N,)
        Angle of a pixel in radians.
    """

    image: IntArray
    point: IntArray
    direction: FloatArray
    angle: FloatArray

    def __len__(self) -> int:
        return len(self.image)

    def select(self, rows: BoolArray | IntArray) -> Bearings:
        """Some of them."""
        return Bearings(self.image[rows], self.point[rows], self.direction[rows], self.angle[rows])

    @cached_property
    def across(self) -> FloatArray:
        """Two unit vectors (N, 2, 3) across each direction."""
        # The axis least along the direction gives a product far from zero.
        helper = np.eye(3)[np.argmin(np.abs(self.direction), axis=1)]
        first = np.cross(self.direction, helper)
        first /= np.linalg.norm(first, axis=1)[:, None]
        return np.stack([first, np.cross(self.direction, first)], axis=1)

    def misclosure(self, seen: FloatArray) -> FloatArray:
        """Measured minus computed (N, 2) of vectors in camera axes (N, 3), pixels; NaN for those behind."""
        length = np.linalg.norm(seen, axis=1)
        with np.errstate(invalid="ignore", divide="ignore"):
            off = -np.einsum("nij,nj->ni", self.across, seen) / (length * self.angle)[:, None]
        behind = np.einsum("ni,ni->n", self.direction, seen) <= 0.0
        return np.where(behind[:, None], np.nan, off)

    def derivatives(self, seen: FloatArray) -> FloatArray:
        """Derivatives (N, 2, 3) of the computed components by vectors in camera axes (N, 3)."""
        length = np.linalg.norm(seen, axis=1)
        unit = seen / length[:, None]
        along = np.einsum("nij,nj->ni", self.across, unit)
        by_seen: FloatArray = (self.across - along[:, :, None] * unit[:, None, :]) / (length * self.angle)[
            :, None, None
        ]
        return by_seen


@dataclass(frozen=True, eq=False)
class Poses:
    """Poses of the images of a block, as far as they are known.

    Attributes
    ----------
    centres : array (M, 3)
        Projection centres; NaN where unknown.
    rotations : array (M, 3, 3)
        From the axes of the centres to those of the camera.
    """

    centres: FloatArray
    rotations: FloatArray

    @classmethod
    def unknown(cls, images: int) -> Poses:
        """Poses of none of the images."""
        return cls(np.full((images, 3), np.nan), np.full((images, 3, 3), np.nan))

    @property
    def known(self) -> BoolArray:
        """Images (M,) with a pose."""
        return finite(self.centres)

    def with_pose(self, image: int, centre: FloatArray, rotation: FloatArray) -> Poses:
        """Poses with that of one image.

        Parameters
        ----------
        image : int
            Number of the image.
        centre : array (3,)
        rotation : array (3, 3)
        """
        centres, rotations = self.centres.copy(), self.rotations.copy()
        centres[image], rotations[image] = centre, rotation
        return replace(self, centres=centres, rotations=rotations)

    def without(self, images: BoolArray) -> Poses:
        """Poses without those of some images (M,)."""
        return self.moved(np.where(images[:, None], np.nan, self.centres), self.rotations)

    def moved(self, centres: FloatArray, rotations: FloatArray) -> Poses:
        """Other poses of the same images."""
        return replace(self, centres=centres, rotations=rotations)

    def rays(self, bearings: Bearings) -> Rays:
        """Rays of bearings, in the axes of the centres; NaN for images without a pose."""
        directions = np.einsum("nji,nj->ni", self.rotations[bearings.image], bearings.direction)
        return Rays(self.centres[bearings.image], directions, bearings.point, bearings.angle)

    def seen(self, bearings: Bearings, xyz: FloatArray) -> FloatArray:
        """Vectors (N, 3) in camera axes from the centres to the points (S, 3) of bearings."""
        towards = xyz[bearings.point] - self.centres[bearings.image]
        found: FloatArray = np.einsum("nij,nj->ni", self.rotations[bearings.image], towards)
        return found

    def misses(self, bearings: Bearings, xyz: FloatArray) -> FloatArray:
        """Angles (N,) by which bearings miss their points (S, 3), in pixels; infinite where one is unknown."""
        off = np.hypot(*bearings.misclosure(self.seen(bearings, xyz)).T)
        return np.where(np.isnan(off), np.inf, off)
