"""The panoramic sensor as a model: a scan carried along a track."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self, cast

import numpy as np
from pyproj import CRS

from geomosaic.geo.local import LocalFrame
from geomosaic.sensor.parameters import Parameters
from geomosaic.types import FloatArray
from geomosaic_panoramic.curve import Curve, Poses
from geomosaic_panoramic.geometry import Scan
from geomosaic_panoramic.sweeps import Sweeps
from geomosaic_panoramic.track import Flight, Track, Turn

OUTSIDE = (
    "east", "north", "up", "speed_east", "speed_north", "speed_up", "heading", "pitch", "roll", "heading_rate",
    "pitch_rate", "roll_rate",
)  # fmt: skip
INSIDE = ("pixel_angle", "focal", "motion")
NAMES = {"scanner": (*OUTSIDE, "pixel_angle"), "sweeps": (*OUTSIDE, *INSIDE), "panoramic": (*OUTSIDE, *INSIDE)}
"""Parameters by kind."""


@dataclass(frozen=True)
class PanoramicModel:
    """One strip of an across-track scanner, or one photo of a panoramic camera.

    Attributes
    ----------
    scan : Scan
    frame : LocalFrame
        East, north, up at the nominal position at the middle of the image.
    parameters : Parameters
        east, north, up: offset from there in metres; speeds in metres, rates in degrees per line or sweep; heading from
        true north, pitch and roll in degrees; pixel_angle in degrees; focal length and image motion in pixels
        (not of a scanner). With reported poses all but the last three are what comes on top of these.
    seed : tuple of float
        Ground point in `crs` near the middle of the image.
    poses : Poses, optional
        Of a curved flight; straight without.
    notes : tuple of str
        What control points did.
    """

    scan: Scan
    frame: LocalFrame
    parameters: Parameters
    seed: tuple[float, float, float]
    poses: Poses | None = None
    notes: tuple[str, ...] = ()

    @property
    def crs(self) -> CRS:
        """Geocentric."""
        return self.frame.crs

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.scan.size

    @cached_property
    def track(self) -> Flight:
        """Motion and attitude."""
        v = self.parameters.values
        turn = Turn(np.radians(v[6:9]), np.radians(v[9:12]))
        return Track(v[:3], v[3:6], turn) if self.poses is None else Curve(self.poses, v[:3], v[3:6], turn)

    @property
    def _inner(self) -> tuple[float, float, float]:
        inner = [float(value) for value in self.parameters.values[12:]] + [0.0, 0.0]
        return float(np.radians(inner[0])), inner[1], inner[2]

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        """Ground (N, 3) in `crs` to image (N, 2) in pixels; NaN above the horizon."""
        points = np.asarray(xyz, dtype=np.float64)
        known = np.isfinite(points).all(axis=1)
        out = np.full((len(points), 2), np.nan)
        if known.any():
            out[known] = self.scan.project(self.track, *self._inner, self._enu(points[known]))
        return out

    def rays(self, colrow: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Image (N, 2) to origins (N, 3) and unit directions (N, 3) towards the ground, in `crs`."""
        tau, body = self.scan.directions(*self._inner, np.asarray(colrow, dtype=np.float64))
        origins = self.frame.to_geocentric(self.track.places(tau))
        return origins, self.track.to_enu(body, tau) @ self.frame.axes

    def _enu(self, points: FloatArray) -> FloatArray:
        """Local coordinates, written out: a matrix product may round a point differently in arrays of other lengths."""
        x, y, z = (points[:, i] - self.frame.origin[i] for i in range(3))
        return np.column_stack([a[0] * x + a[1] * y + a[2] * z for a in self.frame.axes])

    def with_values(self, values: FloatArray) -> Self:
        """Return the image with other parameter values."""
        return replace(self, parameters=self.parameters.with_values(values))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values; a free parameter's sigma is null."""
        p = self.parameters
        return {
            "kind": self.scan.kind,
            "size": list(self.size),
            "side": self.scan.side,
            "crs": self.crs.to_wkt(),
            "origin": self.frame.origin.tolist(),
            "axes": self.frame.axes.tolist(),
            "values": p.values.tolist(),
            "sigmas": [None if np.isinf(s) else float(s) for s in p.sigmas],
            "steps": p.steps.tolist(),
            "units": list(p.units),
            "seed": list(self.seed),
            "sweeps": self.scan.sweeps.to_dict(),
            "poses": None if self.poses is None else self.poses.to_dict(),
            "notes": list(self.notes),
        }

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Rebuild a model from `to_dict`, a strip without a place too."""
        if "relative" in state:
            from geomosaic_panoramic.relative import RelativeStrip

            return cast(Self, RelativeStrip.from_dict(state))
        frame = LocalFrame(CRS.from_wkt(state["crs"]), np.array(state["origin"]), np.array(state["axes"]))
        sigmas = np.array([np.inf if s is None else s for s in state["sigmas"]])
        parameters = Parameters(
            NAMES[state["kind"]], tuple(state["units"]), np.array(state["values"]), sigmas, np.array(state["steps"])
        )
        width, height = state["size"]
        x, y, z = state["seed"]
        scan = Scan(state["kind"], (width, height), state["side"], Sweeps(**state.get("sweeps", {})))
        poses = Poses.from_dict(state["poses"]) if state.get("poses") else None
        return cls(scan, frame, parameters, (x, y, z), poses, tuple(state.get("notes", ())))
