"""A block in normalised coordinates: misclosures, design and weights at given parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from geomosaic.adjust.planar import kinds
from geomosaic.adjust.planar.equations import GROUND, Views
from geomosaic.adjust.planar.kinds import NAMES, by_parameters, by_photo, forward, pixel_sizes, reverse
from geomosaic.adjust.planar.transform import Frame, PlanarTransform, half
from geomosaic.adjust.planar.values import PlanarBlock
from geomosaic.types import BoolArray, FloatArray, IntArray


class Problem:
    """A block in normalised coordinates, with what does not change from round to round."""

    def __init__(
        self, block: PlanarBlock, kind: str, views: Views, frame: Frame, fixed: Mapping[str, PlanarTransform]
    ) -> None:
        self.block, self.kind, self.views, self.frame = block, kind, views, frame
        self.count = len(NAMES[kind])
        self.held: BoolArray = np.array([photo.name in fixed for photo in block.photos])
        self.start = np.zeros((len(block.photos), self.count))
        for name, transform in fixed.items():
            if name in block.index:
                self.start[block.index[name]] = as_kind(transform, kind, frame)
        # Number of the first unknown of each photo; photos that are held have none.
        self.first: IntArray = np.where(self.held, -1, (np.cumsum(~self.held) - 1) * self.count)
        self.unknowns = int((~self.held).sum()) * self.count
        self.in_photo: BoolArray = ~views.is_ground
        self.ground = frame.normal(views.xy)
        self.half = np.array([half(photo.size) for photo in block.photos])

    def of_views(self, values: FloatArray) -> FloatArray:
        """Parameters (N, P) of the photo of each view in a photo."""
        own: FloatArray = values[self.views.photo[self.in_photo]]
        return own

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

    def design(self, values: FloatArray, at: FloatArray, weights: FloatArray) -> Any:
        """Weighted design (2M, U), sparse, at the places (N, 2) in the photos."""
        from scipy.sparse import coo_array

        slopes = np.zeros((len(self.views.photo), 2, self.count))
        slopes[self.in_photo] = by_parameters(self.kind, self.of_views(values), at[self.in_photo])
        root, rows, cols, data = np.sqrt(weights), [], [], []
        for side, sign in ((0, 1.0), (1, -1.0)):
            view = self.views.pairs[:, side]
            photo = self.views.photo[view]
            pair = np.flatnonzero((photo != GROUND) & (self.first[photo] >= 0))
            block = sign * root[pair, None, None] * slopes[view[pair]]
            rows.append(np.broadcast_to((2 * pair[:, None] + [0, 1])[:, :, None], block.shape).ravel())
            first = self.first[photo[pair]]
            cols.append(np.broadcast_to((first[:, None] + np.arange(self.count))[:, None, :], block.shape).ravel())
            data.append(block.ravel())
        entries = (np.concatenate(data), (np.concatenate(rows), np.concatenate(cols)))
        return coo_array(entries, shape=(2 * len(self.views.pairs), self.unknowns)).tocsr()

    def misclosure(self, values: FloatArray, at: FloatArray) -> FloatArray:
        """Differences (M, 2) of the positions of each pair, normalised."""
        place = self.positions(values, at)
        gap: FloatArray = place[self.views.pairs[:, 0]] - place[self.views.pairs[:, 1]]
        return gap

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
    """Normalised ground about the control, else about the photos that are held."""
    known = [np.array([[point.x, point.y] for point in block.control]).reshape(-1, 2)]
    known += [transform.to_ground(transform.corners()) for transform in fixed.values()]
    places = np.vstack(known)
    middle = (places.min(axis=0) + places.max(axis=0)) / 2.0
    reach = float(np.abs(places - middle).max())
    return Frame(float(middle[0]), float(middle[1]), reach if reach > 0.0 else 1.0)


def as_kind(transform: PlanarTransform, kind: str, frame: Frame) -> FloatArray:
    """Parameters of a transformation in another frame, written as another kind; what that kind lacks is dropped."""
    own = transform.frame
    scale = own.scale / frame.scale
    shift = np.array([own.x0 - frame.x0, own.y0 - frame.y0]) / frame.scale
    change = np.array([[scale, 0.0, shift[0]], [0.0, scale, shift[1]], [0.0, 0.0, 1.0]])
    return kinds.from_matrix(kind, change @ kinds.matrix(transform.kind, transform.values))
