"""Observations of a block: what was measured, its misclosure over its standard deviation, and the derivatives.

    image positions      u − f(p, q, X)            p of the image, q of its camera, X the point
    control              X₀ − X                    each axis, or some, with a covariance
    camera positions     C₀ − (C(p) + R(p)ᵀ·a + o + t·d)      a lever arm, o offset and d drift of a strip, t its time
    attitudes            half the rotation left between R₀ and B·R(p), B the boresight
    distances            s − |X₁ − X₂|
    heights              h − z(X), h the DEM's at the same place, or one unknown for all points of a lake
    planes and lines     0 − the distance of a point from a plane or a line with unknown place and direction

All are in the block's frame. A group whitens its rows by the root of its covariances, so that they add up to the sum of
squares.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from geomosaic.estimation.network import Observations
from geomosaic.orientation.block.frame import BlockFrame
from geomosaic.orientation.block.unknowns import BlockState, BlockUnknowns
from geomosaic.sensor.plugin import HasInterior
from geomosaic.sensor.solve import jacobian
from geomosaic.types import BoolArray, FloatArray, IntArray

# Units of the residuals of each kind of observations, by the name of its group; metres otherwise.
UNITS = {"image positions": "px", "attitudes": "deg", "a-priori values": "sigma"}


class Group(ABC):
    """Observations of one kind."""

    name: str
    """As reports name it."""
    of_points: bool = True
    """Whether each is of one point, and drops out with it."""
    components: int = 1
    """Components K of each, where they are of images."""

    @property
    @abstractmethod
    def point(self) -> IntArray:
        """Point (N,) of each; -1 where none, or more than one, takes part."""

    @abstractmethod
    def misclosure(self, state: BlockState, frame: BlockFrame) -> FloatArray:
        """Whitened measured minus computed (N, K), not weighted; NaN where it cannot be computed."""

    @abstractmethod
    def linearised(self, state: BlockState, unknowns: BlockUnknowns, frame: BlockFrame) -> Observations:
        """Linearisation at a state, not weighted."""

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
        return moving[self.point] if self.of_points else np.ones(len(self), dtype=np.bool_)

    @property
    def row_images(self) -> tuple[IntArray, IntArray]:
        """Observations and images, pair by pair, where an observation is of an image."""
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)

    @property
    def row_further(self) -> tuple[IntArray, IntArray]:
        """Observations and groups of further unknowns, pair by pair, where an observation is of such a group."""
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)

    def __len__(self) -> int:
        return len(self.point)


def in_units(group: Group, whitened: FloatArray) -> FloatArray:
    """Residuals of a group in their units; those of a-priori values over their standard deviation.

    Parameters
    ----------
    group : Group
    whitened : array (N, K)
    """
    root, sigma = getattr(group, "root", None), getattr(group, "sigma", None)
    if root is not None:
        found: FloatArray = np.einsum("nij,nj->ni", np.linalg.pinv(root), whitened)
        return found
    return whitened * sigma[:, None] if sigma is not None else whitened


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

    @property
    def point(self) -> IntArray:
        """Point of each (N,); -1 for none."""
        return self.points

    @cached_property
    def slices(self) -> list[tuple[int, slice]]:
        """Rows of each image."""
        if (np.diff(self.image) < 0).any():
            raise ValueError("image positions must be sorted by image")
        images, first = np.unique(self.image, return_index=True)
        ends = [*first[1:].tolist(), len(self.image)]
        return [(int(image), slice(a, b)) for image, a, b in zip(images, first.tolist(), ends, strict=True)]

    @property
    def row_images(self) -> tuple[IntArray, IntArray]:
        """Each image position and its image."""
        return np.arange(len(self)), self.image

    def residuals(self, state: BlockState, frame: BlockFrame) -> FloatArray:
        """Measured minus computed (N, 2), pixels."""
        left = np.empty_like(self.colrow)
        for image, rows, places, _ in self._seen(state, frame):
            left[rows] = self.colrow[rows] - state.models[image].ground_to_image(places)
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
        by_point = np.empty((len(self), 2, 3))
        for image, rows, places, turn in self._seen(state, frame):
            model, own = state.models[image], of_images[image]
            by_own, by_ground = jacobian(model, places)
            count = by_own.shape[2]
            by_parameters[rows, :, :count] = by_own
            if unknowns.camera[image] >= 0 and isinstance(model, HasInterior):
                by_parameters[rows, :, count : len(own)] = model.interior_jacobian(places)
            columns[rows, : len(own)] = own
            np.matmul(by_ground, turn, out=by_point[rows])
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
            self.misclosure(state, frame),
        )

    def _seen(self, state: BlockState, frame: BlockFrame) -> list[tuple[int, slice, FloatArray, FloatArray]]:
        """Image, rows, places of its points in the CRS of its model, and derivatives of these."""
        found = []
        for crs in {state.models[image].crs: None for image, _ in self.slices}:
            mine = [(image, rows) for image, rows in self.slices if state.models[image].crs == crs]
            places, turn = frame.to_crs(crs, state.points)
            for image, rows in mine:
                which = self.points[rows]
                found.append((image, rows, places[which], turn if len(turn) == 1 else turn[which]))
        return found


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
    def point(self) -> IntArray:
        """Point of each (N,); -1 for none."""
        return self.points

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
        return _of_points(self.points, self.root, self.misclosure(state, frame), unknowns)


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

    @property
    def point(self) -> IntArray:
        """Point of each (N,); -1 for none."""
        return self.points

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
        return _of_points(self.points, root, (-above / self.sigma)[:, None], unknowns)


@dataclass(frozen=True, eq=False)
class CommonHeights(Group):
    """Points at one unknown height, such as shores of a lake.

    Attributes
    ----------
    points : int array (N,)
    lake : int array (N,)
        Group of further unknowns that has its height in the CRS of the ground.
    sigma : array (N,)
        Metres.
    """

    points: IntArray
    lake: IntArray
    sigma: FloatArray
    name = "common heights"

    @property
    def row_further(self) -> tuple[IntArray, IntArray]:
        """Each height and its lake; see `Group`."""
        return np.arange(len(self)), self.lake

    @property
    def point(self) -> IntArray:
        """Point of each (N,); -1 for none."""
        return self.points

    def misclosure(self, state: BlockState, frame: BlockFrame) -> FloatArray:
        """Whitened misclosures (N, K); see `Group`."""
        height = frame.to_ground(state.points[self.points])[:, 2]
        level = np.array([state.further[each][0] for each in self.lake.tolist()])
        return ((level - height) / self.sigma)[:, None]

    def linearised(self, state: BlockState, unknowns: BlockUnknowns, frame: BlockFrame) -> Observations:
        """Linearisation at a state; see `Group`."""
        slope = frame.axes_of_ground(state.points[self.points])[:, 2:3, :]
        found = _of_points(self.points, slope / self.sigma[:, None, None], self.misclosure(state, frame), unknowns)
        own = np.array([unknowns.of_further(each) for each in self.lake.tolist()]).reshape(-1, 1)
        return Observations(
            found.point,
            np.hstack([own, found.columns]),
            np.concatenate([-1.0 / self.sigma[:, None, None], found.by_parameters], axis=2),
            found.by_point,
            found.misclosure,
        )


@dataclass(frozen=True, eq=False)
class Distances(Group):
    """Distances between points; the points are kept among the parameters.

    Attributes
    ----------
    first, second : int array (N,)
    length, sigma : array (N,)
        Metres.
    """

    first: IntArray
    second: IntArray
    length: FloatArray
    sigma: FloatArray
    name = "distances"
    of_points = False

    @property
    def point(self) -> IntArray:
        """Point of each (N,); -1 for none."""
        return np.full(len(self.first), -1)

    def placed(self, moving: BoolArray) -> BoolArray:
        """Distances (N,) whose ends both have a place; see `Group`."""
        return moving[self.first] & moving[self.second]

    def _between(self, state: BlockState) -> tuple[FloatArray, FloatArray]:
        apart = state.points[self.second] - state.points[self.first]
        length = np.linalg.norm(apart, axis=1)
        return length, apart / length[:, None]

    def misclosure(self, state: BlockState, frame: BlockFrame) -> FloatArray:
        """Whitened misclosures (N, K); see `Group`."""
        return ((self.length - self._between(state)[0]) / self.sigma)[:, None]

    def linearised(self, state: BlockState, unknowns: BlockUnknowns, frame: BlockFrame) -> Observations:
        """Linearisation at a state; see `Group`."""
        _, along = self._between(state)
        kept, none = unknowns.kept_columns, np.full(3, -1)
        pairs = zip(self.first.tolist(), self.second.tolist(), strict=True)
        ends = [np.concatenate([kept.get(a, none), kept.get(b, none)]) for a, b in pairs]
        by_ends = np.hstack([-along, along]) / self.sigma[:, None]
        return Observations(
            self.point,
            np.array(ends).reshape(-1, 6),
            by_ends[:, None, :],
            np.zeros((len(self), 1, 3)),
            self.misclosure(state, frame),
        )


@dataclass(frozen=True, eq=False)
class OnSurfaces(Group):
    """Points on planes (2 further unknowns of direction, 1 of place) or lines (2 and 2).

    A plane has the normal n + a·e₁ + b·e₂ and the offset c: n·(X − X₀) = c. A line has the direction n + a·e₁ + b·e₂
    through X₀ + c·e₁ + d·e₂. The axes (e₁, e₂, n) and X₀ are those of a first fit.

    Attributes
    ----------
    points : int array (N,)
    body : int array (N,)
        Group of further unknowns of each point's plane or line.
    axes : array (N, 3, 3)
        Rows e₁, e₂, n of each point's plane or line.
    origin : array (N, 3)
        Its X₀.
    sigma : array (N,)
        Metres.
    lines : bool
        Whether all are lines.
    """

    points: IntArray
    body: IntArray
    axes: FloatArray
    origin: FloatArray
    sigma: FloatArray
    lines: bool

    @property
    def name(self) -> str:  # type: ignore[override]
        """As reports name it."""
        return "points on lines" if self.lines else "points on planes"

    @property
    def row_further(self) -> tuple[IntArray, IntArray]:
        """Each point and its plane or line; see `Group`."""
        return np.arange(len(self)), self.body

    @property
    def point(self) -> IntArray:
        """Point of each (N,); -1 for none."""
        return self.points

    def _values(self, state: BlockState) -> FloatArray:
        return np.array([state.further[each] for each in self.body.tolist()])

    def _computed(self, state: BlockState) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Distances (N, K), their derivatives by the further unknowns (N, K, Q) and by the point (N, K, 3)."""
        p = self._values(state)
        local = np.einsum("nij,nj->ni", self.axes, state.points[self.points] - self.origin)
        u, v, w = local.T
        a, b, c = p[:, 0], p[:, 1], p[:, 2]
        zero, one = np.zeros_like(a), np.ones_like(a)
        if self.lines:
            off = np.stack([u - c - a * w, v - p[:, 3] - b * w], axis=1)
            by_own = np.stack(
                [np.stack([-w, zero, -one, zero], axis=1), np.stack([zero, -w, zero, -one], axis=1)], axis=1
            )
            by_local = np.stack([np.stack([one, zero, -a], axis=1), np.stack([zero, one, -b], axis=1)], axis=1)
        else:
            off = (w + a * u + b * v - c)[:, None]
            by_own = np.stack([u, v, -one], axis=1)[:, None, :]
            by_local = np.stack([a, b, one], axis=1)[:, None, :]
        return off, by_own, by_local @ self.axes

    def misclosure(self, state: BlockState, frame: BlockFrame) -> FloatArray:
        """Whitened misclosures (N, K); see `Group`."""
        return -self._computed(state)[0] / self.sigma[:, None]

    def linearised(self, state: BlockState, unknowns: BlockUnknowns, frame: BlockFrame) -> Observations:
        """Linearisation at a state; see `Group`."""
        off, by_own, by_point = self._computed(state)
        over = self.sigma[:, None, None]
        found = _of_points(self.points, by_point / over, -off / self.sigma[:, None], unknowns)
        own = np.array([unknowns.of_further(each) for each in self.body.tolist()])
        return Observations(
            found.point,
            np.hstack([own, found.columns]),
            np.concatenate([by_own / over, found.by_parameters], axis=2),
            found.by_point,
            found.misclosure,
        )


def _of_points(points: IntArray, root: FloatArray, misclosure: FloatArray, unknowns: BlockUnknowns) -> Observations:
    """Observations of coordinates alone: `root` (N, K, 3) are their whitened derivatives."""
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
