"""The combined adjustment, linearised: residuals on the image coordinates, ground of the stations eliminated.

Each measurement is one equation p + v = f(Δ; X): image position, its residual, the photo's map ground → image with
parameters Δ, the station's place. Where X is unknown it is eliminated station by station: with the rows of one station
whitened by their sigmas, A its derivatives by X (2n × 2), B those by Δ and A = [Q₁ Q₂] R, the rows Q₂ᵀ(B Δ = f) no
longer know X. These are the conditions "the photos of a common point meet" of the edge matching of Bellman, Deakin and
Rollings (equations 6 to 9, A v + B Δ = f with cofactors A Q Aᵀ), already divided by the root of their cofactors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pyproj import CRS

from geomosaic.adjust.edges.stations import Stations
from geomosaic.geo.transform import Transform
from geomosaic.sensor.model import SensorModel
from geomosaic.sensor.solve.derivatives import jacobian, pixel_step
from geomosaic.types import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Eliminated:
    """Rows without ground, and how the ground follows.

    Attributes
    ----------
    design : array (M, P)
    right : array (M,)
    back : list of (station, R⁻¹Q₁ᵀB (2, P), R⁻¹Q₁ᵀr (2,), R⁻¹ (2, 2))
        dX = second − first · Δ.
    """

    design: FloatArray
    right: FloatArray
    back: list[tuple[int, FloatArray, FloatArray, FloatArray]]


@dataclass(frozen=True)
class Problem:
    """Stations, and photos whose parameters are free.

    Attributes
    ----------
    photos : tuple of str
    names : tuple of str (P,)
        All parameters, as 'photo: parameter', for errors.
    stations : Stations
    crs : CRS
        Map of the stations.
    to_model : tuple of Transform
        To the CRS of each photo's model.
    offsets : int array (photos + 1,)
        Where each photo's parameters begin in the vector of all.
    free : bool array (P,)
        Which of all parameters are estimated.
    priors : array (P,)
        A-priori sigmas of the free ones, inf for none.
    start : array (P,)
        Values the priors refer to.
    steps : array (P,)
    """

    photos: tuple[str, ...]
    names: tuple[str, ...]
    stations: Stations
    crs: CRS
    to_model: tuple[Transform, ...]
    offsets: IntArray
    free: BoolArray
    priors: FloatArray
    start: FloatArray
    steps: FloatArray

    @classmethod
    def of(cls, photos: tuple[str, ...], models: list[SensorModel], stations: Stations, crs: CRS) -> Problem:
        """Put the parameters of all photos into one vector."""
        parameters = [model.parameters for model in models]
        sigmas = np.concatenate([p.sigmas for p in parameters])
        return cls(
            photos,
            tuple(f"{photo}: {name}" for photo, p in zip(photos, parameters, strict=True) for name in p.names),
            stations,
            crs,
            tuple(Transform(crs, model.crs) for model in models),
            np.cumsum([0, *map(len, parameters)]),
            sigmas > 0.0,
            sigmas,
            np.concatenate([p.values for p in parameters]),
            np.concatenate([p.steps for p in parameters]),
        )

    def residuals(self, models: list[SensorModel], ground: FloatArray) -> FloatArray:
        """Measured minus computed (N, 2) in pixels; NaN where a photo cannot see a station of `ground` (S, 3)."""
        s = self.stations
        left = np.full_like(s.colrow, np.nan)
        for index, model in enumerate(models):
            mine = s.photo == index
            left[mine] = s.colrow[mine] - model.ground_to_image(self.to_model[index](ground[s.station[mine]]))
        return left

    def cost(self, residuals: FloatArray, ground: FloatArray, values: FloatArray) -> float:
        """Weighted sum of squares: image residuals, given coordinates, a-priori values."""
        s = self.stations
        total = float(((residuals / s.sigma_px[:, None]) ** 2).sum())
        known = (s.sigma > 0.0) & np.isfinite(s.sigma)
        total += float((((ground - s.xyz)[known, :2] / s.sigma[known, None]) ** 2).sum())
        held = self.free & np.isfinite(self.priors)
        return total + float((((values - self.start)[held] / self.priors[held]) ** 2).sum())

    def eliminate(
        self, models: list[SensorModel], residuals: FloatArray, ground: FloatArray, values: FloatArray
    ) -> Eliminated:
        """Linearise at the present values and ground, and eliminate the unknown ground."""
        s = self.stations
        by_values = np.zeros((len(s.photo), 2, len(self.free)))
        by_xy = np.zeros((len(s.photo), 2, 2))
        for index, model in enumerate(models):
            mine = np.flatnonzero(s.photo == index)
            if len(mine):
                columns = slice(self.offsets[index], self.offsets[index + 1])
                by_values[mine, :, columns], by_xy[mine] = self._derivatives(index, model, ground[s.station[mine]])
        weight = 1.0 / s.sigma_px[:, None, None]
        by_values, by_xy = by_values[:, :, self.free] * weight, by_xy * weight
        left = residuals * weight[:, :, 0]
        held = s.held[s.station]
        design = [by_values[held].reshape(-1, by_values.shape[2])]
        right = [left[held].ravel()]
        back = []
        for station in np.flatnonzero(~s.held):
            mine = s.station == station
            a, b, r = by_xy[mine].reshape(-1, 2), by_values[mine].reshape(-1, by_values.shape[2]), left[mine].ravel()
            if np.isfinite(s.sigma[station]):  # the given coordinates are observations too
                a = np.vstack([a, np.eye(2) / s.sigma[station]])
                b = np.vstack([b, np.zeros((2, b.shape[1]))])
                r = np.concatenate([r, (s.xyz[station, :2] - ground[station, :2]) / s.sigma[station]])
            q, upper = np.linalg.qr(a, mode="complete")
            inverse = np.linalg.inv(upper[:2])
            design.append(q[:, 2:].T @ b)
            right.append(q[:, 2:].T @ r)
            back.append((int(station), inverse @ (q[:, :2].T @ b), inverse @ (q[:, :2].T @ r), inverse))
        prior = np.isfinite(self.priors[self.free])
        rows = np.eye(len(prior))[prior] / self.priors[self.free][prior][:, None]
        from_start = (self.start - values)[self.free][prior] / self.priors[self.free][prior]
        return Eliminated(np.vstack([*design, rows]), np.concatenate([*right, from_start]), back)

    def _derivatives(self, index: int, model: SensorModel, ground: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Of image coordinates by the photo's parameters (n, 2, P) and by map x, y (n, 2, 2)."""
        way = self.to_model[index]
        by_values, by_model = jacobian(model, way(ground))
        if self.crs == model.crs:
            return by_values, by_model[:, :, :2]

        def image(xy: FloatArray) -> FloatArray:
            return model.ground_to_image(way(np.column_stack([xy, np.full(len(xy), ground[0, 2])])))

        step = pixel_step(image, ground[0, :2], 1.0 if self.crs.is_projected else 1e-5)
        turn = []
        for axis in range(2):
            high, low = ground.copy(), ground.copy()
            high[:, axis] += 0.5 * step
            low[:, axis] -= 0.5 * step
            turn.append((way(high) - way(low)) / (high - low)[:, axis, None])
        return by_values, by_model @ np.stack(turn, axis=2)
