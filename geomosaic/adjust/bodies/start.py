"""Where the adjustment of a body starts, with no initial values.

Every circular body about a known direction is linear in its coefficients, x² + y² + A·z² + B·x + C·y + D·z + E = 0 in
axes with z along it. So directions are tried all over the half sphere, and those that fit best are handed on.
"""

from __future__ import annotations

from functools import lru_cache

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
    rotations = _half_sphere() if axis is None else basis(axis)[None]
    kept: list[Shape] = []
    for i in np.argsort(_misfits(kind, few, rotations), kind="stable"):
        shape = _about(kind, few, rotations[i])
        if shape is not None:
            kept.append(shape)
        if len(kept) == KEPT:
            break
    return kept


def _terms(kind: str, points: FloatArray, rotations: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Design (D, N, K) and right-hand side (D, N) of the bodies about directions."""
    x, y, z = np.moveaxis(np.einsum("dij,nj->dni", rotations, points), -1, 0)
    columns = [x, y, np.ones_like(x)] if kind == "cylinder" else [x, y, np.ones_like(x), z, z * z]
    return np.stack(columns, axis=-1), -(x * x + y * y)


def _misfits(kind: str, points: FloatArray, rotations: FloatArray) -> FloatArray:
    """Sums of squares (D,) that the best bodies about directions leave, in the sense of algebra."""
    design, right = _terms(kind, points, rotations)
    base = np.linalg.qr(design)[0]
    left = right - np.einsum("dnk,dk->dn", base, np.einsum("dnk,dn->dk", base, right))
    return np.asarray((left**2).sum(axis=1))


def _about(kind: str, points: FloatArray, rotation: FloatArray) -> Shape | None:
    """The body about a direction that fits points best, in the sense of algebra."""
    design, right = _terms(kind, points, rotation[None])
    z = points @ rotation[2]
    found = _solved(design[0], right[0])
    b, c, e, d, a = (*found, 0.0, 0.0) if kind == "cylinder" else found
    x0, y0 = -b / 2, -c / 2
    square = x0 * x0 + y0 * y0 - e
    if kind == "cylinder":
        if square <= 0.0:
            return None
        return Shape(kind, np.array([x0, y0, 0.0]) @ rotation, rotation, np.sqrt([square]))
    if (kind == "cone") != (a < 0.0) or a == 0.0:
        return None
    z0 = -d / (2 * a)
    centre = np.array([x0, y0, z0]) @ rotation
    if kind == "cone":
        if (z > z0).sum() > len(z) / 2:  # the body lies below its apex
            rotation = np.array([rotation[0], -rotation[1], -rotation[2]])
        return Shape(kind, centre, rotation, np.arctan(np.sqrt([-a])))
    square += d * d / (4 * a)
    if square <= 0.0:
        return None
    return Shape(kind, centre, rotation, np.sqrt([square, square / a]))


def _solved(design: FloatArray, right: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.lstsq(design, right, rcond=None)[0], dtype=np.float64)


def _least(points: FloatArray) -> FloatArray:
    """Direction in which points spread least."""
    return np.asarray(np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2][-1], dtype=np.float64)


@lru_cache(maxsize=1)
def _half_sphere() -> FloatArray:
    """Rotations (D, 3, 3) with z' all over the upper half sphere, evenly (Fibonacci's lattice), the vertical first."""
    i = np.arange(DIRECTIONS)
    z = 1.0 - i / DIRECTIONS
    turn = np.pi * (3.0 - np.sqrt(5.0)) * i
    out = np.sqrt(1.0 - z * z)
    return np.stack([basis(axis) for axis in np.column_stack([out * np.cos(turn), out * np.sin(turn), z])])
