"""Where the adjustment of a body starts, with no initial values.

Every circular body about a known direction is linear in its coefficients, x² + y² + A·z² + B·x + C·y + D·z + E = 0 in
axes with z along it. So directions are tried all over the half sphere, and those that fit best are handed on.
"""

from __future__ import annotations

import numpy as np

from geomosaic.adjust.bodies.shape import Shape, basis
from geomosaic.types import FloatArray

DIRECTIONS = 300
KEPT = 5
MOST_POINTS = 300


def starts(kind: str, points: FloatArray, axis: FloatArray | None) -> list[Shape]:
    """Bodies to start from, best first; points (N, 3) about the origin, axis a unit vector where it is known."""
    if kind == "plane":
        return [Shape(kind, points.mean(axis=0), basis(_least(points)), np.array([]))]
    if kind == "sphere":
        found = _solved(np.column_stack([points, np.ones(len(points))]), (points**2).sum(axis=1))
        centre = found[:3] / 2
        return [Shape(kind, centre, np.eye(3), np.sqrt([max(found[3] + centre @ centre, 0.0)]))]
    few = points[np.linspace(0, len(points) - 1, min(len(points), MOST_POINTS)).astype(int)]
    tried = []
    for direction in _half_sphere() if axis is None else axis[None]:
        shape, misfit = _about(kind, few, direction)
        if shape is not None:
            tried.append((misfit, shape))
    tried.sort(key=lambda entry: entry[0])
    return [shape for _, shape in tried[:KEPT]]


def _about(kind: str, points: FloatArray, direction: FloatArray) -> tuple[Shape | None, float]:
    """The body about a direction through the points, in the sense of algebra, and the sum of squares of its misfit."""
    rotation = basis(direction)
    x, y, z = (points @ rotation.T).T
    one, right = np.ones_like(x), -(x * x + y * y)
    design = [x, y, one] if kind == "cylinder" else [x, y, one, z, z * z]
    found: FloatArray = _solved(np.column_stack(design), right)
    b, c, e, d, a = (*found, 0.0, 0.0) if kind == "cylinder" else found
    x0, y0 = -b / 2, -c / 2
    square = x0 * x0 + y0 * y0 - e
    misfit = float(((np.column_stack(design) @ found - right) ** 2).sum())
    if kind == "cylinder":
        if square <= 0.0:
            return None, misfit
        return Shape(kind, np.array([x0, y0, 0.0]) @ rotation, rotation, np.sqrt([square])), misfit
    if (kind == "cone") != (a < 0.0) or a == 0.0:
        return None, misfit
    z0 = -d / (2 * a)
    centre = np.array([x0, y0, z0]) @ rotation
    if kind == "cone":
        if (z > z0).sum() > len(z) / 2:  # the body lies below its apex
            rotation = np.array([rotation[0], -rotation[1], -rotation[2]])
        return Shape(kind, centre, rotation, np.arctan(np.sqrt([-a]))), misfit
    square += d * d / (4 * a)
    if square <= 0.0:
        return None, misfit
    return Shape(kind, centre, rotation, np.sqrt([square, square / a])), misfit


def _solved(design: FloatArray, right: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.lstsq(design, right, rcond=None)[0], dtype=np.float64)


def _least(points: FloatArray) -> FloatArray:
    """Direction in which points spread least."""
    return np.asarray(np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][-1], dtype=np.float64)


def _half_sphere() -> FloatArray:
    """Directions (N, 3) all over the upper half sphere, evenly (Fibonacci's lattice), the vertical first."""
    i = np.arange(DIRECTIONS)
    z = 1.0 - i / DIRECTIONS
    turn = np.pi * (3.0 - np.sqrt(5.0)) * i
    out = np.sqrt(1.0 - z * z)
    return np.column_stack([out * np.cos(turn), out * np.sin(turn), z])
