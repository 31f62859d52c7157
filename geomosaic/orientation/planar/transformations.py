"""Plane transformations photo to ground and back: conformal, affine, projective (Wolf & Dewitt, 9-3, 9-8, 9-9).

conformal    X = a·x − b·y + TX,  Y = a·y + b·x + TY                                            (9-1)
affine       X = a1·x + b1·y + c1,  Y = a2·x + b2·y + c2
projective   X = (a1·x + b1·y + c1)/w,  Y = (a2·x + b2·y + c2)/w,  w = a3·x + b3·y + 1         (9-7)

x, y are photo coordinates to the right and upwards (a right-handed system), X, Y ground coordinates.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geomosaic.orientation.planar.measurements import PlanarPhoto
from geomosaic.types import FloatArray

# Parameters of each kind, in their order.
NAMES = {
    "conformal": ("a", "b", "TX", "TY"),
    "affine": ("a1", "b1", "c1", "a2", "b2", "c2"),
    "projective": ("a1", "b1", "c1", "a2", "b2", "c2", "a3", "b3"),
}

# Fewest points that determine a kind.
LEAST = {"conformal": 2, "affine": 3, "projective": 4}


def forward(kind: str, values: FloatArray, xy: FloatArray) -> FloatArray:
    """Ground (N, 2) of photo coordinates (N, 2).

    NaN where w ≤ 0: beyond the horizon.

    Parameters
    ----------
    kind : str
        'conformal', 'affine' or 'projective'.
    values : array (P,) or (N, P)
        Parameters as in `NAMES`; with (N, P) each point has its own.
    xy : array (N, 2)
        Normalised photo coordinates: from the middle, to the right and upwards.
    """
    x, y = xy[:, 0], xy[:, 1]
    p = np.moveaxis(values, -1, 0)
    if kind == "conformal":
        a, b, tx, ty = p
        return np.column_stack([a * x - b * y + tx, a * y + b * x + ty])
    ground = np.column_stack([p[0] * x + p[1] * y + p[2], p[3] * x + p[4] * y + p[5]])
    return ground if kind == "affine" else ground / _denominator(p, x, y)[:, None]


def by_parameters(kind: str, values: FloatArray, xy: FloatArray) -> FloatArray:
    """Derivatives (N, 2, P) of `forward` by the parameters.

    Parameters
    ----------
    kind, values, xy
        As for `forward`.
    """
    x, y = xy[:, 0], xy[:, 1]
    out = np.zeros((len(xy), 2, len(NAMES[kind])))
    if kind == "conformal":
        out[:, 0, 0], out[:, 0, 1], out[:, 0, 2] = x, -y, 1.0
        out[:, 1, 0], out[:, 1, 1], out[:, 1, 3] = y, x, 1.0
        return out
    terms = np.column_stack([x, y, np.ones_like(x)])
    if kind == "projective":
        w = _denominator(np.moveaxis(values, -1, 0), x, y)[:, None]
        terms = terms / w
        out[:, :, 6:] = -forward(kind, values, xy)[:, :, None] * (xy / w)[:, None, :]
    out[:, 0, :3] = out[:, 1, 3:6] = terms
    return out


def by_photo(kind: str, values: FloatArray, xy: FloatArray) -> FloatArray:
    """Derivatives (N, 2, 2) of `forward` by x and y.

    Parameters
    ----------
    kind, values, xy
        As for `forward`.
    """
    p = np.broadcast_to(values, (len(xy), len(NAMES[kind])))
    if kind == "conformal":
        a, b = p[:, 0], p[:, 1]
        return np.stack([np.column_stack([a, -b]), np.column_stack([b, a])], axis=1)
    linear = np.stack([p[:, 0:2], p[:, 3:5]], axis=1)
    if kind == "affine":
        return linear
    w = _denominator(p.T, xy[:, 0], xy[:, 1])
    return (linear - forward(kind, values, xy)[:, :, None] * p[:, None, 6:]) / w[:, None, None]


def pixel_sizes(slope: FloatArray) -> FloatArray:
    """Mean scale of a plane transformation, from its derivatives: √|det|, the root of how much larger areas become.

    Parameters
    ----------
    slope : array (N, 2, 2)
        Derivatives of the target coordinates by the source coordinates.

    Returns
    -------
    array (N,)
        Target units per source unit; NaN where the derivatives are.
    """
    (a, b), (c, d) = slope[:, 0].T, slope[:, 1].T
    scale: FloatArray = np.sqrt(np.abs(a * d - b * c))
    return scale


def reverse(kind: str, values: FloatArray, ground: FloatArray) -> FloatArray:
    """Photo coordinates (N, 2) of ground (N, 2), by equations (9-6) and (9-8).

    (9-8) with a3 = b3 = 0 is the reverse of the affine transformation. NaN for ground beyond the horizon: the sign of
    its denominator there is not that of a1·b2 − a2·b1 over w at the place.

    Parameters
    ----------
    kind : str
        'conformal', 'affine' or 'projective'.
    values : array (P,)
        Parameters as in `NAMES`.
    ground : array (N, 2)
        Normalised ground coordinates.
    """
    X, Y = ground[:, 0], ground[:, 1]
    if kind == "conformal":
        a, b, tx, ty = values
        scale2 = a * a + b * b
        turned: FloatArray = np.column_stack([a * (X - tx) + b * (Y - ty), a * (Y - ty) - b * (X - tx)]) / scale2
        return turned
    a1, b1, c1, a2, b2, c2 = values[:6]
    a3, b3 = values[6:] if kind == "projective" else (0.0, 0.0)
    bottom = (a2 * b3 - a3 * b2) * X + (a3 * b1 - a1 * b3) * Y + a1 * b2 - a2 * b1
    x = (b2 - b3 * c2) * X + (b3 * c1 - b1) * Y + b1 * c2 - b2 * c1
    y = (a3 * c2 - a2) * X + (a1 - a3 * c1) * Y + a2 * c1 - a1 * c2
    if kind == "projective":
        # bottom · w = determinant of the transformation: where w > 0, both have one sign.
        bottom = np.where(bottom * np.linalg.det(matrix(kind, values)) > 0.0, bottom, np.nan)
    photo: FloatArray = np.column_stack([x, y]) / bottom[:, None]
    return photo


def matrix(kind: str, values: FloatArray) -> FloatArray:
    """Homogeneous matrix (3, 3) photo → ground.

    Parameters
    ----------
    kind : str
        'conformal', 'affine' or 'projective'.
    values : array (P,)
        Parameters as in `NAMES`.
    """
    if kind == "conformal":
        a, b, tx, ty = values
        return np.array([[a, -b, tx], [b, a, ty], [0.0, 0.0, 1.0]])
    last = values[6:] if kind == "projective" else np.zeros(2)
    return np.array([values[0:3], values[3:6], [*last, 1.0]])


def from_matrix(kind: str, homogeneous: FloatArray) -> FloatArray:
    """Parameters (P,) of a homogeneous matrix (3, 3) of this kind.

    Parameters
    ----------
    kind : str
        'conformal', 'affine' or 'projective'.
    homogeneous : array (3, 3)
        Of photo to ground.
    """
    h = homogeneous / homogeneous[2, 2]
    if kind == "conformal":
        return np.array([h[0, 0], h[1, 0], h[0, 2], h[1, 2]])
    return np.concatenate([h[0], h[1], h[2, :2]])[: len(NAMES[kind])]


def _denominator(p: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    w = p[6] * x + p[7] * y + 1.0
    return np.where(w > 0.0, w, np.nan)


@dataclass(frozen=True)
class Frame:
    """Normalised ground coordinates U = (X − x0)/scale, V = (Y − y0)/scale: numbers near 1 for the adjustment.

    Attributes
    ----------
    x0, y0 : float
        Origin in the map, map units.
    scale : float
        Map units that count as 1.
    """

    x0: float = 0.0
    y0: float = 0.0
    scale: float = 1.0

    def normal(self, ground: FloatArray) -> FloatArray:
        """Map (N, 2) to normalised (N, 2)."""
        return (np.asarray(ground, dtype=np.float64) - [self.x0, self.y0]) / self.scale

    def map(self, normal: FloatArray) -> FloatArray:
        """Normalised (N, 2) to map (N, 2)."""
        return normal * self.scale + [self.x0, self.y0]


def half(size: tuple[int, int]) -> float:
    """Unit of normalised photo coordinates: half of the longer side.

    Parameters
    ----------
    size : (int, int)
        Columns and rows of the photo.

    Returns
    -------
    float
        Pixels.
    """
    return max(size) / 2.0


def photo_coordinates(size: tuple[int, int], colrow: FloatArray) -> FloatArray:
    """Normalised photo coordinates (N, 2), from the middle, to the right and upwards, of (col, row) (N, 2).

    Parameters
    ----------
    size : tuple of int
        Width and height of the photo, pixels.
    colrow : array (N, 2)
        Pixels, corner-based.
    """
    pixels = np.asarray(colrow, dtype=np.float64)
    width, height = size
    return np.column_stack([pixels[:, 0] - width / 2.0, height / 2.0 - pixels[:, 1]]) / half(size)


@dataclass(frozen=True, eq=False)
class PlanarTransform:
    """Plane transformation of a photo.

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
        return np.array([[s, 0.0, x0], [0.0, s, y0], [0.0, 0.0, 1.0]]) @ self._from_pixels

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

    def corners_and_middle(self) -> FloatArray:
        """Corners and middle (5, 2) of the photo in pixels."""
        return np.vstack([self.corners(), np.array([self.photo.size]) / 2.0])

    def centre(self) -> FloatArray:
        """Ground (2,) of the middle of the photo."""
        middle: FloatArray = self.to_ground(np.array([self.photo.size]) / 2.0)[0]
        return middle

    def pixel(self) -> float:
        """Map units per pixel in the middle of the photo."""
        return float(pixel_sizes(self.slope(np.array([self.photo.size]) / 2.0))[0])

    def options(self) -> dict[str, object]:
        """Inputs of the sensor 'planar' that make the same transformation, ground → image."""
        # The coefficients count from the middle of the photo's ground, in units of half its size there: whatever the
        # size of the map coordinates, nothing cancels, and the denominator of a projective transformation is 1 there.
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
