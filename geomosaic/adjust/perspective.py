"""The perspective that most of the points agree with, quickly: what is left of an oblique image bends smoothly."""

from __future__ import annotations

import numpy as np

from geomosaic.types import FloatArray

SAMPLES = 200
SIZE = 5
"""Points of a sample; four determine it."""
SHARE = 0.6
"""Points that should agree: 40 % may be blunders."""
STEPS = 10


def without_perspective(places: FloatArray, image: FloatArray) -> FloatArray:
    """Take the projective transformation off that most points agree with (least trimmed squares from small samples).

    Parameters
    ----------
    places : array (N, 2)
        On the map, |x|, |y| ≤ 1 or so.
    image : array (N, 2)
        Pixels.

    Returns
    -------
    array (N, 2)
        What is left, pixels; the image itself where no sample determines the transformation.
    """
    count = len(places)
    middle = image.mean(axis=0)
    extent = max(float(np.abs(image - middle).max()), 1e-300)
    target = (image - middle) / extent
    held = max(SIZE, round(SHARE * count))
    random = np.random.default_rng(0)
    chosen = np.argsort(random.random((SAMPLES, count)), axis=1)[:, : min(SIZE, count)]
    left = np.empty((0, count, 2))
    for _ in range(STEPS):
        left = target - _apply(_solve(places[chosen], target[chosen]), places)
        length = np.where(np.isfinite(left).all(axis=2), np.hypot(left[..., 0], left[..., 1]), np.inf)
        order = np.argsort(length, axis=1)
        total = np.take_along_axis(length, order, axis=1)[:, :held].sum(axis=1)
        best = np.argsort(total, kind="stable")[: max(1, len(total) // 4)]
        chosen, left = order[best][:, :held], left[best]
    found: FloatArray = left[0] * extent
    return found if np.isfinite(found).all() else image - middle


def _solve(places: FloatArray, image: FloatArray) -> FloatArray:
    """Coefficients (S, 8) of col = (a + b·x + c·y) / (1 + g·x + h·y), row alike, of S samples (S, K, 2)."""
    one = np.ones((*places.shape[:2], 1))
    zero = np.zeros((*places.shape[:2], 3))
    plane = np.concatenate([one, places], axis=2)
    rows = [
        np.concatenate([plane, zero, -places * image[:, :, :1]], axis=2),
        np.concatenate([zero, plane, -places * image[:, :, 1:]], axis=2),
    ]
    design = np.concatenate(rows, axis=1)
    right = np.concatenate([image[:, :, 0], image[:, :, 1]], axis=1)
    normal = np.einsum("ski,skj->sij", design, design) + 1e-12 * np.eye(8)
    solved: FloatArray = np.linalg.solve(normal, np.einsum("ski,sk->si", design, right)[:, :, None])[:, :, 0]
    return solved


def _apply(coefficients: FloatArray, places: FloatArray) -> FloatArray:
    plane = np.column_stack([np.ones(len(places)), places])
    below = 1.0 + coefficients[:, 6:] @ places.T
    with np.errstate(divide="ignore", invalid="ignore"):
        image = np.stack([coefficients[:, :3] @ plane.T, coefficients[:, 3:6] @ plane.T], axis=2) / below[:, :, None]
    found: FloatArray = np.where(below[:, :, None] > 0.05, image, np.nan)
    return found
