"""The radar sensor model: range-Doppler equations, corrected by shifts of range and azimuth time and their drift.

    R' = R + range_shift + range_drift·u,   t' = t + time_shift + time_drift·u,   u = (t − middle) / half

with the zero-Doppler time t and slant range R of a ground point, the time of the middle of the scene, and half its
duration; row and column are those of t' and R'. A delay in the atmosphere and in the instrument lengthens ranges, an
error of the clock or of the orbit along the track moves times (Schubert and others, Sentinel-1A Product Geolocation
Accuracy, Remote Sensing 7(7), 2015); what of it changes over the scene is drift.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from pyproj import CRS

from geomosaic.errors import InputError
from geomosaic.sensor.plugin import ControlBlunder, Parameters
from geomosaic.types import FloatArray
from geomosaic_sar.calibration import SarCalibration
from geomosaic_sar.geometry import ImageGeometry
from geomosaic_sar.zero_doppler import Passages, ground_points, passages

NAMES = ("range_shift", "time_shift", "range_drift", "time_drift")
UNITS = ("m", "s", "m", "s")
# Refinements and how many of the parameters they free.
KINDS = {"none": 0, "shift": 2, "drift": 4}
ECEF = CRS.from_epsg(4978)


@dataclass(frozen=True, eq=False)
class SarModel:
    """Radar sensor model of one scene.

    Attributes
    ----------
    geometry : ImageGeometry
        As the producer tells it.
    size : tuple of int
        Width and height in pixels.
    parameters : Parameters
        The four corrections; those that the kind of refinement leaves out are held fixed.
    seed : tuple of float
        Geocentric ground point at the middle of the image.
    notes : tuple of str
        Where the geometry comes from and what was done to it.
    left_out : tuple of ControlBlunder
        Control points that contradict the others; a record of the fit, and no part of the state.
    calibration : SarCalibration, optional
        Of the amplitudes; none leaves them as they are.
    """

    geometry: ImageGeometry
    size: tuple[int, int]
    parameters: Parameters
    seed: tuple[float, float, float]
    notes: tuple[str, ...] = ()
    left_out: tuple[ControlBlunder, ...] = ()
    calibration: SarCalibration | None = None

    @classmethod
    def of(
        cls,
        geometry: ImageGeometry,
        size: tuple[int, int],
        kind: str = "shift",
        *,
        height: float = 0.0,
        where: str = "radar",
        notes: tuple[str, ...] = (),
    ) -> Self:
        """Model that is not corrected yet.

        Parameters
        ----------
        geometry : ImageGeometry
        size : tuple of int
            Width and height in pixels.
        kind : str
            What an adjustment may change: 'none', 'shift' or 'drift' (shift and drift).
        height : float
            Rough ellipsoidal height of the ground in metres, to start inverses.
        where : str
            Named in errors.
        notes : tuple of str

        Raises
        ------
        InputError
            The ranges do not reach the ground.
        """
        col, row = np.array([size[0] / 2.0]), np.array([size[1] / 2.0])
        times = geometry.times(row)
        ranges = geometry.axis.ranges(col, times)
        seed = ground_points(geometry.orbit, times, ranges, geometry.side, height)
        if not np.isfinite(seed).all():
            raise InputError(
                f"slant range {ranges[0]:.0f} m does not reach the ground",
                where=where,
                hint="check that the ranges are one-way distances in metres, and that the orbit is Earth-fixed",
            )
        zero = np.zeros(len(NAMES))
        # Two points of one range may be a metre off in no direction: steps come from the sampling itself.
        by_range = float(geometry.axis.columns(ranges, times)[1][0])
        steps = np.array([1.0 / by_range, geometry.row_interval] * 2)
        sigmas = np.where(np.arange(len(NAMES)) < KINDS[kind], np.inf, 0.0)
        x, y, z = seed[0].tolist()
        return cls(geometry, size, Parameters(NAMES, UNITS, zero, sigmas, steps), (x, y, z), notes)

    def freed(self, kind: str) -> Self:
        """Model with the parameters of another kind of refinement free."""
        sigmas = np.where(np.arange(len(NAMES)) < KINDS[kind], np.inf, 0.0)
        return replace(self, parameters=replace(self.parameters, sigmas=sigmas))

    @property
    def crs(self) -> CRS:
        """Geocentric WGS 84, metres."""
        return ECEF

    @property
    def amplitudes(self) -> bool:
        """Detected products hold amplitudes."""
        return True

    @cached_property
    def _middle(self) -> tuple[float, float]:
        """Time of the middle of the scene and half its duration, seconds."""
        half = 0.5 * self.size[1] * self.geometry.row_interval
        return self.geometry.first_row - 0.5 * self.geometry.row_interval + half, half

    def _passages(self, xyz: FloatArray) -> Passages:
        return passages(self.geometry.orbit, xyz, self.geometry.side, self._middle[0])

    def _corrected(self, passed: Passages) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Ranges and times (N,) with the corrections, and the place u (N,) along the scene."""
        middle, half = self._middle
        u = (passed.times - middle) / half
        by_range, by_time, range_drift, time_drift = self.parameters.values
        return passed.ranges + by_range + range_drift * u, passed.times + by_time + time_drift * u, u

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        """Ground (N, 3), geocentric metres, to image (N, 2) in pixels.

        NaN on the side to which the sensor does not look, below its horizon, and where the orbit is not known.
        """
        ranges, times, _ = self._corrected(self._passages(xyz))
        return np.column_stack([self.geometry.axis.columns(ranges, times)[0], self.geometry.rows(times)])

    def jacobian(self, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of (col, row) by parameters (N, 2, 4) and by ground coordinates (N, 2, 3)."""
        points = np.asarray(xyz, dtype=np.float64)
        passed = self._passages(points)
        ranges, times, u = self._corrected(passed)
        _, by_range, by_time = self.geometry.axis.columns(ranges, times)
        time_slopes, range_slopes = passed.slopes(points)
        _, half = self._middle
        range_slopes = range_slopes + time_slopes * (self.parameters.values[2] / half)
        time_slopes = time_slopes * (1.0 + self.parameters.values[3] / half)
        rate = 1.0 / self.geometry.row_interval
        by_ground = np.stack(
            [by_range[:, None] * range_slopes + by_time[:, None] * time_slopes, time_slopes * rate], axis=1
        )
        by_parameters = np.zeros((len(points), 2, len(NAMES)))
        by_parameters[:, 0, :2] = np.column_stack([by_range, by_time])
        by_parameters[:, 1, 1] = rate
        by_parameters[:, :, 2:] = by_parameters[:, :, :2] * u[:, None, None]
        by_parameters[np.isnan(u)] = np.nan
        return by_parameters, by_ground

    def sensor_positions(self, xyz: FloatArray) -> FloatArray:
        """Geocentric positions (N, 3) of the sensor at the zero-Doppler times of ground points (N, 3), metres."""
        return self._passages(xyz).positions

    def with_values(self, values: FloatArray) -> Self:
        """Scene with other corrections (4,)."""
        return replace(self, parameters=self.parameters.with_values(values))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {
            "geometry": self.geometry.to_dict(),
            "size": list(self.size),
            **self.parameters.to_dict(),
            "seed": list(self.seed),
            "notes": list(self.notes),
            "calibration": None if self.calibration is None else self.calibration.to_dict(),
        }

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Model of a state, as `to_dict` gives it."""
        width, height = state["size"]
        x, y, z = state["seed"]
        parameters = Parameters.from_dict(NAMES, UNITS, state)
        calibration = state.get("calibration")
        return cls(
            ImageGeometry.from_dict(state["geometry"]), (width, height), parameters, (x, y, z), tuple(state["notes"]),
            calibration=None if calibration is None else SarCalibration.from_dict(calibration),
        )  # fmt: skip
