"""Where the lines of sight of one point in several scenes meet, and what is left when they do not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geomosaic.sensor.solve import image_to_height
from geomosaic.types import FloatArray, IntArray
from geomosaic_rpc.model import WGS84, RpcModel

UNITS = np.array([1e-5, 1e-5, 1.0])
"""Degrees and metres that count as one: each about a metre on the ground."""

_ROUNDS = 12


@dataclass(frozen=True)
class Sights:
    """Measurements of tie points.

    Attributes
    ----------
    image, point : int array (M,)
        Which image and which tie point each measurement is of, from 0.
    colrow : array (M, 2)
        Pixels.
    """

    image: IntArray
    point: IntArray
    colrow: FloatArray

    @property
    def points(self) -> int:
        """Number of tie points."""
        return int(self.point.max(initial=-1)) + 1

    def seen_by(self, models: Sequence[RpcModel], ground: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Residuals (M, 2), measured minus computed, and derivatives by parameters (M, 2, 6) and ground (M, 2, 3)."""
        residuals = np.full_like(self.colrow, np.nan)
        by_parameters, by_ground = np.zeros((len(self.colrow), 2, 6)), np.zeros((len(self.colrow), 2, 3))
        for index, model in enumerate(models):
            rows = self.image == index
            here = ground[self.point[rows]]
            residuals[rows] = self.colrow[rows] - model.ground_to_image(here)
            by_parameters[rows], by_ground[rows] = model.jacobian(here)
        return residuals, by_parameters, by_ground * UNITS


def intersect(
    models: Sequence[RpcModel], sights: Sights, sigma_px: float, sigma_height: float, start: FloatArray | None = None
) -> FloatArray:
    """Ground points whose images are nearest to the measurements.

    Parameters
    ----------
    models : sequence of RpcModel
    sights : Sights
        At least two of each point.
    sigma_px, sigma_height : float
        Of a measurement, and of the height about that of the seed of the scenes, in metres: it decides only where lines
        of sight are nearly parallel.
    start : array (T, 3), optional

    Returns
    -------
    array (T, 3)
        Longitude, latitude, ellipsoidal height; NaN where a line of sight reaches no ground.
    """
    middle = float(np.mean([model.seed[2] for model in models]))
    ground = _start(models, sights, middle) if start is None else start.copy()
    for _ in range(_ROUNDS):
        residuals, _, by_ground = sights.seen_by(models, ground)
        normal = np.zeros((sights.points, 3, 3))
        right = np.zeros((sights.points, 3))
        weighted = by_ground / sigma_px**2
        np.add.at(normal, sights.point, np.einsum("mij,mik->mjk", weighted, by_ground))
        np.add.at(right, sights.point, np.einsum("mij,mi->mj", weighted, residuals))
        normal[:, 2, 2] += 1.0 / sigma_height**2
        right[:, 2] += (middle - ground[:, 2]) / sigma_height**2
        good = np.isfinite(right).all(axis=1) & np.isfinite(normal).all(axis=(1, 2))
        step = np.full_like(ground, np.nan)
        step[good] = np.linalg.solve(normal[good], right[good][:, :, None])[:, :, 0]
        ground = ground + step * UNITS
        if not np.nanmax(np.abs(step), initial=0.0) > 1e-6:
            break
    return ground


def _start(models: Sequence[RpcModel], sights: Sights, height: float) -> FloatArray:
    """Ground of the first measurement of each point, at one height."""
    ground = np.full((sights.points, 3), np.nan)
    for index in reversed(range(len(models))):
        rows = sights.image == index
        if rows.any():
            ground[sights.point[rows]] = image_to_height(models[index], sights.colrow[rows], height, WGS84)
    return ground
