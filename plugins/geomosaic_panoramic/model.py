"""Panoramic sensor model, and strips without a place in relative metres.

The map is one of its own. Its origin is the ground below the scanner at the middle of the image, x runs along the
middle line of scan to the right of the flight and y ahead, both in metres. An aircraft's ground is a level plane; a
satellite's is the ellipsoid, and x, y are distance and direction on it from the origin (azimuthal equidistant).
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import Any, Self, cast

import numpy as np
from pyproj import CRS

from geomosaic.geo.crs import geographic
from geomosaic.geo.local_frames import LocalFrame
from geomosaic.geo.transform import Transform
from geomosaic.sensor.plugin import ControlBlunder, Parameters, WrappedModel
from geomosaic.sensor.ray_corrections import RayCorrection
from geomosaic.types import FloatArray
from geomosaic_panoramic.geometry import Scan, Sweeps
from geomosaic_panoramic.trajectory import Curve, Flight, Poses, Refracted, Track, Turn

OUTSIDE = (
    "east", "north", "up", "speed_east", "speed_north", "speed_up", "heading", "pitch", "roll", "heading_rate",
    "pitch_rate", "roll_rate",
)  # fmt: skip
INSIDE = ("pixel_angle", "focal", "motion")
# Parameters by kind.
NAMES = {"scanner": (*OUTSIDE, "pixel_angle"), "sweeps": (*OUTSIDE, *INSIDE), "panoramic": (*OUTSIDE, *INSIDE)}
# Points projected at a time: the arrays of their search stay in the processor's cache.
PART = 2048


@dataclass(frozen=True)
class PanoramicModel:
    """Sensor model of one strip of an across-track scanner, or of one photo of a panoramic camera.

    Attributes
    ----------
    scan : Scan
    frame : LocalFrame
        East, north, up at the nominal position at the middle of the image; or the map's axes (planar treatment).
    parameters : Parameters
        east, north, up: offset from there in metres; speeds in metres, rates in degrees per line or sweep; heading from
        true north, pitch and roll in degrees; pixel_angle in degrees; focal length and image motion in pixels
        (not of a scanner). With reported poses all but the last three are corrections of these.
    seed : tuple of float
        Ground point in `crs` near the middle of the image.
    poses : Poses, optional
        Of a curved flight; straight without.
    notes : tuple of str
        Corrections of the rays, and the fit of the control points.
    ray_correction : RayCorrection
        Refraction and, in the planar treatment, the Earth's curvature; none unless asked for.
    left_out : tuple of ControlBlunder
        Control points that contradict the others; a record of the fit, and no part of the state.
    """

    scan: Scan
    frame: LocalFrame
    parameters: Parameters
    seed: tuple[float, float, float]
    poses: Poses | None = None
    notes: tuple[str, ...] = ()
    ray_correction: RayCorrection = field(default_factory=RayCorrection)
    left_out: tuple[ControlBlunder, ...] = ()

    @property
    def crs(self) -> CRS:
        """Geocentric, or the map CRS of the planar treatment."""
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
        flight = Track(v[:3], v[3:6], turn) if self.poses is None else Curve(self.poses, v[:3], v[3:6], turn)
        return flight if self.ray_correction.none else Refracted(flight, self.ray_correction)

    @property
    def _inner(self) -> tuple[float, float, float]:
        inner = [float(value) for value in self.parameters.values[12:]] + [0.0, 0.0]
        return float(np.radians(inner[0])), inner[1], inner[2]

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        """Ground (N, 3) in `crs` to image (N, 2) in pixels; NaN above the horizon."""
        points = np.asarray(xyz, dtype=np.float64)
        out = np.full((len(points), 2), np.nan)
        known = np.flatnonzero(np.isfinite(points).all(axis=1))
        for first in range(0, len(known), PART):
            part = known[first : first + PART]
            out[part] = self.scan.project(self.track, *self._inner, self._enu(points[part]))
        return out

    def jacobian(self, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of (col, row) by parameters (N, 2, P) and by ground coordinates (N, 2, 3)."""
        points = np.asarray(xyz, dtype=np.float64)
        image = self.ground_to_image(points)
        by_values, by_enu = self.scan.derivatives(self.track, *self._inner, self._enu(points), image)
        units = np.ones(15)
        units[6:13] = np.pi / 180.0  # parameters are in degrees
        return (by_values * units)[:, :, : len(self.parameters)], by_enu @ self.frame.axes

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
        """Image with other parameter values (P,)."""
        return replace(self, parameters=self.parameters.with_values(values))

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {
            "kind": self.scan.kind,
            "size": list(self.size),
            "side": self.scan.side,
            **self.frame.to_dict(),
            **self.parameters.to_dict(),
            "units": list(self.parameters.units),
            "seed": list(self.seed),
            "centre": self.scan.centre,
            "sweeps": asdict(self.scan.sweeps),
            "poses": None if self.poses is None else self.poses.to_dict(),
            "notes": list(self.notes),
            "ray_correction": self.ray_correction.to_dict(),
        }

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Model of a state, as `to_dict` gives it, a strip without a place too."""
        if "relative" in state:
            return cast(Self, RelativeStrip.from_dict(state))
        frame = LocalFrame.from_dict(state)
        parameters = Parameters.from_dict(NAMES[state["kind"]], tuple(state["units"]), state)
        width, height = state["size"]
        x, y, z = state["seed"]
        centre = tuple(state["centre"]) if state.get("centre") else None
        scan = Scan(state["kind"], (width, height), state["side"], Sweeps(**state.get("sweeps", {})), centre)
        poses = Poses.from_dict(state["poses"]) if state.get("poses") else None
        correction = RayCorrection.from_dict(state.get("ray_correction", {}))
        return cls(scan, frame, parameters, (x, y, z), poses, tuple(state.get("notes", ())), correction)


LOCAL = (
    'ENGCRS["relative metres of a scanned strip",EDATUM["ground below the scanner at the middle of the strip"],'
    'CS[Cartesian,2],AXIS["across (X)",east,ORDER[1]],AXIS["ahead (Y)",north,ORDER[2]],LENGTHUNIT["metre",1]]'
)
SAID = "relative metres: x across, y ahead of the scanner; the strip has no place and no north on the Earth"


@dataclass(frozen=True)
class RelativeStrip(WrappedModel):
    """Sensor model of a strip without a place, over ground of one height, in a map of its own.

    Attributes
    ----------
    model : PanoramicModel
        At a nominal place.
    above : float
        Height of the nominal position above the ground, metres.
    curved : bool
        Whether the ground is the ellipsoid rather than a plane.
    """

    model: PanoramicModel
    above: float
    curved: bool
    notes = (SAID,)

    @property
    def crs(self) -> CRS:
        """The strip's own map."""
        return CRS.from_wkt(LOCAL)

    @property
    def seed(self) -> tuple[float, float, float]:
        """Seed of the strip in this map."""
        place = np.array([self.model.seed])
        east, north, _ = (self._from_map.inverse()(place) if self.curved else self.model.frame.to_enu(place))[
            0
        ].tolist()
        c, s = math.cos(self.heading), math.sin(self.heading)
        return c * east - s * north, s * east + c * north, 0.0

    @cached_property
    def heading(self) -> float:
        """Direction of the nose at the middle of the image, radians clockwise from true north."""
        flight, now = self.model.track, np.zeros(1)
        east, north, _ = flight.to_enu(np.array([[1.0, 0.0, 0.0]]), now)[0]
        return float(np.arctan2(east, north))

    @cached_property
    def _from_map(self) -> Transform:
        """Azimuthal equidistant map about the origin to geocentric coordinates, on the ellipsoid of the frame."""
        frame = self.model.frame
        longitude, latitude, _ = Transform(frame.crs, geographic(frame.crs))(frame.origin[None])[0].tolist()
        base = geographic(frame.crs).ellipsoid
        shape = f"+a={base.semi_major_metre} +b={base.semi_minor_metre}" if base else "+ellps=WGS84"
        text = f"+proj=aeqd +lat_0={latitude!r} +lon_0={longitude!r} {shape} +units=m +type=crs"
        earth = CRS.from_proj4(f"+proj=geocent {shape} +units=m +type=crs")
        return Transform(CRS.from_proj4(text).to_3d(), earth)

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        """Map (N, 2 or more) to image (N, 2); heights play no part."""
        x, y = np.asarray(xyz, dtype=np.float64)[:, :2].T
        c, s = np.cos(self.heading), np.sin(self.heading)
        east, north = c * x + s * y, -s * x + c * y
        if self.curved:
            return self.model.ground_to_image(self._from_map(np.column_stack([east, north, np.zeros_like(x)])))
        return self.model.ground_to_image(
            self.model.frame.to_geocentric(np.column_stack([east, north, np.full_like(x, -self.above)]))
        )

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {"relative": {"model": self.model.to_dict(), "above": self.above, "curved": self.curved}}

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Value of a state, as `to_dict` gives it."""
        inner = state["relative"]
        return cls(PanoramicModel.from_dict(inner["model"]), inner["above"], inner["curved"])
