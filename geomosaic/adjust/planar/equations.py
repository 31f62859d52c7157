"""Observation equations of a block: control points by (9-3), tie points by (9-4), with their weights.

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

from dataclasses import dataclass

import numpy as np

from geomosaic.adjust.planar.transform import photo_coordinates
from geomosaic.adjust.planar.values import PlanarBlock
from geomosaic.types import BoolArray, FloatArray, IntArray

GROUND = -1
"""In place of a photo's number: the view is the ground coordinates themselves."""


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
    """Gather the measurements; points with one view only stay, and give no equation."""
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
    """Weights (M,) of the pairs, from the standard deviations (N,) of the views' positions on the ground."""
    total = np.zeros(len(views.ids))
    with np.errstate(divide="ignore"):
        weight = 1.0 / sigma_ground**2
    np.add.at(total, views.point, weight)
    a, b = weight[views.pairs].T
    shared = total[views.point[views.pairs[:, 0]]]
    with np.errstate(invalid="ignore"):
        usual: FloatArray = a * b / shared
    return np.where(np.isinf(b), a, usual)


def mean_positions(views: Views, position: FloatArray, sigma_ground: FloatArray) -> FloatArray:
    """Adjusted ground (P, 2) of the points: the weighted mean of their views' positions (N, 2), or fixed control."""
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
