"""Footprints of large synthetic blocks, for tests and benchmarks."""

from __future__ import annotations

import numpy as np

from geomosaic.block import Footprint

WIDTH, HEIGHT = 1000.0, 700.0
# Distances of images along and across strips, in parts of their sides, and corners along each side.
ALONG, ACROSS, SIDE = 0.4, 0.65, 24


def footprints(images: int) -> list[Footprint]:
    """Rectangles of 96 corners in strips, 60 % overlap along and 35 % across, turned and displaced by chance."""
    chance, strip = np.random.default_rng(1), round(images**0.5)
    place = np.stack(np.divmod(np.arange(images), strip)[::-1], axis=1)
    centre = 1e5 + place * (ALONG * WIDTH, ACROSS * HEIGHT) + chance.uniform(-20.0, 20.0, (images, 2))
    corner = np.array([(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]) * (WIDTH, HEIGHT)
    steps = np.linspace(0.0, 1.0, SIDE, endpoint=False)[:, None]
    border = np.vstack([one + (other - one) * steps for one, other in zip(corner, np.roll(corner, -1, 0), strict=True)])
    angle = chance.normal(0.0, 0.03, images)
    turn = np.stack([np.cos(angle), -np.sin(angle), np.sin(angle), np.cos(angle)], axis=1).reshape(-1, 2, 2)
    return [
        Footprint(str(k), border @ turn[k].T + centre[k], (float(centre[k, 0]), float(centre[k, 1])), 1.0, True)
        for k in range(images)
    ]
