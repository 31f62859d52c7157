"""A photo's place on the map: a plane transformation between its pixels and the ground, both ways."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.adjust.planar.kinds import NAMES, by_photo, forward, from_matrix, matrix, pixel_sizes, reverse
from geomosaic.adjust.planar.values import PlanarPhoto
from geomosaic.types import FloatArray


@dataclass(frozen=True)
class Frame:
    """Normalised ground coordinates U = (X − x0)/scale, V = (Y − y0)/scale: numbers near 1 for the adjustment."""

    x0: float = 0.0
    y0: float = 0.0
    scale: float = 1.0

    def normal(self, ground: FloatArray) -> FloatArray:
        """Map (N, 2) to normalised (N, 2)."""
        uv: FloatArray = (np.asarray(ground, dtype=np.float64) - [self.x0, self.y0]) / self.scale
        return uv

    def map(self, normal: FloatArray) -> FloatArray:
        """Normalised (N, 2) to map (N, 2)."""
        xy: FloatArray = normal * self.scale + [self.x0, self.y0]
        return xy


def half(size: tuple[int, int]) -> float:
    """Pixels that normalised photo coordinates count as 1: half of the longer side."""
    return max(size) / 2.0


def photo_coordinates(size: tuple[int, int], colrow: FloatArray) -> FloatArray:
    """Normalised photo coordinates (N, 2), from the middle, to the right and upwards, of (col, row) (N, 2)."""
    pixels = np.asarray(colrow, dtype=np.float64)
    width, height = size
    return np.column_stack([pixels[:, 0] - width / 2.0, height / 2.0 - pixels[:, 1]]) / half(size)


@dataclass(frozen=True, eq=False)
class PlanarTransform:
    """A photo's transformation.

    Attributes
    ----------
    photo : PlanarPhoto
    kind : str
        'conformal', 'affine' or 'projective'.
    frame : Frame
        Of the ground.
    values : array (P,)
        Parameters photo → ground in normalised coordinates, see `kinds`.
    """

    photo: PlanarPhoto
    kind: str
    frame: Frame
    values: FloatArray

    def to_ground(self, colrow: FloatArray) -> FloatArray:
        """(col, row) (N, 2) in pixels to map (N, 2); NaN beyond the horizon of a projective transformation."""
        return self.frame.map(forward(self.kind, self.values, photo_coordinates(self.photo.size, colrow)))

    def to_image(self, ground: FloatArray) -> FloatArray:
        """Map (N, 2) to (col, row) (N, 2) in pixels, by (9-6) or (9-8)."""
        x, y = reverse(self.kind, self.values, self.frame.normal(ground)).T * half(self.photo.size)
        width, height = self.photo.size
        return np.column_stack([width / 2.0 + x, height / 2.0 - y])

    def slope(self, colrow: FloatArray) -> FloatArray:
        """Derivatives (N, 2, 2) of the map by col and row, map units per pixel."""
        size = self.photo.size
        by_xy = by_photo(self.kind, self.values, photo_coordinates(size, colrow))
        slope: FloatArray = by_xy * np.array([1.0, -1.0]) * (self.frame.scale / half(size))
        return slope

    @property
    def matrix(self) -> FloatArray:
        """Homogeneous matrix (3, 3) of (col, row) → map."""
        s, x0, y0 = self.frame.scale, self.frame.x0, self.frame.y0
        whole: FloatArray = np.array([[s, 0.0, x0], [0.0, s, y0], [0.0, 0.0, 1.0]]) @ self._from_pixels
        return whole

    @property
    def _from_pixels(self) -> FloatArray:
        """Homogeneous matrix (3, 3) of (col, row) → normalised ground."""
        (width, height), h = self.photo.size, half(self.photo.size)
        pixels = np.array([[1.0 / h, 0.0, -width / 2.0 / h], [0.0, -1.0 / h, height / 2.0 / h], [0.0, 0.0, 1.0]])
        normal: FloatArray = matrix(self.kind, self.values) @ pixels
        return normal

    def textbook(self) -> dict[str, float]:
        """Parameters as the equations of the book name them, for x = col, y = height − row, X and Y in map units."""
        flip = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, self.photo.size[1]], [0.0, 0.0, 1.0]])
        values = from_matrix(self.kind, self.matrix @ flip)
        return dict(zip(NAMES[self.kind], values.tolist(), strict=True))

    def corners(self) -> FloatArray:
        """Corners (4, 2) of the photo in pixels."""
        width, height = self.photo.size
        return np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])

    def centre(self) -> FloatArray:
        """Ground (2,) of the middle of the photo."""
        middle: FloatArray = self.to_ground(np.array([self.photo.size]) / 2.0)[0]
        return middle

    def pixel(self) -> float:
        """Map units per pixel in the middle of the photo."""
        return float(pixel_sizes(self.slope(np.array([self.photo.size]) / 2.0))[0])

    def options(self) -> dict[str, object]:
        """Inputs of the sensor 'planar' that make the same transformation, ground → image.

        The coefficients count from the middle of the photo's ground, in units of half its size there: whatever the
        size of the map coordinates, nothing cancels, and the denominator of a projective transformation is 1 there.
        """
        middle = np.zeros((1, 2))
        place = forward(self.kind, self.values, middle)
        step = float(pixel_sizes(by_photo(self.kind, self.values, middle))[0])
        x0, y0 = self.frame.map(place)[0]
        local = np.array([[1.0, 0.0, -place[0, 0]], [0.0, 1.0, -place[0, 1]], [0.0, 0.0, step]]) @ self._from_pixels
        inverse = np.linalg.inv(local)
        h = inverse / inverse[2, 2]
        if self.kind == "conformal":
            coefficients = {"a": h[0, 0], "b": -h[0, 1], "tx": h[0, 2], "ty": -h[1, 2]}
        elif self.kind == "affine":
            coefficients = dict(zip(("a10", "a01", "a00", "b10", "b01", "b00"), h[:2].ravel(), strict=True))
        else:
            coefficients = dict(zip(("a1", "a2", "a0", "b1", "b2", "b0", "c1", "c2"), h.ravel()[:8], strict=True))
        return {
            "kind": self.kind,
            "centre": [float(x0), float(y0)],
            "scale": step * self.frame.scale,
            "coefficients": {name: float(value) for name, value in coefficients.items()},
        }
