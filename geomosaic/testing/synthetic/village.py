"""Houses in rows along streets: roofs with a sunlit and a shaded side, and the shadows they throw."""

from __future__ import annotations

import numpy as np

from geomosaic.testing.synthetic.noise import MASK, PERIOD, soft, table
from geomosaic.types import Float32Array

ROOFS = np.array(
    [
        [0.60, 0.34, 0.26, 0.44],
        [0.53, 0.30, 0.23, 0.40],
        [0.62, 0.42, 0.33, 0.47],
        [0.42, 0.37, 0.34, 0.36],
        [0.50, 0.49, 0.49, 0.44],
    ],
    dtype=np.float32,
)
SHADOW = np.array([0.10, 0.12, 0.13, 0.16], dtype=np.float32)
STREET = np.array([0.50, 0.48, 0.46, 0.45], dtype=np.float32)
PLOT, TURN = 31.0, 0.30  # metres, radians
KEEP = 0.72  # share of plots that are built on


def houses(
    ground: Float32Array, u: Float32Array, v: Float32Array, edge: float, seed: int, sun: tuple[float, float]
) -> Float32Array:
    """Lay streets, shadows and roofs over the colours (N, 4) of the ground at (u, v), with edges of the given width."""
    turn_c, turn_s = np.float32(np.cos(TURN)), np.float32(np.sin(TURN))
    a, b = turn_c * u + turn_s * v, turn_c * v - turn_s * u
    i, j = np.floor(a / np.float32(PLOT)), np.floor(b / np.float32(PLOT))
    index = (j.astype(np.int64) & MASK) * PERIOD + (i.astype(np.int64) & MASK)
    random = table(seed, "houses", 7)[index]
    # A street along every second line between plots, a lane across every fifth.
    street = np.abs(np.mod(b, np.float32(2 * PLOT)) - np.float32(PLOT))
    lane = np.abs(np.mod(a, np.float32(5 * PLOT)) - np.float32(2 * PLOT))
    paved = np.maximum(soft(np.float32(2.4) - street, edge), soft(np.float32(1.9) - lane, edge))
    ground = ground + paved[:, None] * (STREET - ground)

    inset = np.minimum(
        np.float32(PLOT / 2) - np.abs(a - (i + np.float32(0.5)) * np.float32(PLOT)),
        np.float32(PLOT / 2) - np.abs(b - (j + np.float32(0.5)) * np.float32(PLOT)),
    )
    inside = soft(inset - np.float32(3.2 * edge), edge) * (random[:, 6] < KEEP)  # nothing crosses into the next plot
    x = a - (i + np.float32(0.5)) * np.float32(PLOT) - (random[:, 0] - np.float32(0.5)) * 5
    y = b - (j + np.float32(0.5)) * np.float32(PLOT) - (random[:, 1] - np.float32(0.5)) * 4
    twist = (random[:, 2] - np.float32(0.5)) * np.float32(0.24) + np.float32(np.pi / 2) * (random[:, 2] > 0.8)
    c, s = np.cos(twist), np.sin(twist)
    length, depth = 5 + 3 * random[:, 3], np.float32(3.9) + np.float32(1.4) * random[:, 4]
    # Away from the sun, in the axes of the plots.
    fall = (
        turn_c * -np.float32(sun[0]) - turn_s * np.float32(sun[1]),
        -turn_c * np.float32(sun[1]) + turn_s * np.float32(sun[0]),
    )
    x2, y2 = x - 3 * fall[0], y - 3 * fall[1]
    shadow = _box(c * x2 + s * y2, c * y2 - s * x2, length, depth, edge)
    ground = ground + (np.float32(0.8) * shadow * inside)[:, None] * (SHADOW - ground)
    along, across = c * x + s * y, c * y - s * x
    roof = ROOFS[(random[:, 5] * len(ROOFS)).astype(np.int64)]
    facing = -(fall[1] * c - fall[0] * s)  # how squarely the upper side of the ridge looks into the sun
    side = np.tanh(across * np.float32(1 / edge))
    tone = np.float32(0.98) + np.float32(0.26) * facing * side
    mask = _box(along, across, length, depth, edge) * inside
    built: Float32Array = ground + mask[:, None] * (roof * tone[:, None] - ground)
    return built


def _box(x: Float32Array, y: Float32Array, half_x: Float32Array, half_y: Float32Array, edge: float) -> Float32Array:
    """Soft rectangle around the origin."""
    box: Float32Array = soft(half_x - np.abs(x), edge) * soft(half_y - np.abs(y), edge)
    return box
