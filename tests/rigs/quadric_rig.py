"""Points on quadrics of known place, axis and size."""

from __future__ import annotations

import numpy as np

from geomosaic.surface.developed.fit import basis
from geomosaic.types import FloatArray

ORIGIN = np.array([512.3, -210.7, 48.2])


def turned(axis: FloatArray) -> FloatArray:
    return basis(np.asarray(axis, dtype=float) / np.linalg.norm(axis))


def on_body(
    kind: str, axis: FloatArray, sizes: tuple[float, ...], count: int, seed: int, turn: float = 5.0
) -> FloatArray:
    """Points (N, 3) on a body, written plainly; `turn` radians of it are seen."""
    rng = np.random.default_rng(seed)
    theta, t = rng.uniform(0.0, turn, count), rng.uniform(0.0, 1.0, count)
    if kind == "plane":
        own = np.column_stack([rng.uniform(-4, 4, count), rng.uniform(-3, 3, count), np.zeros(count)])
    elif kind == "cylinder":
        own = np.column_stack([sizes[0] * np.cos(theta), sizes[0] * np.sin(theta), 9.0 * t])
    elif kind == "cone":
        down = 2.0 + 8.0 * t
        own = np.column_stack([down * np.tan(sizes[0]) * np.cos(theta), down * np.tan(sizes[0]) * np.sin(theta), -down])
    else:
        beta = np.arcsin(-0.2 + 1.15 * t)
        a, c = sizes[0], sizes[-1]
        own = np.column_stack([a * np.cos(beta) * np.cos(theta), a * np.cos(beta) * np.sin(theta), c * np.sin(beta)])
    return ORIGIN + own @ turned(axis)


UPRIGHT, LEANING, LYING = (np.array(v) for v in ([0.0, 0.0, 1.0], [0.2, -0.3, 1.0], [1.0, 0.4, 0.05]))
CASES = {
    "plane": ("plane", LEANING, ()),
    "sphere": ("sphere", UPRIGHT, (4.2,)),
    "tower": ("cylinder", LEANING, (3.1,)),
    "pipe": ("cylinder", LYING, (0.4,)),
    "spire": ("cone", LEANING, (0.25,)),
    "roof": ("cone", UPRIGHT, (1.3,)),
    "funnel": ("cone", np.array([0.1, 0.0, -1.0]), (0.6,)),
    "flat dome": ("ellipsoid", LEANING, (5.0, 3.0)),
    "onion": ("ellipsoid", LEANING, (3.0, 5.0)),
}
