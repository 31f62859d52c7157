"""Observations of a block: what was measured, its misclosure over its standard deviation, and the derivatives.

    image positions      u − f(p, q, X)            p of the image, q of its camera, X the point
    control              X₀ − X                    each axis, or some, with a covariance
    heights              h − z(X), h the DEM's at the same place

What points have in common stands in `object_constraints.py`, what cameras measure of themselves in `poses.py`. All are
in the block's frame. A group whitens its rows by the root of its covariances, so they add up to the sum of squares.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, cast

import numpy as np
from pyproj import CRS

from geomosaic.estimation.network import Observations
from geomosaic.orientation.block.frame import BlockFrame
from geomosaic.orientation.block.unknowns import BlockState, BlockUnknowns
from geomosaic.sensor.plugin import HasInterior
from geomosaic.sensor.solve import jacobian
from geomosaic.types import BoolArray, FloatArray, IntArray

# Units of the residuals of each kind of observations, by the name of its group; metres otherwise.
UNITS = {"image positions": "px", "attitudes": "deg", "relative attitudes": "deg", "a-priori values": "sigma"}


class Group(ABC):
    """Observations of one kind."""

    name: str
    """As reports name it."""
    of_points: bool = True
    """Whether each is of one point, and drops out with it."""
    components: int = 1
    """Components K of each, where they are of images."""
    further_units: tuple[str, ...] = ()
    """Units of the unknowns of each group of further ones."""
    points: IntArray
    """Point (N,) of each; -1 where none, or more than one, takes part."""

    @abstractmethod
    def misclosure(self, state: BlockState, frame: BlockFrame) -> FloatArray:
        """Whitened measured minus computed (N, K), not weighted; NaN where it cannot be computed."""

    @abstractmethod
    def linearised(self, state: BlockState, unknowns: BlockUnknowns, frame: BlockFrame) -> Observations:
        """Linearisation at a state, not weighted.

        Parameters
        ----------
        state : BlockState
        unknowns : BlockUnknowns
        frame : BlockFrame
            In which points and poses are Cartesian, metres.
        """

    @property
    def observed(self) -> BoolArray:
        """Components (N, K) that were observed; True unless a group says otherwise."""
        return np.ones((len(self), 1), dtype=np.bool_)

    def touches(self, images: BoolArray) -> BoolArray:
        """Observations (N,) that are of one of some images (M,)."""
        row, image = self.row_images
        found = np.zeros(len(self), dtype=np.bool_)
        np.logical_or.at(found, row, images[image])
        return found

    def placed(self, moving: BoolArray) -> BoolArray:
        """Observations (N,) whose points all have a place, of points (S,) that have one."""
        return moving[self.points] if self.of_points else np.ones(len(self), dtype=np.bool_)

    @property
    def row_points(self) -> tuple[IntArray, IntArray]:
        """Observations and points, pair by pair, where an observation is of a point or joins two."""
        there = np.flatnonzero(self.points >= 0)
        return there, self.points[there]

    @property
    def row_images(self) -> tuple[IntArray, IntArray]:
        """Observations and images, pair by pair, where an observation is of an image."""
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)

    @property
    def row_further(self) -> tuple[IntArray, IntArray]:
        """Observations and groups of further unknowns, pair by pair, where an observation is of such a group."""
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)

    def meaning(self, state: BlockState, frame: BlockFrame) -> dict[int, dict[str, list[float]]]:
        """What groups of further unknowns are, where their values do not say it: by their numbers, each with a name."""
        return {}

    def __len__(self) -> int:
        return len(self.points)


def unit_matrices(group: Group, components: int) -> FloatArray:
    """Matrices (N, K, K) that bring whitened errors of a group to its unit; a-priori values stay over their sigma.

    Parameters
    ----------
    group : Group
    components : int
        K.
    """
    root, sigma = getattr(group, "root", None), getattr(group, "sigma", None)
    if root is not None:
        return np.linalg.pinv(root)
    return np.eye(components) * (np.ones(len(group)) if sigma is None else sigma)[:, None, None]


def whitening_of(group: Group) -> FloatArray:
    """Matrices (N, K, K) that bring errors of a group, in its unit, over their standard deviations.

    Parameters
    ----------
    group : Group
        With `root` or `sigma`.
    """
    root: FloatArray | None = getattr(group, "root", None)
    return root if root is not None else 1.0 / cast(Any, group).sigma[:, None, None]


def rescaled(group: Group, factor: float | FloatArray) -> Group:
    """Group with standard deviations times a factor.

    Parameters
    ----------
    group : Group
        With `root` or `sigma`.
    factor : float or array (N,)
    """
    own = cast(Any, group)
    if hasattr(group, "root"):
        return cast(Group, replace(own, root=own.root / np.reshape(factor, (-1, 1, 1))))
    return cast(Group, replace(own, sigma=own.sigma * factor))


def in_units(group: Group, whitened: FloatArray) -> FloatArray:
    """Residuals of a group in its unit, see `unit_matrices`.

    Parameters
    ----------
    group : Group
    whitened : array (N, K)
    """
    found: FloatArray = np.einsum("nij,nj->ni", unit_matrices(group, whitened.shape[1]), whitened)
    return found


def whitening(covariance: FloatArray) -> FloatArray:
    """Whitening matrices W (N, K, K) of covariances (N, K, K), WᵀW being their inverses.

    Parameters
    ----------
    covariance : array (N, K, K)
        An infinite variance on the diagonal says that this component was not observed: its rows are zero.
    """
    known = np.isfinite(np.diagonal(covariance, axis1=1, axis2=2))
    both = known[:, :, None] & known[:, None, :]
    whole = np.where(both, covariance, np.eye(covariance.shape[1]))
    root = np.linalg.inv(np.linalg.cholesky(whole))
    return np.where(both, root, 0.0)


def slices_of(image: IntArray) -> list[tuple[int, slice]]:
    """Images of some rows, and where the rows of each stand.

    Parameters
    ----------
    image : int array (N,)
        Image of each row, ascending.
    """
    images, first = np.unique(image, return_index=True)
    ends = [*first[1:].tolist(), len(image)]
    return [(int(own), slice(a, b)) for own, a, b in zip(images, first.tolist(), ends[: len(images)], strict=True)]


@dataclass(frozen=True, eq=False)
class ImagePositions(Group):
    """Image positions of points, sorted by image.

    Attributes
    ----------
    image, points : int array (N,)
    colrow : array (N, 2)
        Pixels.
    root : array (N, 2, 2)
        Whitening matrices.
    """

    image: IntArray
    points: IntArray
    colrow: FloatArray
    root: FloatArray
    name = "image positions"
    components = 2

    @cached_property
    def slices(self) -> list[tuple[int, slice]]:
        """Rows of each image."""
        if (np.diff(self.image) < 0).any():
            raise ValueError("image positions must be sorted by image")
        return slices_of(self.image)

    def slice_of(self, image: int) -> slice:
        """Rows of an image; none where it shows no point."""
        first, end = np.searchsorted(self.image, [image, image + 1])
        return slice(int(first), int(end))

    @property
    def row_images(self) -> tuple[IntArray, IntArray]:
        """Each image position and its image."""
        return np.arange(len(self)), self.image

    def residuals(self, state: BlockState, frame: BlockFrame) -> FloatArray:
        """Measured minus computed (N, 2), pixels."""
        left = np.empty_like(self.colrow)
        for crs, mine in self._by_crs(state):
            places = frame.places(crs, state.points)
            for image, rows in mine:
                left[rows] = self.colrow[rows] - state.models[image].ground_to_image(places[self.points[rows]])
        return left

    def misclosure(self, state: BlockState, frame: BlockFrame) -> FloatArray:
        """Whitened misclosures (N, K); see `Group`."""
        return _whitened(self.root, self.residuals(state, frame))

    def linearised(self, state: BlockState, unknowns: BlockUnknowns, frame: BlockFrame) -> Observations:
        """Linearisation at a state; see `Group`."""
        of_images = [unknowns.of_image(image) for image in range(len(state.models))]
        width = max((len(each) for each in of_images), default=0)
        kept = unknowns.kept_columns
        extra = 3 if kept else 0
        columns = np.full((len(self), width + extra), -1)
        by_parameters = np.zeros((len(self), 2, width + extra))
        by_point, left = np.empty((len(self), 2, 3)), np.empty_like(self.colrow)
        for crs, mine in self._by_crs(state):
            everywhere, turns = frame.to_crs(crs, state.points)
            for image, rows in mine:
                model, own, which = state.models[image], of_images[image], self.points[rows]
                places = everywhere[which]
                left[rows] = self.colrow[rows] - model.ground_to_image(places)
                by_own, by_ground = jacobian(model, places)
                count = by_own.shape[2]
                by_parameters[rows, :, :count] = by_own
                if unknowns.camera[image] >= 0 and isinstance(model, HasInterior):
                    by_parameters[rows, :, count : len(own)] = model.interior_jacobian(places)
                columns[rows, : len(own)] = own
                np.matmul(by_ground, turns if len(turns) == 1 else turns[which], out=by_point[rows])
        point = self.points
        if kept:
            moved = np.flatnonzero(np.isin(point, unknowns.kept))
            columns[moved, width:] = np.array([kept[each] for each in point[moved].tolist()]).reshape(-1, 3)
            by_parameters[moved, :, width:] = by_point[moved]
            by_point[moved] = 0.0
            point = np.where(np.isin(point, unknowns.kept), -1, point)
        return Observations(
            point,
            columns,
            _whitened_matrix(self.root, by_parameters),
            _whitened_matrix(self.root, by_point),
            _whitened(self.root, left),
        )

    def _by_crs(self, state: BlockState) -> list[tuple[CRS, list[tuple[int, slice]]]]:
        """Images and their rows, by the CRS of their models, so that all points are transformed once to each."""
        found: dict[CRS, list[tuple[int, slice]]] = {}
        # A CRS is compared by its text, which takes a tenth of an adjustment: most images share one object.
        same: dict[int, list[tuple[int, slice]]] = {}
        for image, rows in self.slices:
            crs = state.models[image].crs
            if id(crs) not in same:
                same[id(crs)] = found.setdefault(crs, [])
            same[id(crs)].append((image, rows))
        return list(found.items())

    def by_coordinates(self, found: Observations, unknowns: BlockUnknowns) -> FloatArray:
        """Derivatives (N, 2, 3) of a linearisation by the coordinates of all points, kept ones too."""
        kept = np.isin(self.points, unknowns.kept)
        by_point = found.by_point.copy()
        if kept.any():
            by_point[kept] = found.by_parameters[kept][:, :, -3:]
        return by_point


@dataclass(frozen=True, eq=False)
class GroundControl(Group):
    """Given coordinates of points.

    Attributes
    ----------
    points : int array (N,)
    xyz : array (N, 3)
        In the block's frame.
    root : array (N, 3, 3)
        Whitening matrices, from the block's axes; rows of zeros for axes that are not given.
    """

    points: IntArray
    xyz: FloatArray
    root: FloatArray
    name = "control"

    @property
    def observed(self) -> BoolArray:
        """Components (N, K) that were given."""
        given: BoolArray = (self.root != 0.0).any(axis=2)
        return given

    def misclosure(self, state: BlockState, frame: BlockFrame) -> FloatArray:
        """Whitened misclosures (N, K); see `Group`."""
        return _whitened(self.root, self.xyz - state.points[self.points])

    def linearised(self, state: BlockState, unknowns: BlockUnknowns, frame: BlockFrame) -> Observations:
        """Linearisation at a state; see `Group`."""
        return of_coordinates(self.points, self.root, self.misclosure(state, frame), unknowns)


@dataclass(frozen=True, eq=False)
class SurfaceHeights(Group):
    """Heights of a DEM as observations of the points above it.

    Attributes
    ----------
    points : int array (N,)
    sigma : array (N,)
        Of the DEM's heights, metres.
    surface : function of places (N, 3)
        Metres (N,) by which the places lie above the surface, and the derivative (N, 3) of that, both in the block's
        frame; NaN where there is no height.
    """

    points: IntArray
    sigma: FloatArray
    surface: Callable[[FloatArray], tuple[FloatArray, FloatArray]]
    name = "heights of the DEM"

    def misclosure(self, state: BlockState, frame: BlockFrame) -> FloatArray:
        """Whitened misclosures (N, K); see `Group`."""
        above, slope = self.surface(state.points[self.points])
        # Beside a gap of the DEM there is a height and no slope.
        known = np.isfinite(slope).all(axis=1)
        return np.where(known, -above / self.sigma, np.nan)[:, None]

    def linearised(self, state: BlockState, unknowns: BlockUnknowns, frame: BlockFrame) -> Observations:
        """Linearisation at a state; see `Group`."""
        above, slope = self.surface(state.points[self.points])
        root = (slope / self.sigma[:, None])[:, None, :]
        return of_coordinates(self.points, root, (-above / self.sigma)[:, None], unknowns)


def of_coordinates(points: IntArray, root: FloatArray, misclosure: FloatArray, unknowns: BlockUnknowns) -> Observations:
    """Observations of coordinates alone.

    Parameters
    ----------
    points : int array (N,)
    root : array (N, K, 3)
        Their whitened derivatives by the coordinates.
    misclosure : array (N, K)
        Whitened.
    unknowns : BlockUnknowns
    """
    kept = unknowns.kept_columns
    mine = np.isin(points, unknowns.kept)
    columns = np.full((len(points), 3 if kept else 0), -1)
    by_parameters = np.zeros((*root.shape[:2], columns.shape[1]))
    by_point = root
    if kept:
        columns[mine] = np.array([kept[each] for each in points[mine].tolist()]).reshape(-1, 3)
        by_parameters[mine] = root[mine]
        by_point = np.where(mine[:, None, None], 0.0, root)
    return Observations(np.where(mine, -1, points), columns, by_parameters, by_point, misclosure)


def _whitened(root: FloatArray, errors: FloatArray) -> FloatArray:
    whitened: FloatArray = np.matmul(root, errors[:, :, None])[:, :, 0]
    return whitened


def _whitened_matrix(root: FloatArray, matrix: FloatArray) -> FloatArray:
    # Two rows: written out, as thousands of small matrix products cost more than these sums.
    out = np.empty_like(matrix)
    for row in range(2):
        np.multiply(matrix[:, 0], root[:, row, 0, None], out=out[:, row])
        out[:, row] += matrix[:, 1] * root[:, row, 1, None]
    return out
