"""The plane transformations photo → ground, and their reverses; Wolf & Dewitt, sections 9-3, 9-8 and 9-9.

conformal    X = a·x − b·y + TX,  Y = a·y + b·x + TY                                            (9-1)
affine       X = a1·x + b1·y + c1,  Y = a2·x + b2·y + c2
projective   X = (a1·x + b1·y + c1)/w,  Y = (a2·x + b2·y + c2)/w,  w = a3·x + b3·y + 1         (9-7)

x, y are photo coordinates to the right and upwards (a right-handed system), X, Y ground coordinates.
"""

from __future__ import annotations

import numpy as np

from geomosaic.types import FloatArray

NAMES = {
    "conformal": ("a", "b", "TX", "TY"),
    "affine": ("a1", "b1", "c1", "a2", "b2", "c2"),
    "projective": ("a1", "b1", "c1", "a2", "b2", "c2", "a3", "b3"),
}
"""Parameters of each kind, in their order."""

LEAST = {"conformal": 2, "affine": 3, "projective": 4}
"""Fewest points that determine a kind."""


def forward(kind: str, values: FloatArray, xy: FloatArray) -> FloatArray:
    """Ground (N, 2) of photo coordinates (N, 2).

    `values` are (P,), or (N, P) where each point has parameters of its own. NaN where w ≤ 0: beyond the horizon.
    """
    x, y = xy[:, 0], xy[:, 1]
    p = np.moveaxis(values, -1, 0)
    if kind == "conformal":
        a, b, tx, ty = p
        return np.column_stack([a * x - b * y + tx, a * y + b * x + ty])
    ground = np.column_stack([p[0] * x + p[1] * y + p[2], p[3] * x + p[4] * y + p[5]])
    return ground if kind == "affine" else ground / _denominator(p, x, y)[:, None]


def by_parameters(kind: str, values: FloatArray, xy: FloatArray) -> FloatArray:
    """Derivatives (N, 2, P) of `forward` by the parameters."""
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
    """Derivatives (N, 2, 2) of `forward` by x and y."""
    p = np.broadcast_to(values, (len(xy), len(NAMES[kind])))
    if kind == "conformal":
        a, b = p[:, 0], p[:, 1]
        return np.stack([np.column_stack([a, -b]), np.column_stack([b, a])], axis=1)
    linear = np.stack([p[:, 0:2], p[:, 3:5]], axis=1)
    if kind == "affine":
        return linear
    w = _denominator(p.T, xy[:, 0], xy[:, 1])
    slope: FloatArray = (linear - forward(kind, values, xy)[:, :, None] * p[:, None, 6:]) / w[:, None, None]
    return slope


def pixel_sizes(slope: FloatArray) -> FloatArray:
    """Mean scale (N,) of derivatives (N, 2, 2): the root of how much larger areas become; NaN where they are."""
    (a, b), (c, d) = slope[:, 0].T, slope[:, 1].T
    scale: FloatArray = np.sqrt(np.abs(a * d - b * c))
    return scale


def reverse(kind: str, values: FloatArray, ground: FloatArray) -> FloatArray:
    """Photo coordinates (N, 2) of ground (N, 2), by equations (9-6) and (9-8).

    (9-8) with a3 = b3 = 0 is the reverse of the affine transformation. NaN for ground beyond the horizon: the sign of
    its denominator there is not that of a1·b2 − a2·b1 over w at the place.
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
    """Homogeneous matrix (3, 3) photo → ground."""
    if kind == "conformal":
        a, b, tx, ty = values
        return np.array([[a, -b, tx], [b, a, ty], [0.0, 0.0, 1.0]])
    last = values[6:] if kind == "projective" else np.zeros(2)
    return np.array([values[0:3], values[3:6], [*last, 1.0]])


def from_matrix(kind: str, homogeneous: FloatArray) -> FloatArray:
    """Parameters (P,) of a homogeneous matrix (3, 3) of this kind."""
    h = homogeneous / homogeneous[2, 2]
    if kind == "conformal":
        return np.array([h[0, 0], h[1, 0], h[0, 2], h[1, 2]])
    flat: FloatArray = np.concatenate([h[0], h[1], h[2, :2]])[: len(NAMES[kind])]
    return flat


def _denominator(p: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
    w = p[6] * x + p[7] * y + 1.0
    seen: FloatArray = np.where(w > 0.0, w, np.nan)
    return seen
