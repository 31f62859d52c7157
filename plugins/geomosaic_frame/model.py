"""Frame model of a photo: ground to image, with rays and derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np
from pyproj import CRS

from geomosaic.geo.crs import is_local
from geomosaic.geo.local_frames import LocalFrame, angles_of, omega_phi_kappa, r1, r2, r3
from geomosaic.geo.transform import Transform
from geomosaic.sensor.plugin import ControlBlunder, Parameters
from geomosaic.sensor.ray_corrections import Columns, RayCorrection
from geomosaic.types import FloatArray
from geomosaic_frame.camera import CameraModel, camera_model_from_dict
from geomosaic_frame.orientation import FLIP
from geomosaic_frame.placement import convergence, local_frame
from geomosaic_frame.rolling_shutter import NAMES as MOTION
from geomosaic_frame.rolling_shutter import TURNS, Scan

NAMES = ("east", "north", "up", "omega", "phi", "kappa")


def _names_of(camera: CameraModel) -> tuple[str, ...]:
    """Names of the parameters of a photo: its pose; with a rolling shutter its motion, of a film its deformation."""
    motion = () if camera.shutter is None else MOTION
    return NAMES + motion + (() if camera.deformation is None else camera.deformation.names)


@dataclass(frozen=True, eq=False)
class FrameModel:
    """Frame sensor model: one photo of a frame camera.

    Attributes
    ----------
    camera : CameraModel
        Interior orientation for this image's size: in pixels, or a film with its scan.
    frame : LocalFrame
        East, north, up at the nominal projection centre; or the map's axes (planar treatment).
    parameters : Parameters
        east, north, up: offset of the projection centre from the frame's origin in metres (map units if planar); omega,
        phi, kappa in degrees, ground → image in that frame. With a rolling shutter, during whose readout the photo
        moves, they are those in its middle, and way and turn during the readout follow.
    seed : tuple of float
        Ground point in `crs` near the middle of the image.
    notes : tuple of str
        What was assumed when the model was made.
    ray_correction : RayCorrection
        Refraction and, in the planar treatment, the Earth's curvature; none unless asked for.
    interior_sigmas : tuple of float
        A-priori sigmas of the interior orientation; none where all of it is held.
    left_out : tuple of ControlBlunder
        Control points that contradict the others; a record of the fit, and no part of the state.
    """

    camera: CameraModel
    frame: LocalFrame
    parameters: Parameters
    seed: tuple[float, float, float]
    notes: tuple[str, ...] = ()
    ray_correction: RayCorrection = field(default_factory=RayCorrection)
    interior_sigmas: tuple[float, ...] = ()
    left_out: tuple[ControlBlunder, ...] = ()

    @property
    def crs(self) -> CRS:
        """Geocentric, or the map CRS of the planar treatment."""
        return self.frame.crs

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in pixels."""
        return self.camera.size

    @cached_property
    def rotation(self) -> FloatArray:
        """Local frame → image, x right, y up (3, 3)."""
        omega, phi, kappa = np.radians(self.parameters.values[3:6])
        return omega_phi_kappa(omega, phi, kappa)

    @cached_property
    def centre(self) -> FloatArray:
        """Projection centre in `crs` (3,)."""
        centre: FloatArray = self.frame.to_geocentric(self.parameters.values[None, :3])[0]
        return centre

    @cached_property
    def _to_camera(self) -> FloatArray:
        """`crs` → camera axes (3, 3)."""
        return FLIP @ self.rotation @ self.frame.axes

    @cached_property
    def _scan(self) -> Scan:
        return Scan(self.parameters.values)

    def _seen(self, local: FloatArray, time: FloatArray) -> FloatArray:
        """Points (N, 3) as seen from the projection centre at times (N,) of the readout, in the local frame."""
        moved: FloatArray = local - time[:, None] * self._scan.motion
        return moved if self.ray_correction.none else np.column_stack(self.ray_correction.seen(*moved.T))

    def _scanned(self, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (N, 3) in the local frame from the centre in the middle of the readout, and the times (N,) of each."""
        assert self.camera.shutter is not None
        offset = (np.asarray(xyz, dtype=np.float64) - self.centre).T
        local = np.column_stack(_product(self.frame.axes, *offset))

        def image(time: FloatArray) -> FloatArray:
            return self.camera.project(*self._scan.axes(time, self._seen(local, time)))

        return local, self.camera.shutter.solved(image, len(local))

    def _camera_axes(self, xyz: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Ground (N, 3) to camera axes, (N,) each."""
        if self.camera.shutter is not None:
            local, time = self._scanned(xyz)
            return self._scan.axes(time, self._seen(local, time))
        # Written out instead of a matrix product: BLAS may round a point differently from one array length to the next.
        points = np.asarray(xyz, dtype=np.float64)
        x, y, z = (points[:, i] - self.centre[i] for i in range(3))
        if self.ray_correction.none:
            return _product(self._to_camera, x, y, z)
        return _product(FLIP @ self.rotation, *self.ray_correction.seen(*_product(self.frame.axes, x, y, z)))

    def ground_to_image(self, xyz: FloatArray) -> FloatArray:
        """Ground (N, 3) in `crs` to image (N, 2) in pixels; NaN behind the camera."""
        return self.camera.project(*self._camera_axes(xyz))

    def rays(self, colrow: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Image (N, 2) to origins (N, 3) and unit directions (N, 3) towards the ground, in `crs`."""
        seen = self.camera.directions(colrow)
        if self.camera.shutter is not None:
            time = self.camera.shutter.time(colrow)
            local = self._scan.directions(time, seen)
            local = local if self.ray_correction.none else self.ray_correction.true(local)
            local /= np.linalg.norm(local, axis=1)[:, None]
            return self.centre + (time[:, None] * self._scan.motion) @ self.frame.axes, local @ self.frame.axes
        if self.ray_correction.none:
            directions: FloatArray = seen @ self._to_camera
        else:
            directions = self.ray_correction.true(seen @ (FLIP @ self.rotation)) @ self.frame.axes
            directions /= np.linalg.norm(directions, axis=1)[:, None]
        return np.tile(self.centre, (len(directions), 1)), directions

    def jacobian(self, xyz: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Derivatives of (col, row) by parameters (N, 2, P), per metre and degree, and by ground (N, 2, 3)."""
        if self.camera.shutter is not None:
            held, by_local, followed = self._held(xyz)
            return followed @ held, followed @ by_local @ self.frame.axes
        points = np.asarray(xyz, dtype=np.float64)
        by_camera = self.camera.derivatives(*self._camera_axes(points))
        local = (points - self.centre) @ self.frame.axes.T
        bent = np.eye(3) if self.ray_correction.none else self.ray_correction.slopes(*local.T)
        seen = local if self.ray_correction.none else np.column_stack(self.ray_correction.seen(*local.T))
        omega, phi, kappa = np.radians(self.parameters.values[3:6])
        turned = (
            self.rotation @ TURNS[0],
            r3(kappa) @ TURNS[1] @ r2(phi) @ r1(omega),
            TURNS[2] @ self.rotation,
        )
        out = np.empty((len(points), 2, len(self.parameters)))
        by_local = by_camera @ (FLIP @ self.rotation) @ bent
        out[:, :, :3] = -by_local
        for i, matrix in enumerate(turned):
            # Parameters are in degrees, the derivatives of rotations per radian: hence π/180 below.
            moved = seen @ (FLIP @ matrix).T
            out[:, :, 3 + i] = np.einsum("nij,nj->ni", by_camera, moved) * (np.pi / 180.0)
        if self.camera.deformation is not None:
            out[:, :, 6:] = self.camera.deformation.by_values(self.ground_to_image(points))
        return out, by_local @ self.frame.axes

    def _held(self, xyz: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Derivatives by parameters and local frame at held times, and from these to times that follow; see `Scan`."""
        assert self.camera.shutter is not None
        local, time = self._scanned(xyz)
        seen = self._seen(local, time)
        moved = local - time[:, None] * self._scan.motion
        bent = np.eye(3) if self.ray_correction.none else self.ray_correction.slopes(*moved.T)
        axes = self._scan.axes(time, seen)
        held, by_local = self._scan.derivatives(time, seen, bent, self.camera.derivatives(*axes))
        return held, by_local, self._scan.followed(held, self.camera.shutter.slope(self.camera.project(*axes)))

    def with_values(self, values: FloatArray) -> Self:
        """Photo with other parameter values (P,)."""
        camera = self.camera if self.camera.deformation is None else self.camera.deformed(values[len(NAMES) :])
        return replace(self, camera=camera, parameters=self.parameters.with_values(values))

    @property
    def interior(self) -> Parameters:
        """Interior orientation of the camera."""
        interior = self.camera.interior
        return replace(interior, sigmas=np.array(self.interior_sigmas)) if self.interior_sigmas else interior

    def with_interior(self, interior: Parameters) -> Self:
        """Photo whose camera has other values, and a-priori sigmas, of its interior orientation."""
        camera = self.camera.having(interior.names)
        if camera is not self.camera:
            # Additional parameters come all together, whatever part of them was named.
            all_of_it = camera.interior
            interior = interior.including(all_of_it.names)
            order = [interior.names.index(name) for name in all_of_it.names]
            interior = replace(all_of_it, values=interior.values[order], sigmas=interior.sigmas[order])
        sigmas = tuple(interior.sigmas.tolist()) if interior.sigmas.any() else ()
        return replace(self, camera=camera.with_interior(interior.values), interior_sigmas=sigmas)

    def interior_jacobian(self, xyz: FloatArray) -> FloatArray:
        """Derivatives of (col, row) by the interior orientation, (N, 2, Q)."""
        by_interior = self.camera.by_interior(*self._camera_axes(xyz))
        return by_interior if self.camera.shutter is None else self._held(xyz)[2] @ by_interior

    @property
    def camera_table(self) -> Mapping[str, Any]:
        """The camera as `camera.toml` describes it, in pixels; of film its state, which no other program knows."""
        return self.camera.to_dict()

    @property
    def pose(self) -> tuple[FloatArray, FloatArray]:
        """Projection centre (3,) in `crs`, and rotation (3, 3) from its axes to the camera's."""
        return self.centre, self._to_camera

    def directions(self, colrow: FloatArray) -> FloatArray:
        """Image (N, 2) to unit directions (N, 3) in camera axes: x right, y down, z forward."""
        return self.camera.directions(colrow)

    def posed(self, centre: FloatArray, rotation: FloatArray, ahead: FloatArray, crs: CRS | None = None) -> Self:
        """Photo at another pose (see `pose`) that sees a point `ahead` (3,); all in a Cartesian `crs`, if given."""
        crs = crs or self.crs
        frame = LocalFrame.at(crs, centre) if crs.is_geocentric else LocalFrame(crs, np.array(centre), np.eye(3))
        turned = FLIP @ rotation @ frame.axes.T
        # Near the pole of phi, and where nothing is up, the angles count from the attitude itself.
        if is_local(crs) or abs(turned[2, 0]) > STEEPEST_PHI:
            frame, turned = LocalFrame(frame.crs, frame.origin, turned @ frame.axes), np.eye(3)
        x, y, z = (float(value) for value in ahead)
        values = np.array([0.0, 0.0, 0.0, *np.degrees(angles_of(turned))])
        if self.camera.shutter is not None:
            # In another CRS the motion is not known: its values are those of a photo without a place, 0.
            motion = self._scan.motion @ self.frame.axes @ frame.axes.T if crs == self.crs else self._scan.motion
            values = np.concatenate([values, motion, self._scan.turn_about(values)])
        if self.camera.deformation is not None:
            values = np.concatenate([values, self.camera.deformation.values])
        parameters = parameters_of(
            self.camera, crs, values, self.parameters.sigmas, float(np.linalg.norm(ahead - centre))
        )
        return replace(self, frame=frame, parameters=parameters, seed=(x, y, z))

    def exterior(self, crs: CRS) -> FloatArray:
        """Projection centre in `crs`, and omega, phi, kappa from its grid north, in degrees (6,)."""
        position = Transform(self.crs, crs)(self.centre[None])[0]
        rotation = self.rotation @ self.frame.axes
        if self.crs.is_geocentric:
            # From geocentric axes to those of the place, and from true north to the grid's: `placement.rigorous` back.
            rotation = rotation @ local_frame(crs, position, "exterior").axes.T @ r3(convergence(crs, position))
        return np.array([*position, *np.degrees(angles_of(rotation))])

    def motion(self, crs: CRS) -> FloatArray | None:
        """Velocity in units of `crs` per second, and turn about camera axes in degrees per second (6,), if it moves."""
        if self.camera.shutter is None:
            return None
        ends = self.centre + np.array([np.zeros(3), self._scan.motion @ self.frame.axes])
        here, there = Transform(self.crs, crs)(ends)
        return np.concatenate([there - here, self._scan.turning]) / self.camera.shutter.readout_time

    def to_dict(self) -> dict[str, Any]:
        """State as JSON values."""
        return {
            "camera": self.camera.to_dict(),
            **self.frame.to_dict(),
            **self.parameters.to_dict(),
            "units": list(self.parameters.units),
            "seed": list(self.seed),
            "notes": list(self.notes),
            "ray_correction": self.ray_correction.to_dict(),
            **({"interior_sigmas": self.interior.to_dict()["sigmas"]} if self.interior_sigmas else {}),
        }

    @classmethod
    def from_dict(cls, state: dict[str, Any]) -> Self:
        """Model of a state, as `to_dict` gives it."""
        frame = LocalFrame.from_dict(state)
        x, y, z = state["seed"]
        ray_correction = RayCorrection.from_dict(state.get("ray_correction", {}))
        sigmas = tuple(np.inf if sigma is None else float(sigma) for sigma in state.get("interior_sigmas", ()))
        camera, notes = camera_model_from_dict(state["camera"]), tuple(state["notes"])
        parameters = Parameters.from_dict(_names_of(camera), tuple(state["units"]), state)
        return cls(camera, frame, parameters, (x, y, z), notes, ray_correction, sigmas)


def _product(matrix: FloatArray, x: FloatArray, y: FloatArray, z: FloatArray) -> Columns:
    """Product of a matrix (3, 3) and columns (N,), rounded alike for a point alone and among others."""
    a, b, c = (t[0] * x + t[1] * y + t[2] * z for t in matrix)
    return a, b, c


# Sine of phi from which the angles of a photo count from its own attitude: omega and kappa are nearly one turn there.
STEEPEST_PHI = 0.9


def parameters_of(camera: CameraModel, crs: CRS, values: FloatArray, sigmas: FloatArray, distance: float) -> Parameters:
    """Parameters of a photo at a distance from what it shows, with steps of about a pixel.

    Parameters
    ----------
    camera : CameraModel
    crs : CRS
        Cartesian, of the photo's frame.
    values, sigmas : array (P,)
    distance : float
        In the unit of `crs`.
    """
    unit = "m" if crs.is_geocentric else str(crs.axis_info[0].unit_name)
    focal = float(np.sqrt(camera.focal[0] * camera.focal[1]))
    steps = np.array([distance / focal] * 3 + [float(np.degrees(1.0 / focal))] * 3)
    if camera.shutter is not None:
        # At the first and the last row half of a motion shows.
        steps = np.concatenate([steps, 2.0 * steps])
    units = ((unit,) * 3 + ("deg",) * 3) * (len(steps) // len(NAMES))
    if camera.deformation is not None:
        more = len(camera.deformation.values)
        steps, units = np.concatenate([steps, np.ones(more)]), units + ("px",) * more
    return Parameters(_names_of(camera), units, values, sigmas, steps)
