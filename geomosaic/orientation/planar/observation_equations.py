"""Observation equations of a planar block in normalised coordinates, after Wolf & Dewitt (9-3), (9-4).

Each point has *views*: its measurements in photos and, where it is control, its ground coordinates. Every pair of views
gives one pair of equations, whose misclosure is the difference of the two positions on the ground:

    photo i, ground      f_i(x_i) − X = 0                (9-3)
    photo i, photo j     f_i(x_i) − f_j(x_j) = 0         (9-4)

The equations of a point in k photos are not independent: 6 pairs among four photos tell no more than 3 do. With weights
w_i·w_j / Σw, where w = 1/σ² of each view's position on the ground, they give the same solution, cofactors and weighted
sum of squares as an adjustment with the point's position as an unknown, since

    Σᵢ w_i |d_i − d̄|² = Σ_{i<j} (w_i·w_j / Σw) |d_i − d_j|²,    d̄ the weighted mean.

Control that is held fixed (σ = 0) has infinite weight: its equations (9-3) have the weights w_i, and pairs of photos
none.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geomosaic.estimation.network import Network, Observations
from geomosaic.orientation.planar import transformations as kinds
from geomosaic.orientation.planar.measurements import PlanarBlock
from geomosaic.orientation.planar.transformations import (
    NAMES,
    Frame,
    PlanarTransform,
    by_parameters,
    by_photo,
    forward,
    half,
    photo_coordinates,
    pixel_sizes,
    reverse,
)
from geomosaic.types import BoolArray, FloatArray, IntArray

# In place of a photo's number: the view is the ground coordinates themselves.
GROUND = -1


@dataclass(frozen=True, eq=False)
class Views:
    """All measurements of a block as arrays, ordered by point.

    Attributes
    ----------
    ids : tuple of str
        Of the points.
    point : array (N,)
        Number of the point of each view.
    photo : array (N,)
        Number of the photo, or GROUND.
    xy : array (N, 2)
        Normalised photo coordinates; for GROUND the map coordinates.
    colrow : array (N, 2)
        Pixels; NaN for GROUND.
    sigma : array (N,)
        In pixels; for GROUND in map units.
    pairs : array (M, 2)
        Views of each pair of equations, the lower number first; GROUND comes second.
    """

    ids: tuple[str, ...]
    point: IntArray
    photo: IntArray
    xy: FloatArray
    colrow: FloatArray
    sigma: FloatArray
    pairs: IntArray

    @property
    def is_ground(self) -> BoolArray:
        """Which views are ground coordinates (N,)."""
        known: BoolArray = self.photo == GROUND
        return known

    @property
    def redundancy_of_points(self) -> int:
        """Independent equations: two for each view of a point but one."""
        seen = np.bincount(self.point, minlength=len(self.ids))
        return int(2 * np.maximum(seen - 1, 0).sum())


def views_of(block: PlanarBlock) -> Views:
    """Views of a planar block: its measurements and control coordinates as arrays, ordered by point.

    Parameters
    ----------
    block : PlanarBlock

    Returns
    -------
    Views
        Points with one view only stay, and give no equation.
    """
    index = block.index
    found: dict[str, list[tuple[int, FloatArray, FloatArray, float]]] = {}
    ground: dict[str, tuple[FloatArray, float]] = {}
    for measured in block.measurements:
        number = index[measured.photo]
        colrow = np.array([[measured.col, measured.row]])
        xy = photo_coordinates(block.photos[number].size, colrow)[0]
        found.setdefault(measured.id, []).append((number, xy, colrow[0], measured.sigma))
    for known in block.control:
        ground[known.id] = (np.array([known.x, known.y]), known.sigma_xy)
    rows: list[tuple[int, int, FloatArray, FloatArray, float]] = []
    pairs: list[tuple[int, int]] = []
    for number, (name, seen) in enumerate(found.items()):
        first = len(rows)
        rows += [(number, *view) for view in sorted(seen, key=lambda view: view[0])]
        if name in ground:
            rows.append((number, GROUND, ground[name][0], np.full(2, np.nan), ground[name][1]))
        fixed = name in ground and ground[name][1] == 0.0
        last = len(rows)
        # The ground is a point's last view: with held control only the pairs with it give equations.
        pairs += [(i, j) for i in range(first, last) for j in range(i + 1, last) if not fixed or j == last - 1]
    return Views(
        tuple(found),
        np.array([row[0] for row in rows], dtype=np.int64),
        np.array([row[1] for row in rows], dtype=np.int64),
        np.array([row[2] for row in rows], dtype=np.float64).reshape(-1, 2),
        np.array([row[3] for row in rows], dtype=np.float64).reshape(-1, 2),
        np.array([row[4] for row in rows], dtype=np.float64),
        np.array(pairs, dtype=np.int64).reshape(-1, 2),
    )


def weights_of_pairs(views: Views, sigma_ground: FloatArray) -> FloatArray:
    """Weights (M,) of the pairs, from the standard deviations (N,) of the views' positions on the ground.

    Parameters
    ----------
    views : Views
    sigma_ground : array (N,)
        Standard deviations of the views' positions on the normalised ground; 0 for control that is held.
    """
    total = np.zeros(len(views.ids))
    with np.errstate(divide="ignore"):
        weight = 1.0 / sigma_ground**2
    np.add.at(total, views.point, weight)
    a, b = weight[views.pairs].T
    shared = total[views.point[views.pairs[:, 0]]]
    with np.errstate(invalid="ignore"):
        usual: FloatArray = a * b / shared
    # The limit of a·b / Σw where b, held control, has infinite weight.
    return np.where(np.isinf(b), a, usual)


def mean_positions(views: Views, position: FloatArray, sigma_ground: FloatArray) -> FloatArray:
    """Adjusted ground (P, 2) of the points: the weighted mean of their views' positions (N, 2), or fixed control.

    Parameters
    ----------
    views : Views
    position : array (N, 2)
        Positions of the views on the normalised ground.
    sigma_ground : array (N,)
        Standard deviations of the views' positions on the normalised ground; 0 for control that is held.
    """
    with np.errstate(divide="ignore"):
        weight = 1.0 / sigma_ground**2
    fixed = np.isinf(weight)
    known = np.zeros(len(views.ids), dtype=bool)
    known[views.point[fixed]] = True
    weight = np.where(known[views.point], fixed.astype(np.float64), weight)
    total, sums = np.zeros(len(views.ids)), np.zeros((len(views.ids), 2))
    np.add.at(total, views.point, weight)
    np.add.at(sums, views.point, weight[:, None] * position)
    return sums / total[:, None]


class PlanarProblem:
    """Planar block in normalised coordinates, with what does not change from round to round."""

    def __init__(
        self, block: PlanarBlock, kind: str, views: Views, frame: Frame, fixed: Mapping[str, PlanarTransform]
    ) -> None:
        self.block, self.kind, self.views, self.frame = block, kind, views, frame
        self.count = len(NAMES[kind])
        self.held: BoolArray = np.array([photo.name in fixed for photo in block.photos])
        self.start = np.zeros((len(block.photos), self.count))
        for name, transform in fixed.items():
            if name in block.index:
                self.start[block.index[name]] = _as_kind(transform, kind, frame)
        # Number of the first unknown of each photo; photos that are held have none.
        self.first: IntArray = np.where(self.held, -1, (np.cumsum(~self.held) - 1) * self.count)
        self.unknowns = int((~self.held).sum()) * self.count
        self.in_photo: BoolArray = ~views.is_ground
        self.ground = frame.normal(views.xy)
        self.half = np.array([half(photo.size) for photo in block.photos])

    def of_views(self, values: FloatArray) -> FloatArray:
        """Parameters (N, P) of the photo of each view in a photo."""
        return values[self.views.photo[self.in_photo]]

    def positions(self, values: FloatArray, at: FloatArray) -> FloatArray:
        """Normalised ground (N, 2) of all views, linearised in the image about `at` (N, 2)."""
        inside, place = self.in_photo, self.ground.copy()
        own, there = self.of_views(values), at[inside]
        place[inside] = forward(self.kind, own, there)
        if self.kind == "projective":  # the others are linear in x and y
            left = self.views.xy[inside] - there
            place[inside] += np.einsum("nij,nj->ni", by_photo(self.kind, own, there), left)
        else:
            place[inside] = forward(self.kind, own, self.views.xy[inside])
        return place

    def adjusted(self, values: FloatArray, points: FloatArray) -> FloatArray:
        """Normalised photo coordinates (N, 2) of the adjusted points (M, 2): the measurements less their residuals."""
        there = self.views.xy.copy()
        for i in range(len(self.block.photos)):
            own = np.flatnonzero(self.views.photo == i)
            there[own] = reverse(self.kind, values[i], points[self.views.point[own]])
        return there

    def sigma_ground(self, values: FloatArray | None, at: FloatArray) -> FloatArray:
        """Standard deviations (N,) of the positions, normalised; relative ones before the scales are known."""
        sigma, inside = self.views.sigma.copy(), self.in_photo
        if values is None:
            sigma[~inside] = np.where(sigma[~inside] > 0.0, 1.0, 0.0)
            return sigma
        slope = by_photo(self.kind, self.of_views(values), at[inside])
        sigma[inside] *= pixel_sizes(slope) / self.half[self.views.photo[inside]]
        sigma[~inside] /= self.frame.scale
        return sigma

    def network(self, values: FloatArray, at: FloatArray, weights: FloatArray) -> Network:
        """Equations of the pairs at the places (N, 2) in the photos; points have been eliminated from them.

        Parameters
        ----------
        values : array (U,)
            Of the unknowns.
        at : array (N, 2)
            Places in the photos.
        weights : array (P,)
            Of the pairs.
        """
        slopes = np.zeros((len(self.views.photo), 2, self.count))
        slopes[self.in_photo] = by_parameters(self.kind, self.of_views(values), at[self.in_photo])
        pairs, root = self.views.pairs, np.sqrt(weights)
        # Ground coordinates and photos that are held have no unknowns.
        photo = self.views.photo[pairs]
        first = np.where(photo == GROUND, -1, self.first[photo])[:, :, None]
        columns = np.where(first >= 0, first + np.arange(self.count), -1).reshape(len(pairs), -1)
        by = np.concatenate([slopes[pairs[:, 0]], -slopes[pairs[:, 1]]], axis=2) * root[:, None, None]
        gap = -self.misclosure(values, at) * root[:, None]
        none = np.zeros((len(pairs), 2, 2))
        equations = Observations(np.full(len(pairs), -1), columns, by, none, gap)
        return Network((equations,), np.arange(0, self.unknowns + 1, self.count), np.zeros((0, 2), dtype=np.bool_))

    def misclosure(self, values: FloatArray, at: FloatArray) -> FloatArray:
        """Differences (M, 2) of the positions of each pair, normalised."""
        place = self.positions(values, at)
        return place[self.views.pairs[:, 0]] - place[self.views.pairs[:, 1]]

    def moved(self, values: FloatArray, step: FloatArray) -> FloatArray:
        """Parameters (K, P) after a step (U,)."""
        out = values.copy()
        out[~self.held] += step.reshape(-1, self.count)
        return out

    def photo_of(self, direction: FloatArray) -> str:
        """Name of the photo that has most of a direction (U,) in the unknowns."""
        share = (direction.reshape(-1, self.count) ** 2).sum(axis=1)
        return self.block.photos[int(np.flatnonzero(~self.held)[int(np.argmax(share))])].name


def frame_of(block: PlanarBlock, fixed: Mapping[str, PlanarTransform]) -> Frame:
    """Normalised ground about the control, else about the photos that are held.

    Parameters
    ----------
    block : PlanarBlock
    fixed : mapping of str to PlanarTransform
        Photos that are held, by name.
    """
    known = [np.array([[point.x, point.y] for point in block.control]).reshape(-1, 2)]
    known += [transform.to_ground(transform.corners()) for transform in fixed.values()]
    places = np.vstack(known)
    # Map coordinates of millions of metres would cost six digits in the normal equations.
    middle = (places.min(axis=0) + places.max(axis=0)) / 2.0
    reach = float(np.abs(places - middle).max())
    return Frame(float(middle[0]), float(middle[1]), reach if reach > 0.0 else 1.0)


def _as_kind(transform: PlanarTransform, kind: str, frame: Frame) -> FloatArray:
    """Parameters of a transformation in another frame, written as another kind; what that kind lacks is dropped."""
    own = transform.frame
    scale = own.scale / frame.scale
    shift = np.array([own.x0 - frame.x0, own.y0 - frame.y0]) / frame.scale
    change = np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]], [0.0, 0.0, 1.0]])
    return kinds.from_matrix(kind, change @ kinds.matrix(transform.kind, transform.values))
